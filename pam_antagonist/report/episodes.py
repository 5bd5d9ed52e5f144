"""The report of ``close_loop`` on a regulator-driven joint: sentences, tables and figures, and the result."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from typing_extensions import override

from pam_antagonist.diagnosis.episodes import NAMED, EpisodeDiagnosis, Row
from pam_antagonist.diagnosis.result import MODELS, FoundEffect, PartVerdict, Size
from pam_antagonist.diagnosis.verdicts import UNEXPLAINED
from pam_antagonist.identification.episode_filter import EpisodeFilter
from pam_antagonist.inference.bootstrap import Interval
from pam_antagonist.inference.episode_search import ABOVE_NOISE
from pam_antagonist.inference.free_parameters import EFFECT_PARAMETERS, moved
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.inference.total_slopes import LEVEL, PARTS, TotalSlope
from pam_antagonist.inference.weak_laws import WEAK_LAWS
from pam_antagonist.program import versions
from pam_antagonist.report.close_loop_findings import left
from pam_antagonist.report.document import Document, Findings, Section, Statement, Table, Tile, Tiles, note, page, warn
from pam_antagonist.report.figure import BAND, ESTIMATE, Axis, Band, Figure, Line, Panel, Reference
from pam_antagonist.report.identify_episodes import (
    ABOUT,
    BY_SIGNAL,
    about_episodes,
    filter_notes,
    interval,
    intervals_frame,
    removes,
    shown,
    times,
    units_findings,
)
from pam_antagonist.report.result import DataFrame, Result
from pam_antagonist.report_keys import CLOSE_LOOP, with_all_keys
from pam_antagonist.rig import Rig
from pam_antagonist.rig.file import write_rig
from pam_antagonist.rig.units import assumption, unit_of, unread
from pam_antagonist.shown import MISSING, listed, number, percent
from pam_antagonist.strict_json import picked

_WORDS = {
    "friction": "constant (Coulomb) friction",
    "friction_by_pressure": "friction that grows with the joint's own pressures",
    "hysteresis": "hysteresis of the contraction force",
    "creep": "creep of the muscles",
    WEAK_LAWS: "torque and friction that go a little with all that was measured",
}
_BAR = 1e5
"""[Pa] Slopes are by a bar."""


def in_words(effect: str) -> str:
    """An effect in words."""
    name, _, signal = effect.partition(": ")
    return f"{BY_SIGNAL[name]} {signal}" if signal else _WORDS.get(name, name)


def verdict(diagnosis: EpisodeDiagnosis) -> str:
    """The result in one or two sentences."""
    given, before, *_, after = (number(row.later.value) for row in diagnosis.rows)
    if not diagnosis.effects:
        what = "No effect that was offered is needed"
        if diagnosis.verdict == UNEXPLAINED and diagnosis.left is not None:
            what = (
                "The model lacks something that none of the offered effects is: its squared error is "
                f"{interval(diagnosis.left)} times what the noise of the readings alone would leave"
            )
        return f"{what}. The error on later episodes is {after}°, with the rig as configured {given}°."
    errors = [row.later.value for row in (diagnosis.rows[0], diagnosis.rows[1], diagnosis.rows[-1])]
    change = "falls" if errors[1] < errors[0] else "changes"
    then = "to" if errors[2] < errors[1] else "is"
    names = listed(list(map(in_words, diagnosis.effects)))
    what = f"What the model lacks is {names}."
    if diagnosis.verdict == UNEXPLAINED:
        what = (
            f"The model lacks more than what was found: {names} explains {percent(max(diagnosis.share, 0.0))} of the "
            "excess over noise."
        )
    return (
        f"{what} The error on later episodes {change} from {given}° as configured to {before}° by a fit without that, "
        f"and {then} {after}° with it."
    )


def next_step(diagnosis: EpisodeDiagnosis, joint: PressureDriven) -> str:
    """Which rig file to use, in a sentence or two."""
    further = ""
    if diagnosis.verdict == UNEXPLAINED:
        further = (
            " Read in section What is left on what the remaining residual depends. What else acts on the joint, such "
            "as the pressures of a neighbour, is tried where it is recorded and named by --also."
        )
    return _rig_to_use(diagnosis, joint) + further


def _rig_to_use(diagnosis: EpisodeDiagnosis, joint: PressureDriven) -> str:
    if not diagnosis.is_better:
        return f"Next: keep the rig file of {joint.rig.name}, since the extended rig is no better on held-out episodes."
    if what := unread(extended(diagnosis, joint)):
        return f"Next: use rig_extended.yaml in identify, close_loop, replay and the estimator; {what}."
    return "Next: use rig_extended.yaml, which every command and node takes."


def extended(diagnosis: EpisodeDiagnosis, joint: PressureDriven) -> Rig:
    """The rig with the effects and the weak laws, and the further signals that they need."""
    start, values = joint.rig, joint.values(diagnosis.model)
    source = f"extended by close_loop from {joint.name}; started from: {start.source}"
    return diagnosis.in_rig(moved(start, values)).replaced(
        name=f"{start.name}_extended", source=source, signals=further_signals(diagnosis, joint), identified=joint.name
    )


def further_signals(diagnosis: EpisodeDiagnosis, joint: PressureDriven) -> dict[str, float]:
    """The further signals that the extended rig needs, with their values in its file [SI]."""
    if diagnosis.weak is not None:
        return dict(joint.rig.signals)
    known = (EFFECT_PARAMETERS.get(path) for path in joint.values(diagnosis.model))
    last = max((item.signal or 0 for item in known if item is not None), default=0)
    return dict(list(joint.rig.signals.items())[:last])


def findings(diagnosis: EpisodeDiagnosis, joint: PressureDriven) -> tuple[Statement, ...]:
    """Findings, from the numbers."""
    out = [_not_told_apart(diagnosis, name, instead_of, row) for name, instead_of, row in diagnosis.others]
    base = next(row for row in diagnosis.rows if row.model.startswith("mechanics"))
    if diagnosis.effects and diagnosis.rows[-1].later.value >= base.later.value:
        out.append(warn("On later episodes the model's error is no smaller with these effects, so they may be chance: "
                        "record more episodes."))  # fmt: skip
    if diagnosis.left is not None and diagnosis.left.low <= ABOVE_NOISE:
        out.append(note(
            f"The remaining error is hardly more than noise: the model's squared error is {interval(diagnosis.left)} "
            "times what the noise of the readings alone would leave. No further effect is named."
        ))  # fmt: skip
    last = max((item.round for item in diagnosis.tried), default=0)
    for item in diagnosis.tried:
        if item.round == last and not item.taken:
            how = "was not fitted, since its score is lower than those of the others"
            if item.removed is not None:
                how = removes(item.removed)
            name = in_words(item.name)
            out.append(note(f"{name[:1].upper()}{name[1:]} is not needed beside these: it {how}."))
    out += _about_weak_laws(diagnosis)
    out.append(note(
        f"Models of the first half and of three quarters of the fitted episodes forecast the next quarter with an "
        f"error of {interval(diagnosis.forecast)}°. The 95 % interval of a free run is as wide as these errors were "
        f"where the joint had gone as far: it holds {percent(diagnosis.coverage[0])} of the angles of later episodes "
        f"and {percent(diagnosis.coverage[1])} of interleaved ones."
    ))  # fmt: skip
    if diagnosis.ratio is not None and len(diagnosis.effects) > (diagnosis.weak is not None):
        out.append(note(f"On interleaved episodes the effects that have a name leave {interval(diagnosis.ratio)} of "
                        "the squared error of the model with Coulomb friction alone."))  # fmt: skip
    return (*out, *units_findings(joint), note(next_step(diagnosis, joint)))


def _about_weak_laws(diagnosis: EpisodeDiagnosis) -> list[Statement]:
    """What the weak laws remove, what they do together, and what of that holds in all parts of the recording."""
    if diagnosis.removed is None:
        return []
    if diagnosis.weak is None:
        return [note(
            f"Many weak laws at once are not taken: all together they change the squared error of unseen episodes by "
            f"{percent(-diagnosis.removed.value)} ({percent(-diagnosis.removed.high)} to "
            f"{percent(-diagnosis.removed.low)})."
        )]  # fmt: skip
    certain = [one for one in diagnosis.slopes if _is_certain(one) and one.agrees and one.by != LEVEL]
    others = [one for one in diagnosis.slopes if any(p.low > 0.0 or p.high < 0.0 for p in one.parts) and not one.agrees]
    out = [note(
        f"{len(diagnosis.weak[0].terms)} weak laws and their drift, all fitted at once, remove "
        f"{percent(diagnosis.removed.value)} of what the effects with a name leave of the squared error of unseen "
        f"episodes ({percent(diagnosis.removed.low)} to {percent(diagnosis.removed.high)}). No single one of them has "
        "a meaning. What they do together has: see the slopes of the whole torque and friction."
    )]  # fmt: skip
    if certain:
        out.append(note(f"In all parts of the recording {listed([_in_short(one) for one in certain])}."))
    if others:
        out.append(warn(f"Of this day only: {listed([_in_short(one) for one in others])}. The parts of the recording "
                        "differ in that."))  # fmt: skip
    return out


def _titled(slope: TotalSlope) -> str:
    return f"{slope.of}, mean" if slope.by == LEVEL else f"{slope.of} by {slope.by}"


def _is_certain(slope: TotalSlope) -> bool:
    return all(part.low > 0.0 or part.high < 0.0 for part in slope.parts)


def _in_short(slope: TotalSlope) -> str:
    if slope.by == LEVEL:
        return f"the mean {slope.of} {'grows' if slope.parts[-1].value > slope.parts[0].value else 'falls'}"
    by = slope.by.replace("pressure_", "pressure ")
    return f"{slope.of} {'grows' if slope.parts[-1].value > 0.0 else 'falls'} with {by}"


def _not_told_apart(diagnosis: EpisodeDiagnosis, name: str, instead_of: str, row: Row) -> Statement:
    taken = next(item for item in diagnosis.tried if item.taken and item.name == instead_of)
    other = next(item for item in diagnosis.tried if item.round == taken.round and item.name == name)
    assert taken.removed is not None and other.removed is not None
    after = [item.score for item in diagnosis.tried if item.name == name and item.round > taken.round]
    left = f" With the first in the model, the second scores {percent(after[0])}." if after else ""
    alone = next(one for one in diagnosis.rows if one.model == NAMED)
    return warn(
        f"The episodes do not decide between two effects: {in_words(instead_of)} removes "
        f"{percent(taken.removed.value)} of the remaining error, {in_words(name)} "
        f"{percent(other.removed.value)}.{left} With the second in place of the first, the error on later episodes is "
        f"{number(row.later.value)}° instead of {number(alone.later.value)}°."
    )


def errors_table(diagnosis: EpisodeDiagnosis) -> Table:
    """Errors of all models on episodes that were used for no fit and no choice."""
    rows = tuple(
        (row.model, interval(row.later), interval(row.interleaved))
        for row in (*diagnosis.rows, *(other for *_, other in diagnosis.others))
    )
    head = ("RMSE of the angle [°], 95 % interval by episode", "later", "interleaved")
    return Table(head, rows, about_episodes(*diagnosis.counts))


def values_table(diagnosis: EpisodeDiagnosis, rig: Rig) -> Table:
    """Numbers of the model with the effects that have a name."""
    rows = tuple(shown(rig, name, value) for name, value in diagnosis.values.items())
    head = ("Value", "95 % interval by episode", "Unit")
    return Table(head, rows, "The model with the effects that have a name, without weak laws")


def slopes_table(diagnosis: EpisodeDiagnosis, rig: Rig) -> Table:
    """How the whole torque and friction go with what was measured, in each part of the recording."""
    rows = []
    for slope in diagnosis.slopes:
        name, factor = _unit_of_slope(rig, slope)
        each = [interval(times(factor, part), 2) for part in slope.parts]
        rows.append((f"{_titled(slope)} [{name}]", *each, "yes" if slope.agrees else "no"))
    parts = [f"part {k} of {PARTS}" for k in range(1, PARTS + 1)]
    head = ("Slope, mean over what was seen", *parts, "the same in all")
    return Table(head, tuple(rows), "The whole torque without friction, and the whole Coulomb friction, with 95 % "
                 "intervals; a lasting change of each input counts")  # fmt: skip


def _unit_of_slope(rig: Rig, slope: TotalSlope) -> tuple[str, float]:
    """Unit in which a slope is shown, and the factor to it; torques may be per inertia."""
    per_inertia = rig.units.force == "per_inertia"
    by_pressure = slope.unit in ("N m/Pa", "N m/SI")
    torque, scale = ("rad/s²", 1.0 / rig.joint.inertia) if per_inertia else ("N m", 1.0)
    if slope.unit == "N m/Pa" or (by_pressure and rig.units.pressure == "unknown"):
        return f"{torque} a bar", scale * _BAR
    if by_pressure:
        return f"{torque} per SI", scale
    known = {
        "N m": torque,
        "N m/rad": ("1/s²" if per_inertia else "N m/rad"),
        "N m s/rad": ("1/s" if per_inertia else "N m s/rad"),
    }
    return known[slope.unit], scale


def tried_table(diagnosis: EpisodeDiagnosis) -> Table:
    """All candidates, by rounds."""
    rows = []
    for item in diagnosis.tried:
        removed = MISSING if item.removed is None else " to ".join(map(percent, item.removed[1:]))
        removed = removed if item.removed is None else f"{percent(item.removed.value)} ({removed})"
        rows.append((f"{item.round}. {item.name}", percent(item.score), removed, "taken" if item.taken else ""))
    if diagnosis.removed is not None:
        low, high = map(percent, diagnosis.removed[1:])
        took = "" if diagnosis.weak is None else "taken"
        rows.append(("weak laws", MISSING, f"{percent(diagnosis.removed.value)} ({low} to {high})", took))
    return Table(
        ("Candidate", "Score", "Squared error removed, corrected interval", ""), tuple(rows),
        "Score: to first order, of fitted episodes; removed: of episodes that the fit has not seen. Intervals are "
        "wider by as many candidates as were offered",
    )  # fmt: skip


def slopes_figure(diagnosis: EpisodeDiagnosis, rig: Rig) -> tuple[Figure, ...]:
    """The slopes of torque and friction by the inputs over the recording; none without weak laws."""
    parts, panels = np.arange(1.0, PARTS + 1.0), list[Panel]()
    for slope in diagnosis.slopes:
        if slope.by in ("angle", "velocity"):
            continue
        name, factor = _unit_of_slope(rig, slope)
        value, low, high = factor * np.array([list(one) for one in slope.parts]).T
        drawn = (
            Band("95 % interval", parts, low, high, BAND, quiet=bool(panels)),
            Line("slope", parts, value, ESTIMATE, quiet=bool(panels)), Reference(0.0),
        )  # fmt: skip
        panels.append(Panel(Axis("Part of the recording"), Axis(f"{_titled(slope)} [{name}]"), drawn, 130))
    about = "How the whole torque and the whole friction go with each input, in each part of the recording."
    return (Figure("Slopes of torque and friction", about, tuple(panels)),) if panels else ()


@dataclass(frozen=True, eq=False, repr=False)
class EpisodesDiagnoseResult(Result):
    """Effects that the model of a joint lacks, from episodes."""

    found: EpisodeDiagnosis  # effects, and errors on whole held-out episodes
    joint: PressureDriven
    hashes: tuple[str, ...]  # SHA-256 of the recordings, a whole held-out one last
    filtered: EpisodeFilter | None = None  # the rig's filter; None without commands

    @override
    def _brief(self) -> str:
        return f"{self.joint.name}: {self.sentence}"

    @property
    def effects(self) -> tuple[FoundEffect, ...]:
        """The detected effects."""
        return tuple(effect for effect, _ in self._effects)

    @property
    def _effects(self) -> list[tuple[FoundEffect, str | None]]:
        """The detected effects, each with the signal that it goes with."""
        gains = {item.name: item.removed for item in self.found.tried if item.taken} | {WEAK_LAWS: self.found.removed}
        signals, out = list(self.joint.rig.signals), []
        for title in self.found.effects:
            name, _, signal = title.partition(": ")
            number = str(signals.index(signal) + 1) if signal else ""
            start, removed = f"effects.{name}.", gains[title]
            sizes = {
                path.removeprefix(start): Size(one.value, one.std, unit_of(self.joint.rig, path))
                for path, one in self.found.values.items() if path.startswith(start) and path.endswith(number)
            }  # fmt: skip
            gain = None if removed is None else removed.value
            found = FoundEffect(name, None, sizes, math.nan, gain, (self.joint.name,), part="joint")
            out.append((found, signal or None))
        return out

    @property
    def sentence(self) -> str:
        """The result in words."""
        return verdict(self.found)

    @property
    def next_rig(self) -> str | None:
        """Name of the rig file to use; None: keep the one that there is."""
        return "rig_extended.yaml" if self.found.is_better else None

    @property
    def rig_extended(self) -> Rig:
        """The rig with the effects, the further signals that they need, and its filter."""
        return extended(self.found, self.joint) if self.filtered is None else self.filtered.rig

    @override
    def to_json(self) -> dict[str, Any]:
        found, rig = self.found, self.joint.rig
        said = findings(found, self.joint)
        return with_all_keys(CLOSE_LOOP, {
            "verdict": found.verdict,
            "sentence": self.sentence,
            "share_explained": found.share if found.effects else None,
            "parts": [PartVerdict("joint", found.verdict, found.share if found.effects else None)],
            "ambiguous_with": [name for name, _, _ in found.others],
            "ranking": [
                {
                    "name": item.name, "part": "joint", "round": item.round, "score": item.score, "delta_bic": None,
                    "held_out_evidence": None, "holdout_gain": None if item.removed is None else item.removed.value,
                    "taken": item.taken, "score_by_muscle": None,
                }
                for item in found.tried
            ],
            "remaining": [item.line() for item in found.remaining],
            "left": found.remaining,
            "recordings": [{"recording": name, "sha256": value} for name, value in self._recordings],
            "warnings": [item.text for item in said if item.status == "warn"],
            "notes": [item.text for item in said if item.status != "warn"],
            "next_steps": [next_step(found, self.joint)],
            "next_rig": self.next_rig,
            "effects": [{**effect.to_json(), "signal": signal} for effect, signal in self._effects],
            "errors": {
                name: {"angle": {"rmse_deg": row.later.value}}
                for name, row in zip(MODELS, (found.rows[0], found.rows[1], found.rows[-1]), strict=True)
            },
            "errors_deg": found.rows,
            "ratio_to_coulomb_interleaved": found.ratio,
            "ratio_to_noise": found.left,
            "longest_step_s": found.longest_step,
            "weak_laws": None if found.removed is None else {
                "removed": found.removed, "taken": found.weak is not None,
                "numbers": 0 if found.weak is None else len(found.weak[0].terms),
            },
            "slopes": [{**picked(one, "of", "by", "unit", "parts"), "agrees": one.agrees} for one in found.slopes],
            **picked(found, "values", "tried"),
            "filter": None if self.filtered is None else self.filtered.to_json(),
            "forecast_deg": found.forecast,
            "coverage95": {"later": found.coverage[0], "interleaved": found.coverage[1]},
            "not_told_apart": [{"effect": a, "instead_of": b, "errors_deg": row} for a, b, row in found.others],
            "episodes": dict(zip(("fitted", "later", "interleaved"), found.counts, strict=True)),
            "settings": {"rig": rig.name, "rig_source": " ".join(rig.source.split())},
            "software": versions(),
            "assumption": assumption(rig),
            "units": picked(rig.units, "pressure", "force"),
            "recordings_sha256": self.hashes,
        })  # fmt: skip

    @property
    def _recordings(self) -> list[tuple[str, str]]:
        """Names and checksums; a recording that is held out as a whole is the last one."""
        names = (self.joint.name, "held out")
        return list(zip(names[: len(self.hashes)], self.hashes, strict=True))

    @override
    def document(self, figures: bool = True) -> Document:
        found, joint = self.found, self.joint
        given, after = found.rows[0], found.rows[-1]
        names = [name for name in found.effects if name != WEAK_LAWS]
        tiles = Tiles((
            _tile("Later episodes", given.later, after.later),
            _tile("Interleaved episodes", given.interleaved, after.interleaved),
            Tile("Effects with a name", str(len(names)), ", ".join(names)),
        ))  # fmt: skip
        made = [("Rig", joint.rig.name), *((f"Recording {k}", value) for k, value in enumerate(self.hashes, 1))]
        drawn: Sequence[Figure] = slopes_figure(found, joint.rig) if figures else ()
        slopes = (Section("What torque and friction go with", (slopes_table(found, joint.rig), *drawn), 2, "slopes"),)
        remains = (Section("What is left", left(found.remaining, figures), 2, "left"),)
        blocks = (
            tiles, Findings((*findings(found, joint), *filter_notes(self.filtered))), errors_table(found),
            values_table(found, joint.rig), *(slopes if found.slopes else ()), *(remains if found.remaining else ()),
            Section("All candidates", (tried_table(found),), 2, "candidates"),
        )  # fmt: skip
        kicker, words_of = "What the model of a joint lacks", "close_loop of episodes"
        return page(kicker, joint.name, blocks, words_of, made, ABOUT, verdict(found))

    def to_dataframe(self) -> DataFrame:
        """A row for each number of the effects: its value and 95 % interval by episode (needs pandas)."""
        return intervals_frame(self.found.values)

    @override
    def write_rigs(self, folder: Path) -> None:
        about = f"By pam_antagonist close_loop, from rig {self.joint.rig.name}. {self.sentence}"
        if self.next_rig is not None:
            write_rig(self.rig_extended, folder / self.next_rig, [about])


def _tile(label: str, before: Interval, after: Interval) -> Tile:
    return Tile(label, f"{number(after.value)}°", f"as configured {number(before.value)}°")
