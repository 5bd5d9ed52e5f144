"""The report of ``close_loop`` on a regulator-driven joint: sentences, tables and a figure of its typed result."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from pam_antagonist.diagnosis.bootstrap import Interval
from pam_antagonist.diagnosis.episodes import WINDOWS, EpisodeDiagnosis, Row
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.report.document import Block, Document, Finding, Findings, Text, Tile, Tiles, background
from pam_antagonist.report.figure import Axis, Figure, Line, Panel
from pam_antagonist.report.style import MODEL, SECOND
from pam_antagonist.report.table import MISSING, Table, number, percent
from pam_antagonist.report.units import readable, unit_of
from pam_antagonist.rig import Rig

_WORDS = {
    "friction": "constant (Coulomb) friction",
    "friction_by_pressure": "friction that grows with the joint's own pressures",
    "hysteresis": "hysteresis of the contraction force",
    "creep": "creep of the muscles",
}
_BY_SIGNAL = {
    "friction_by_signal": "friction that grows with",
    "load_by_signal": "a torque that goes with",
    "strength_by_signal": "strength of the muscles that goes with",
}
_DRIFT = 0.8
"""A model of the last episodes that errs by less than this times that of all of them shows a drift."""


def in_words(effect: str) -> str:
    """An effect as a sentence says it.

    Args:
        effect: its name, with the signal by which it goes.
    """
    name, _, signal = effect.partition(": ")
    return f"{_BY_SIGNAL[name]} {signal}" if signal else _WORDS.get(name, name)


def interval(value: Interval | None, digits: int = 3) -> str:
    """A value with its interval."""
    if value is None:
        return MISSING
    return f"{number(value.value, digits)} ({number(value.low, digits)} to {number(value.high, digits)})"


def unit(rig: Rig, name: str) -> tuple[str, float]:
    """Unit in which a value is shown, and how many of it are one of the rig file's; torques may be per inertia.

    Args:
        rig: whose units count.
        name: dotted path of the value.
    """
    per_inertia = rig.units.force == "per_inertia"
    lever, inertia = rig.geometry.radius, rig.joint.inertia
    if name.endswith("at the middle length"):
        return ("rad/s² a bar", 1e5 * lever / inertia) if per_inertia else ("cm²", 1e4)
    known = unit_of(rig, name)
    if known == "1/SI":
        return "% a bar", 1e7
    if not per_inertia:
        return readable(known).name, readable(known).scale
    by_inertia = {
        "N m/rad": ("1/s²", 1.0), "N m s/rad": ("1/s", 1.0), "N m": ("rad/s²", 1.0), "N m/Pa": ("rad/s² a bar", 1e5),
        "N m/SI": ("rad/s² a bar", 1e5), "N": ("rad/s²", lever),
    }  # fmt: skip
    shown, factor = by_inertia.get(known, (known, inertia))
    return shown, factor / inertia


def verdict(found: EpisodeDiagnosis) -> str:
    """What was found, in one or two sentences."""
    before = next(row for row in found.rows if row.model.startswith("mechanics"))
    after = found.rows[-1]
    if not found.effects:
        return f"No effect that was offered is needed: the error on later episodes is {number(_later(before).value)}°."
    words = [in_words(effect) for effect in found.effects]
    listed = words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
    return (
        f"What the model lacks is {listed}. The error on later episodes falls from {number(_later(before).value)}° to "
        f"{number(_later(after).value)}°, both models fitted to the same episodes."
    )


def _later(row: Row) -> Interval:
    return row.later if row.recent is None else row.recent


def findings(found: EpisodeDiagnosis, joint: PressureDriven) -> tuple[Finding, ...]:
    """Statements that the numbers support."""
    out = []
    last = max(item.round for item in found.tried)
    not_needed = [item for item in found.tried if item.round == last and not item.taken]
    for item in not_needed:
        how = "was not fitted, its score is lower than the others'" if item.removed is None else (
            f"removes {percent(item.removed.value)} of the squared error of unseen episodes "
            f"({percent(item.removed.low)} to {percent(item.removed.high)})"
        )  # fmt: skip
        name = in_words(item.name)
        out.append(Finding("note", f"{name[:1].upper()}{name[1:]} is not needed beside these: it {how}."))
    whole, recent = found.rows[-1].later, found.rows[-1].recent
    if found.window < 1.0 and recent is not None:
        kind: Literal["warn", "note"] = "warn" if recent.value < _DRIFT * whole.value else "note"
        out.append(
            Finding(
                kind,
                f"The rig drifts: fitted to the last {percent(found.window)} of the fitted episodes, the model errs by "
                f"{number(recent.value)}° on later ones, fitted to all of them by {number(whole.value)}°. The share "
                "was chosen by forecasts within the fitted episodes.",
            )
        )
    if found.ratio is not None and found.effects:
        out.append(
            Finding(
                "note",
                f"On interleaved episodes the extended model leaves {interval(found.ratio)} of the squared error of "
                "the model with Coulomb friction alone.",
            )
        )
    units = joint.rig.units
    if units.force == "per_inertia":
        out.append(
            Finding(
                "note", "Forces are known per inertia only: torque, areas and stiffness in their units are not told."
            )
        )
    if units.pressure == "unknown":
        out.append(
            Finding(
                "note",
                "Gain and offset of the pressures are stand-ins: a bar is one of the recording only.",
            )
        )
    if joint.left_out:
        out.append(Finding("warn", f"{joint.left_out} episodes lack pressures, signals or the first angle: left out."))
    return tuple(out)


def errors_table(found: EpisodeDiagnosis) -> Table:
    """Errors of all models on episodes that no fit and no choice has seen."""
    rows = tuple(
        (row.model, interval(row.later), interval(row.recent), interval(row.interleaved)) for row in found.rows
    )
    head = (
        "RMSE of the angle [°], 95 % interval by episode", "later, all before fitted",
        f"later, last {percent(found.window)} before", "interleaved",
    )  # fmt: skip
    fitted, later, between = found.counts
    return Table(
        head, rows,
        f"Free runs of whole episodes from their first row; {fitted} episodes may be fitted, {later} later and "
        f"{between} interleaved ones are held out",
    )  # fmt: skip


def values_table(found: EpisodeDiagnosis, rig: Rig) -> Table:
    """Numbers of the extended model, and their course over the recording."""
    rows = []
    names = list(rig.signals)
    for name, value in found.values.items():
        shown, factor = unit(rig, name)
        course = "  ".join(number(part * factor, 2) for part in found.course.get(name, ()))
        title = name.removeprefix("effects.")
        effect = title.partition(".")[0]
        if effect in _BY_SIGNAL:
            title = f"{effect}, {names[int(title[-1]) - 1]}"
        rows.append((title, interval(Interval(*(factor * part for part in value))), shown, course))
    return Table(
        ("Value", "95 % interval by episode", "Unit", "Over the recording, in eight parts"), tuple(rows),
        f"The extended model, fitted to the last {percent(found.window)} of the fitted episodes, and to each part",
    )  # fmt: skip


def tried_table(found: EpisodeDiagnosis) -> Table:
    """All candidates, by rounds."""
    rows = tuple(
        (
            f"{item.round}. {item.name}", percent(item.score),
            MISSING if item.removed is None
            else f"{percent(item.removed.value)} ({percent(item.removed.low)} to {percent(item.removed.high)})",
            "taken" if item.taken else "",
        )
        for item in found.tried
    )  # fmt: skip
    return Table(
        ("Candidate", "Score", "Squared error removed, corrected interval", ""), rows,
        "Score: to first order, of fitted episodes; removed: of episodes that the fit has not seen. Intervals are "
        "wider by as many candidates as were offered",
    )  # fmt: skip


def summary(found: EpisodeDiagnosis, joint: PressureDriven) -> tuple[Block, ...]:
    """What the terminal shows."""
    return Text(verdict(found)), Findings(findings(found, joint)), errors_table(found), values_table(found, joint.rig)


def figure(found: EpisodeDiagnosis) -> Figure:
    """The drift: errors over the recording."""
    parts = np.arange(1.0, len(found.course_errors) + 1.0)
    one, own = (np.array([pair[k] for pair in found.course_errors]) for k in (0, 1))
    series = (
        Line("fitted to all that may be fitted", parts, one, MODEL),
        Line("fitted to each part", parts, own, SECOND),
    )
    panel = Panel(Axis("Eighth of the recording"), Axis("RMSE [°]", from_zero=True), series)
    about = "Errors of the extended model over the recording. What lies between the curves is drift of its numbers."
    return Figure("Drift", about, (panel,))


def document(found: EpisodeDiagnosis, joint: PressureDriven, hashes: tuple[str, ...], with_figures: bool) -> Document:
    """The report.

    Args:
        found: the result.
        joint: the episodes.
        hashes: SHA-256 of the recordings.
        with_figures: False leaves the figure out.
    """
    after = found.rows[-1]
    tiles = Tiles((
        Tile("Later episodes", f"{number(_later(after).value)}°", "extended model"),
        Tile("Interleaved episodes", MISSING if after.interleaved is None else f"{number(after.interleaved.value)}°"),
        Tile("Effects", str(len(found.effects)), ", ".join(found.effects)),
    ))  # fmt: skip
    forecasts = Table(
        ("Share of the fitted episodes, the last ones", "Error [°] on those that follow"),
        tuple((percent(w), number(e)) for w, e in zip(WINDOWS, found.forecasts, strict=True)),
        "Forecasts within the fitted episodes, by which the share was chosen",
    )
    definitions = (
        ("Later", "Episodes at the end of the recording, or of another one; no fit and no choice sees them."),
        ("Interleaved", "Every fifth episode of what comes before; no fit and no choice sees them either."),
        ("Interval", "A bootstrap of blocks of ten neighbouring episodes."),
    )
    blocks: tuple[Block, ...] = (
        Text("A joint driven by pressure regulators, in many short recordings.", "lede"),
        Text(verdict(found), "verdict"), tiles, Findings(findings(found, joint)), errors_table(found),
        values_table(found, joint.rig), tried_table(found),
        *((figure(found),) if with_figures else ()), forecasts,
        *background(definitions, [("Rig", joint.rig.name), *((f"Recording {k}", h) for k, h in enumerate(hashes, 1))]),
    )  # fmt: skip
    return Document("What the model of a joint lacks", joint.name, blocks)


def numbers(found: EpisodeDiagnosis, joint: PressureDriven, hashes: tuple[str, ...]) -> dict[str, Any]:
    """What ``report.json`` holds; intervals are value, lower and upper end.

    Args:
        found: the result.
        joint: the episodes.
        hashes: SHA-256 of the recordings.
    """
    return {
        "verdict": "effect" if found.effects else "none",
        "sentence": verdict(found),
        "effects": found.effects,
        "errors_deg": found.rows,
        "ratio_to_coulomb_interleaved": found.ratio,
        "values": found.values,
        "tried": found.tried,
        "window": found.window,
        "forecasts_deg": dict(zip(map(str, WINDOWS), found.forecasts, strict=True)),
        "course": found.course,
        "course_errors_deg": found.course_errors,
        "episodes": {"fitted": found.counts[0], "later": found.counts[1], "interleaved": found.counts[2]},
        "rig": joint.rig.name,
        "units": {"pressure": joint.rig.units.pressure, "force": joint.rig.units.force},
        "recordings_sha256": hashes,
    }
