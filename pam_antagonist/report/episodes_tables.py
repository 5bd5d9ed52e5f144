"""Tables and figures of what was found of a regulator-driven joint, and its values in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from pam_antagonist.diagnosis.episodes import PARTS, EpisodeDiagnosis
from pam_antagonist.inference.bootstrap import Interval
from pam_antagonist.report.document import (
    MISSING,
    Table,
    number,
    percent,
)
from pam_antagonist.report.figure import BAND, ESTIMATE, MODEL, SECOND, Axis, Band, Figure, Line, Panel
from pam_antagonist.report.result import frame_of
from pam_antagonist.rig import Rig
from pam_antagonist.rig.learned import Law, laws_of, value_path
from pam_antagonist.rig.units import readable, unit_of

if TYPE_CHECKING:
    from pandas import DataFrame

T = TypeVar("T")

_WORDS = {
    "friction": "constant (Coulomb) friction",
    "friction_by_pressure": "friction that grows with the joint's own pressures",
    "hysteresis": "hysteresis of the contraction force",
    "creep": "creep of the muscles",
}
_BY_SIGNAL = {
    "friction_by_signal": "friction that grows with",
    "load_by_signal": "a torque that depends on",
    "strength_by_signal": "strength of the muscles that depends on",
}


def in_words(effect: str) -> str:
    """An effect in words."""
    name, _, signal = effect.partition(": ")
    if name == "learned":
        place, _, argument = signal.partition(" by ")
        return f"{place}, which depends on {argument} (a learned law)"
    return f"{_BY_SIGNAL[name]} {signal}" if signal else _WORDS.get(name, name)


def interval(value: Interval | None, digits: int = 3) -> str:
    """A value with its interval, as text."""
    if value is None:
        return MISSING
    return f"{number(value.value, digits)} ({number(value.low, digits)} to {number(value.high, digits)})"


def times(factor: float, value: Interval) -> Interval:
    """An interval times a factor."""
    return Interval(*(factor * part for part in value))


def unit(rig: Rig, name: str) -> tuple[str, float]:
    """Unit in which a value is shown, and factor from the rig file's unit; torques may be per inertia."""
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


def value_name(rig: Rig, name: str) -> str:
    """Name of a value in a report."""
    title = name.removeprefix("effects.")
    effect = title.partition(".")[0]
    return f"{effect}, {list(rig.signals)[int(title[-1]) - 1]}" if effect in _BY_SIGNAL else title


def shown(rig: Rig, name: str, value: Interval, digits: int = 3) -> tuple[str, str, str]:
    """A number of the model as a report has it: its name, the value with its interval, and the unit."""
    written, factor = unit(rig, name)
    return value_name(rig, name), interval(times(factor, value), digits), written


def removes(value: Interval) -> str:
    """How much of the error an effect removes, in words."""
    low, high = percent(value.low), percent(value.high)
    return f"removes {percent(value.value)} of the squared error of unseen episodes ({low} to {high})"


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


def about_episodes(fitted: int, later: int, between: int) -> str:
    """How errors of episodes were computed, by the numbers of episodes."""
    return (
        f"Free runs of whole episodes from their first row; {fitted} episodes may be fitted, {later} later and "
        f"{between} interleaved ones are held out"
    )


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
        value, low, high = factor * np.array(values).T
        drawn = (
            Band("95 % interval by episode", parts, low, high, BAND, len(panels) > 1),
            Line("the number", parts, value, ESTIMATE, quiet=len(panels) > 1),
        )
        panels.append(Panel(Axis(), Axis(f"{value_name(rig, name)} [{shown}]", from_zero=True), drawn))
    panels[-1] = replace(panels[-1], x=Axis("Eighth of the recording"))
    about = "Errors and numbers of the extended model over the recording. What lies between the errors is drift."
    return Figure("Drift", about, tuple(panels))


def without_laws(values: Mapping[str, T]) -> dict[str, T]:
    """Values without those of learned laws, which a figure shows."""
    return {name: value for name, value in values.items() if ".learned." not in name}


def law_figures(diagnosis: EpisodeDiagnosis, extended: Rig) -> tuple[Figure, ...]:
    """The learned laws, each over what it depends on, in one figure; none without them."""
    panels: list[Panel] = []
    for k, law in laws_of(extended).items():
        rows = [diagnosis.values[value_path(k, node)] for node in range(1, len(law.nodes) + 1)]
        shown, factor = _unit_of_law(extended, law)
        value, low, high = factor * np.array(rows).T
        nodes = np.array(law.nodes)
        unit_shown = readable(law.argument_unit)
        drawn = (
            Band("95 % interval by episode", nodes * unit_shown.scale, low, high, BAND, bool(panels)),
            Line("the law", nodes * unit_shown.scale, value, ESTIMATE, quiet=bool(panels)),
        )
        across = Axis(f"{law.on} [{unit_shown.name}]")
        panels.append(Panel(across, Axis(f"{law.at} [{shown}]"), drawn))
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


def intervals_frame(values: Mapping[str, Interval]) -> DataFrame:
    """A row for each value: it, and its interval."""
    rows = [(name, *value) for name, value in values.items()]
    return frame_of(rows, ("value_of", "value", "low", "high"), "value_of")
