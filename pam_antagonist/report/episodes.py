"""The report of ``close_loop`` on a regulator-driven joint: sentences, tables and figures, and the result."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from typing_extensions import override

from pam_antagonist.diagnosis.episodes import PARTS, WINDOWS, EpisodeDiagnosis, Row
from pam_antagonist.inference.episode_search import ABOVE_NOISE
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.model.effects.learned import FIRST_SIGNAL
from pam_antagonist.replays.result import joined
from pam_antagonist.report.document import Document, Findings, Section, Statement, Table, Tile, Tiles, note, page, warn
from pam_antagonist.report.figure import BAND, ESTIMATE, MODEL, SECOND, Axis, Band, Figure, FloatArray, Line, Panel
from pam_antagonist.report.identify_episodes import (
    ABOUT,
    BY_SIGNAL,
    about_episodes,
    interval,
    intervals_frame,
    removes,
    shown,
    unit,
    units_findings,
    value_name,
)
from pam_antagonist.report.result import DataFrame, Result
from pam_antagonist.rig import Rig
from pam_antagonist.rig.file import write_rig
from pam_antagonist.rig.learned import Law, laws_of, value_path
from pam_antagonist.rig.units import readable, unread_signals
from pam_antagonist.shown import MISSING, number, percent
from pam_antagonist.strict_json import picked

T = TypeVar("T")

LEARNED = "learned: "
_WORDS = {
    "friction": "constant (Coulomb) friction",
    "friction_by_pressure": "friction that grows with the joint's own pressures",
    "hysteresis": "hysteresis of the contraction force",
    "creep": "creep of the muscles",
}
_ARGUMENT = re.compile(r"effects\.learned\.law\d+_argument")
"""Path of the code of what a law depends on."""
_DRIFT = 0.8
"""The rig drifts if the error of a model of the last episodes is less than this times that of all episodes."""


def in_words(effect: str) -> str:
    """An effect in words."""
    name, _, signal = effect.partition(": ")
    if name == "learned":
        place, _, argument = signal.partition(" by ")
        return f"{place}, which depends on {argument} (a learned law)"
    return f"{BY_SIGNAL[name]} {signal}" if signal else _WORDS.get(name, name)


def verdict(diagnosis: EpisodeDiagnosis) -> str:
    """The result in one or two sentences."""
    given, before, *_, after = (number(row.forecast.value) for row in diagnosis.rows)
    if not diagnosis.effects:
        return (
            f"No effect that was offered is needed: the error on later episodes is {after}°, with the rig as "
            f"configured {given}°."
        )
    words = [in_words(effect) for effect in diagnosis.effects if not effect.startswith(LEARNED)]
    if count := len(diagnosis.effects) - len(words):
        words.append(in_words(diagnosis.effects[-1]) if count == 1 else f"what {count} learned laws add")
    errors = [row.forecast.value for row in (diagnosis.rows[0], diagnosis.rows[1], diagnosis.rows[-1])]
    change = "falls" if errors[1] < errors[0] else "changes"
    then = "to" if errors[2] < errors[1] else "is"
    return (
        f"What the model lacks is {joined(words)}. The error on later episodes {change} from {given}° as configured to "
        f"{before}° by a fit without that, and {then} {after}° with it."
    )


def next_step(diagnosis: EpisodeDiagnosis, joint: PressureDriven) -> str:
    """Which rig file to use, in a sentence."""
    if diagnosis.is_better:
        signals = further_signals(diagnosis, joint)
        if not signals:
            return "Next: use rig_extended.yaml, which every command and node takes."
        return f"Next: use rig_extended.yaml in identify and close_loop. {unread_signals(signals)}."
    return f"Next: keep the rig file of {joint.rig.name}, since the extended rig is no better on held-out episodes."


def further_signals(diagnosis: EpisodeDiagnosis, joint: PressureDriven) -> dict[str, float]:
    """The further signals that the extended rig needs, with their values in its file [SI]."""
    values = joint.values(diagnosis.model)
    last = max((int(path[-1]) for path in values if "_by_signal." in path), default=0)
    codes = [int(value) for path, value in values.items() if _ARGUMENT.fullmatch(path)]
    last = max([last, *(code - FIRST_SIGNAL + 1 for code in codes)])
    return dict(list(joint.rig.signals.items())[:last])


def findings(diagnosis: EpisodeDiagnosis, joint: PressureDriven) -> tuple[Statement, ...]:
    """Findings, from the numbers."""
    out = [_not_told_apart(diagnosis, name, instead_of, row) for name, instead_of, row in diagnosis.others]
    base = next(row for row in diagnosis.rows if row.model.startswith("mechanics"))
    if diagnosis.effects and diagnosis.rows[-1].forecast.value >= base.forecast.value:
        out.append(warn("On later episodes the model's error is no smaller with these effects, so they may be chance: "
                        "record more episodes."))  # fmt: skip
    if diagnosis.left is not None and diagnosis.left.low <= ABOVE_NOISE:
        out.append(note(
            f"The remaining error is hardly more than noise: the model's squared error is {interval(diagnosis.left)} "
            "times what the noise of the readings alone would leave. No further effect is named."
        ))  # fmt: skip
    last = max((item.round for item in diagnosis.tried if not item.name.startswith(LEARNED)), default=0)
    for item in diagnosis.tried:
        if item.round == last and not item.taken and not item.name.startswith(LEARNED):
            how = "was not fitted, since its score is lower than those of the others"
            if item.removed is not None:
                how = removes(item.removed)
            name = in_words(item.name)
            out.append(note(f"{name[:1].upper()}{name[1:]} is not needed beside these: it {how}."))
    whole, recent = diagnosis.rows[-1].later, diagnosis.rows[-1].recent
    if diagnosis.window < 1.0 and recent is not None:
        kind = warn if recent.value < _DRIFT * whole.value else note
        out.append(kind(
            f"The rig drifts: on later episodes the model's error is {number(recent.value)}° if only the last "
            f"{percent(diagnosis.window)} of the fitted episodes are used, and {number(whole.value)}° if all are used. "
            "The share was chosen by forecasts within the fitted episodes."
        ))  # fmt: skip
    out += _about_laws(diagnosis)
    lines = diagnosis.lines
    assert lines.interleaved is not None
    out.append(note(
        f"A model whose numbers change along lines through {diagnosis.points} points over the fitted episodes, and "
        f"then stay at their last values, has an error of {number(lines.later.value)}° on later episodes and of "
        f"{number(lines.interleaved.value)}° on interleaved ones."
    ))  # fmt: skip
    out.append(note(
        f"The 95 % interval of a free run holds {percent(diagnosis.coverage[0])} of the angles of later episodes and "
        f"{percent(diagnosis.coverage[1])} of interleaved ones. Its variance is that of the numbers, plus that of what "
        "the model leaves of fitted episodes at the same time since the start."
    ))  # fmt: skip
    if drifting := _drifting(diagnosis, joint.rig):
        changes = "; ".join(drifting)
        out.append(warn("These numbers change over the recording (straight-line fit, corrected 95 % intervals): "
                        f"{changes}."))  # fmt: skip
    if diagnosis.ratio is not None and diagnosis.effects:
        out.append(note(f"On interleaved episodes the extended model leaves {interval(diagnosis.ratio)} of the squared "
                        "error of the model with Coulomb friction alone."))  # fmt: skip
    return (*out, *units_findings(joint), note(next_step(diagnosis, joint)))


def _about_laws(diagnosis: EpisodeDiagnosis) -> list[Statement]:
    """The learned laws one by one, and what a dependence on the time since the start means."""
    taken = [item for item in diagnosis.tried if item.taken and item.name.startswith(LEARNED)]
    out = []
    for item in taken:
        place, _, argument = item.name.removeprefix(LEARNED).partition(" by ")
        out.append(note(f"{place[:1].upper()}{place[1:]} depends on {argument}: a learned law."))
    if any("time since the start" in item.name for item in taken):
        out.append(warn(
            "What depends on the time since the start stands for what nobody measured: whoever drives the joint may "
            "move other joints by time."
        ))  # fmt: skip
    return out


def _not_told_apart(diagnosis: EpisodeDiagnosis, name: str, instead_of: str, row: Row) -> Statement:
    taken = next(item for item in diagnosis.tried if item.taken and item.name == instead_of)
    other = next(item for item in diagnosis.tried if item.round == taken.round and item.name == name)
    assert taken.removed is not None and other.removed is not None
    after = [item.score for item in diagnosis.tried if item.name == name and item.round > taken.round]
    left = f" With the first in the model, the second scores {percent(after[0])}." if after else ""
    return warn(
        f"The episodes do not decide between two effects: {in_words(instead_of)} removes "
        f"{percent(taken.removed.value)} of the remaining error, {in_words(name)} "
        f"{percent(other.removed.value)}.{left} With the second in place of the first, the error on later episodes is "
        f"{number(row.forecast.value)}° instead of {number(diagnosis.rows[-1].forecast.value)}°."
    )


def _drifting(diagnosis: EpisodeDiagnosis, rig: Rig) -> list[str]:
    """Numbers with a significant drift, and their changes."""
    out = []
    for name, change in without_laws(diagnosis.drift.changes).items():
        if change.low > 0.0 or change.high < 0.0:
            title, text, written = shown(rig, name, change, 2)
            out.append(f"{title} by {text} {written}")
    return out


def errors_table(diagnosis: EpisodeDiagnosis) -> Table:
    """Errors of all models on episodes that were used for no fit and no choice."""
    rows = tuple(
        (row.model, interval(row.later), interval(row.recent), interval(row.interleaved))
        for row in (*diagnosis.rows, diagnosis.lines, *(other for *_, other in diagnosis.others))
    )
    head = (
        "RMSE of the angle [°], 95 % interval by episode", "later, all before fitted",
        f"later, last {percent(diagnosis.window)} before", "interleaved",
    )  # fmt: skip
    return Table(head, rows, about_episodes(*diagnosis.counts))


def values_table(diagnosis: EpisodeDiagnosis, rig: Rig) -> Table:
    """Numbers of the extended model, and their changes over the recording."""
    rows = []
    for name, value in without_laws(diagnosis.values).items():
        rows.append((*shown(rig, name, value), shown(rig, name, diagnosis.drift.changes[name], 2)[1]))
    return Table(
        ("Value", "95 % interval by episode", "Unit", "Change over the recording, corrected 95 % interval"),
        tuple(rows),
        f"The extended model, fitted to the last {percent(diagnosis.window)} of the fitted episodes. The change is "
        f"that of a straight line from the first to the last of {PARTS} parts",
    )  # fmt: skip


def drift_table(diagnosis: EpisodeDiagnosis, rig: Rig) -> Table:
    """Numbers of the extended model in each part of the recording, and its errors there."""
    rows = []
    for name, parts in without_laws(diagnosis.drift.values).items():
        texts = [shown(rig, name, part, 2) for part in parts]
        title, _, written = texts[0]
        rows.append((f"{title} [{written}]", *(text for _, text, _ in texts)))
    for k, fit in enumerate(("fitted to all that may be fitted", "fitted to the part")):
        rows.append((f"RMSE [°], {fit}", *(number(pair[k]) for pair in diagnosis.drift.errors)))
    return Table(
        ("Part of the recording", *(str(k) for k in range(1, PARTS + 1))), tuple(rows),
        "Fitted to each part by itself, with 95 % intervals by episode",
    )  # fmt: skip


def tried_table(diagnosis: EpisodeDiagnosis) -> Table:
    """All candidates, by rounds."""
    rows = []
    for item in diagnosis.tried:
        removed = MISSING if item.removed is None else " to ".join(map(percent, item.removed[1:]))
        removed = removed if item.removed is None else f"{percent(item.removed.value)} ({removed})"
        rows.append((f"{item.round}. {item.name}", percent(item.score), removed, "taken" if item.taken else ""))
    return Table(
        ("Candidate", "Score", "Squared error removed, corrected interval", ""), tuple(rows),
        "Score: to first order, of fitted episodes; removed: of episodes that the fit has not seen. Intervals are "
        "wider by as many candidates as were offered",
    )  # fmt: skip


def figure(diagnosis: EpisodeDiagnosis, rig: Rig) -> Figure:
    """The drift: errors and numbers over the recording."""
    parts = np.arange(1.0, PARTS + 1.0)
    one, own = (np.array([pair[k] for pair in diagnosis.drift.errors]) for k in (0, 1))
    series = (
        Line("fitted to all that may be fitted", parts, one, MODEL),
        Line("fitted to each part", parts, own, SECOND),
    )
    panels = [Panel(Axis(), Axis("RMSE [°]", from_zero=True), series)]
    for name, values in without_laws(diagnosis.drift.values).items():
        shown, factor = unit(rig, name)
        drawn = _with_interval("the number", parts, factor * np.array(values), quiet=len(panels) > 1)
        panels.append(Panel(Axis(), Axis(f"{value_name(rig, name)} [{shown}]", from_zero=True), drawn))
    panels[-1] = replace(panels[-1], x=Axis("Eighth of the recording"))
    about = "Errors and numbers of the extended model over the recording. What lies between the errors is drift."
    return Figure("Drift", about, tuple(panels))


def _with_interval(name: str, x: FloatArray, rows: FloatArray, quiet: bool) -> tuple[Band, Line]:
    """A curve (N,) over its interval: `rows` are values with their lower and upper ends (N, 3)."""
    value, low, high = rows.T
    return Band("95 % interval by episode", x, low, high, BAND, quiet), Line(name, x, value, ESTIMATE, quiet=quiet)


def without_laws(values: Mapping[str, T]) -> dict[str, T]:
    """Values without those of learned laws, which a figure shows."""
    return {name: value for name, value in values.items() if ".learned." not in name}


def law_figures(diagnosis: EpisodeDiagnosis, extended: Rig) -> tuple[Figure, ...]:
    """The learned laws, each over what it depends on, in one figure; none without them."""
    panels: list[Panel] = []
    for k, law in laws_of(extended).items():
        rows = [diagnosis.values[value_path(k, node)] for node in range(1, len(law.nodes) + 1)]
        (shown, factor), across = _unit_of_law(extended, law), readable(law.argument_unit)
        x = np.array(law.nodes) * across.scale
        drawn = _with_interval("the law", x, factor * np.array(rows), quiet=bool(panels))
        panels.append(Panel(Axis(f"{law.on} [{across.name}]"), Axis(f"{law.at} [{shown}]"), drawn))
    about = (
        "Laws that were learned from the episodes: changes of the muscles' strength, of friction, damping or torque by "
        "what each depends on. They are constant outside of the range that is shown."
    )
    return (Figure("Learned laws", about, tuple(panels)),) if panels else ()


def _unit_of_law(rig: Rig, law: Law) -> tuple[str, float]:
    """Unit in which the values of a law are shown, and the factor to it."""
    if law.unit == "-":
        return "%", 100.0
    per_inertia = {"N m": "rad/s²", "N m s/rad": "1/s"}[law.unit]
    return (per_inertia, 1.0 / rig.joint.inertia) if rig.units.force == "per_inertia" else (law.unit, 1.0)


@dataclass(frozen=True, eq=False, repr=False)
class EpisodesDiagnoseResult(Result):
    """Effects that the model of a joint lacks, from episodes."""

    found: EpisodeDiagnosis  # effects, errors on whole held-out episodes, and the drift
    joint: PressureDriven
    hashes: tuple[str, ...]  # SHA-256 of the recordings, a whole held-out one last

    @override
    def _brief(self) -> str:
        return f"{self.joint.name}: {self.sentence}"

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the detected effects, each with its signal if there is one."""
        return self.found.effects

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
        """The rig with the effects, and the further signals that they need."""
        start, values = self.joint.rig, self.joint.values(self.found.model)
        source = f"extended by close_loop from {self.joint.name}; started from: {start.source}"
        signals = further_signals(self.found, self.joint)
        return moved(start, values).replaced(
            name=f"{start.name}_extended", source=source, signals=signals, identified=self.joint.name
        )

    @override
    def to_json(self) -> dict[str, Any]:
        found, rig = self.found, self.joint.rig
        return {
            "verdict": "effect" if found.effects else "none",
            "sentence": self.sentence,
            "next_steps": [next_step(found, self.joint)],
            "next_rig": self.next_rig,
            "effects": found.effects,
            "errors_deg": found.rows,
            "ratio_to_coulomb_interleaved": found.ratio,
            "ratio_to_noise": found.left,
            "longest_step_s": found.longest_step,
            "laws": [law.to_json() for law in laws_of(self.rig_extended).values()],
            **picked(found, "values", "tried", "window"),
            "forecasts_deg": dict(zip(map(str, WINDOWS), found.forecasts, strict=True)),
            "course": found.drift.values,
            "changes": found.drift.changes,
            "course_errors_deg": found.drift.errors,
            "straight_lines_deg": found.lines,
            "points_of_lines": found.points,
            "coverage95": {"later": found.coverage[0], "interleaved": found.coverage[1]},
            "not_told_apart": [{"effect": a, "instead_of": b, "errors_deg": row} for a, b, row in found.others],
            "episodes": dict(zip(("fitted", "later", "interleaved"), found.counts, strict=True)),
            "rig": rig.name,
            "units": picked(rig.units, "pressure", "force"),
            "recordings_sha256": self.hashes,
        }

    @override
    def document(self, figures: bool = True) -> Document:
        found, joint = self.found, self.joint
        given, after, between = found.rows[0].forecast, found.rows[-1].forecast, found.rows[-1].interleaved
        tiles = Tiles((
            Tile("Later episodes", f"{number(after.value)}°", f"as configured {number(given.value)}°"),
            Tile("Interleaved episodes", MISSING if between is None else f"{number(between.value)}°"),
            Tile("Effects", str(len(found.effects)), ", ".join(found.effects)),
        ))  # fmt: skip
        forecasts = Table(
            ("Share of the fitted episodes, the last ones", "Error [°] on those that follow"),
            tuple((percent(w), number(e)) for w, e in zip(WINDOWS, found.forecasts, strict=True)),
            "Forecasts within the fitted episodes, by which the share was chosen",
        )
        drawn = (*law_figures(found, self.rig_extended), figure(found, joint.rig)) if figures else ()
        made = [("Rig", joint.rig.name), *((f"Recording {k}", value) for k, value in enumerate(self.hashes, 1))]
        blocks = (
            tiles, Findings(findings(found, joint)), errors_table(found), values_table(found, joint.rig),
            Section("All candidates", (tried_table(found),), 2, "candidates"),
            Section("Over the recording", (drift_table(found, joint.rig), *drawn, forecasts), 2, "drift"),
        )  # fmt: skip
        kicker, words_of = "What the model of a joint lacks", "close_loop of episodes"
        return page(kicker, joint.name, blocks, words_of, made, ABOUT, verdict(found))

    def to_dataframe(self) -> DataFrame:
        """A row for each number of the extended model: its value and 95 % interval by episode (needs pandas)."""
        return intervals_frame(self.found.values)

    @override
    def write_rigs(self, folder: Path) -> None:
        about = f"By pam_antagonist close_loop, from rig {self.joint.rig.name}. {self.sentence}"
        if self.next_rig is not None:
            write_rig(self.rig_extended, folder / self.next_rig, [about])
