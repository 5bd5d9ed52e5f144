"""What ``close_loop`` says and draws: findings and assumptions in sentences, and figures of its numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from pam_antagonist.diagnosis import remaining, thresholds
from pam_antagonist.diagnosis.remaining import RemainingResidual
from pam_antagonist.diagnosis.result import Ambiguity, FoundEffect, HeldOutComparison, SizeProfile
from pam_antagonist.diagnosis.verdicts import UNEXPLAINED
from pam_antagonist.inference.point import Span
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.report.document import Block, Findings, Statement, Table, good, note, sentence, warn, words
from pam_antagonist.report.figure import (
    ESTIMATE,
    MODEL,
    QUIET,
    SECOND,
    TIME,
    Axis,
    Band,
    Figure,
    Line,
    Panel,
    Points,
    Reference,
    Region,
    Series,
)
from pam_antagonist.rig.units import readable
from pam_antagonist.shown import number, percent

if TYPE_CHECKING:
    from pam_antagonist.diagnosis.closed_loop import ClosedLoop

_NEAR = 4.0
"""Half width of a profile's plot, in standard errors."""
_LIMIT = 3.84
"""Rise of −2 log posterior at the end of a 95 % interval."""
_LEAST_SHARE = 0.005
"""A table is left out if all its shares are smaller and would show as 0 %."""
_POINTS = 300
_DRAWN = 3
"""Number of residuals of each recording that are drawn over the signals that they depend on."""


def findings(result: ClosedLoop) -> tuple[Statement, ...]:
    """Findings in addition to the verdict."""
    out = [warn(sentence(text)) for text in result.warnings]
    rivals = {item.other: item for item in result.ambiguities if item.ambiguous}
    for name in result.ambiguous_with:
        text = f"{_title(name)} would explain the data as well{_compared(rivals.get(name))}."
        out.append(warn(f"{text} To distinguish them: {result.experiment[name]}."))
    for item in result.ambiguities:
        if not item.ambiguous:
            out.append(good(f"{_title(item.other)} explains the data less well{_compared(item)}."))
    if result.effects and not result.ambiguous_with and not any(effect.alternatives for effect in result.effects):
        out.append(good("No other candidate explains the data nearly as well as what was found."))
    slides = [model.sliding for model in (result.errors.as_configured, result.errors.extended)]
    before, after = (None if item is None else item.rmse_sliding_nm for item in slides)
    if result.effects and before is not None and after is not None and before < after:
        out.append(note(
            f"While the joint slides, the rig as configured has the smaller error ({number(before, 2)} N m, extended "
            f"{number(after, 2)} N m). The reason: identify fits only the samples in which the joint slides. Here all "
            "samples count, and no law predicts the torque while the joint sticks."
        ))  # fmt: skip
    out += [
        warn(f"The residual of the {part.name} is above noise, and no effect explains it.")
        for part in result.parts
        if result.effects and part.verdict == UNEXPLAINED
    ]
    if result.base_friction_removed and any(part.name == "torque" for part in result.parts):
        out.append(note(
            "The rig file has Coulomb friction. It was removed before the test, so that every cause of a hysteresis "
            "loop was tested. The extended rig has friction as an effect instead."
        ))  # fmt: skip
    return (*out, *map(note, result.notes))


def kind_of(result: ClosedLoop) -> str:
    """Page of ``templates/words.yaml`` with the words of a diagnosis."""
    return "close_loop of trials" if result.held else "close_loop of a driven joint" if result.driven else "close_loop"


def calibration_findings(result: ClosedLoop) -> tuple[Statement, ...]:
    """The calibrations that the recordings need, with command line options; those of all values are in the rig file."""
    if not result.shared or result.held:
        return ()
    what = sentence("; ".join(item.in_words() for item in result.shared))
    if not result.corrections:
        return (warn(f"{what} Together with the options given, that is too much."),)
    text = f"{what} To correct that, add `{' '.join(result.corrections)}` to every command that reads these recordings."
    return (warn(f"{text} An extended rig file has it already: then the options are not needed."),)


def _title(name: str) -> str:
    return name.replace("_", " ").capitalize()


def _compared(item: Ambiguity | None) -> str:
    """The numbers behind a comparison under equal conditions."""
    if item is None:
        return ""
    mine, other = (number(value, 2) for value in item.residual)
    text = (
        f" {'as' if item.ambiguous else 'than'} {item.found}: {item.found} leaves {mine} {item.unit}, {item.other} "
        f"{other} {item.unit} (RMS; evidence {item.evidence:.1f}). They were compared {item.about.rstrip('.')}"
    )
    if item.size == item.size and item.ambiguous:
        text += f". In this comparison, {item.found} is {number(item.size, 2)} {item.size_unit}"
    return text


def assumed(result: ClosedLoop) -> tuple[tuple[str, str], ...]:
    """Assumptions of the diagnosis."""
    needed = (
        f"An effect needs an evidence (ΔBIC) of {thresholds.STRONG:g}. The first effect has to explain "
        f"{100 * thresholds.FIRST_SHARE:.0f} % of the excess over noise on held-out data. Each further effect has to "
        f"explain {100 * thresholds.FURTHER_SHARE:.0f} % of the whole excess, and all effects together "
        f"{100 * thresholds.EXPLAINED:.0f} %. The threshold of the evidence comes from statistics, the shares from "
        "simulated joints."
    )
    page = f"{kind_of(result)}, assumed"
    tried = {item.effect for item in result.ranking}
    tested = ", ".join(name for name in CATALOGUE if name in tried)
    catalogue = ("Catalogue", f"{tested}. Anything else is a law that is measured, or unexplained.")
    return *words(page), ("Thresholds", needed), *(() if result.driven else (catalogue,))


def residuals(result: ClosedLoop) -> tuple[Figure, ...]:
    """Residual of every channel of every recording, recalibrated and extended."""
    shown = [("recalibrated", MODEL), *([("extended", ESTIMATE)] if result.effects else [])]
    return tuple(_residual(part, shown) for part in result.compared)


def _residual(part: HeldOutComparison, shown: Sequence[tuple[str, str]]) -> Figure:
    experiment, trial = part.experiment, part.experiment.trial
    count, edges = len(experiment.measured), experiment.edges(part.points["extended"])
    models = [(name, part.residual(name)[:count], color) for name, color in shown]
    x = (np.arange(len(models[0][1]), dtype=np.float64) + 0.5) * trial.block_s
    held = {"fitted": (), "held out": (Span(0.0, float(x[-1])),)}.get(part.role, experiment.held_parts)
    panels = []
    for k, (name, unit, scale) in enumerate(experiment.titles):
        parts: list[Series] = [Region(begin, min(end, float(x[-1]))) for begin, end, _ in held]
        parts += [Line(model, x, values[:, k] * scale, color, quiet=k > 0) for model, values, color in models]
        parts += [Reference(edge, f"{edge:.1f} s" if k == 0 else "", vertical=True) for edge in edges]
        parts += [Reference(sign * 2.0 * float(experiment.noise[k]) * scale) for sign in (-1.0, 1.0)]
        height = 230 if len(experiment.titles) == 1 else 170
        panels.append(Panel(TIME, Axis(f"{name} [{unit}]"), tuple(parts), height))
    about = (
        f"Measurement minus model, means over {1e3 * trial.block_s:.0f} ms. The sensor's noise alone stays between "
        f"the dashed lines 95 % of the time. {_held(part)}"
    )
    if edges:
        about += f" At the line{'s' if len(edges) > 1 else ''} an effect begins or ends."
    return Figure(f"{trial.name} (joint {trial.joint})", about, tuple(panels), trial.name)


def _held(part: HeldOutComparison) -> str:
    from_s = part.experiment.errors_from * part.experiment.trial.dt
    if part.experiment.split is not None:
        parts = ", ".join(f"{begin:.0f} to {end:.0f}" for begin, end, _ in part.experiment.held_parts)
        return f"Shaded: what was held out, {parts} s. No fit used it."
    return {
        "both": f"Shaded: the end, from {from_s:.4g} s on, was held out. No fit used it.",
        "fitted": "All of it was fitted; other recordings are held out.",
        "held out": f"Shaded: all of it was held out. Its first {from_s:.3g} s gave its initial state.",
    }[part.role]


def profiles(sizes: Sequence[SizeProfile]) -> tuple[Figure, ...]:
    """Profile likelihood of each size, with the parabola of its standard error."""
    out = []
    for item in sizes:
        values, rise, unit = np.array(item.values), np.array(item.rise), readable(item.unit, item.value)
        near = np.abs(values - item.value) <= _NEAR * item.std
        if near.sum() < 3:
            near[:] = True
        x = np.linspace(values[near].min(), values[near].max(), 61)
        parabola, ends = ((x - item.value) / item.std) ** 2, x[[0, -1]] * unit.scale
        parts = (
            Points("tried", values[near] * unit.scale, rise[near], MODEL),
            Line("by the standard error", x * unit.scale, parabola, ESTIMATE, "dot", 1.6),
            Line("95 %", ends, np.full(2, _LIMIT), QUIET, "dash", 1.6),
        )
        at = dict(zip(item.values, item.rise, strict=True))
        about = (
            f"{item.parameter}: {meaning_of(*item.parameter.split('.'))}. The number is held at each value and "
            "everything else is fitted again. Values below the dashed line lie in the 95 % interval. "
            f"At half the size the rise is {number(at[0.5 * item.value])}, at size 0 it is {number(at[0.0])}."
        )
        panel = Panel(Axis(f"{item.parameter} [{unit.name}]"), Axis("Rise of −2 log posterior [-]"), parts, 206)
        out.append(Figure(f"Profile likelihood of {item.parameter} ({item.recording})", about, (panel,)))
    return tuple(out)


def meaning_of(effect: str, parameter: str) -> str:
    """What a parameter of the catalogue is; of a learned law, a value of its table."""
    known = CATALOGUE[effect].parameters if effect in CATALOGUE else ()
    return next((item.meaning for item in known if item.name == parameter), "value of the law")


def laws(effects: Sequence[FoundEffect]) -> tuple[Figure, ...]:
    """The table of each learned law."""
    out = []
    for law in (effect.law for effect in effects):
        if law is None or len(law.nodes) < 2:
            continue
        at, of = readable(law.argument_unit), readable(law.unit)
        x, y = np.array(law.nodes) * at.scale, np.array(law.values) * of.scale
        wide = 1.96 * np.array(law.std or (0.0,) * len(x)) * of.scale
        series = (
            Band("95 % interval", x, y - wide, y + wide, ESTIMATE), Line("law", x, y, ESTIMATE),
            Points("nodes", x, y, ESTIMATE, quiet=True),
        )  # fmt: skip
        across, up = (f"{name.replace('_', ' ')} [{unit.name}]" for name, unit in ((law.argument, at), (law.at, of)))
        about = "The measured law, over the range that was seen: outside of it, the law is constant."
        out.append(Figure(f"Learned law: {law.in_words()}", about, (Panel(Axis(across), Axis(up), series),)))
    return tuple(out)


def left(remaining: Sequence[RemainingResidual], with_figures: bool) -> tuple[Block, ...]:
    """The remaining residual: in words, as shares, and drawn over the signals that it depends on."""
    out: list[Block] = [Findings(tuple(note(item.line()) for item in remaining))]
    for about, shares in (
        (
            "Share of each residual's variance that one kind of dependence explains alone, minus what chance gives",
            [item.depends_on for item in remaining],
        ),
        (
            "Share of each residual's power in each band of frequency. Equations are known up to 2.5 Hz",
            [item.bands for item in remaining],
        ),
    ):
        if max((share for each in shares for share in each.values()), default=0.0) >= _LEAST_SHARE:
            keys = tuple(dict.fromkeys(key for each in shares for key in each))
            rows = tuple(
                (f"{item.recording}: {item.channel}", *(percent(each.get(key)) for key in keys))
                for item, each in zip(remaining, shares, strict=True)
            )
            out.append(Table(("Residual", *keys), rows, about))
    for name in dict.fromkeys(item.recording for item in remaining if with_figures):
        mine = [item for item in remaining if item.recording == name]
        out += map(_drawn, sorted(mine, key=lambda item: -item.times_noise * max(item.depends_on.values()))[:_DRAWN])
    return tuple(out)


def _drawn(item: RemainingResidual) -> Figure:
    """A residual over the two signals that it depends on most."""
    axes, velocity = item.around.axes(), item.around.velocity

    def spread(title: str) -> float:
        means = remaining.means(item.values, axes[title])
        return float(np.var(means[:, 1])) if len(means) else 0.0

    every, panels = max(1, len(item.values) // _POINTS), list[Panel]()
    named: set[str] = set()
    for title in sorted(axes, key=spread, reverse=True)[:2]:
        parts: list[Series] = [
            Points("residual", axes[title][::every], item.values[::every], QUIET, quiet=bool(panels))
        ]
        groups: list[tuple[str, np.ndarray | None, str]] = [("mean", None, MODEL)]
        if velocity is not None and not title.startswith("Time"):
            groups = [("angle rising", velocity > 0.0, ESTIMATE), ("angle falling", velocity < 0.0, SECOND)]
        for name, which, color in groups:
            means = remaining.means(item.values, axes[title], which)
            parts.append(Line(name, means[:, 0], means[:, 1], color, width=1.7, quiet=name in named))
            named.add(name)
        # The second panel shares the vertical axis; a second title would overlap the first one on a phone.
        vertical = "" if panels else f"{item.channel.capitalize()} [{item.unit}]"
        panels.append(Panel(Axis(title), Axis(vertical), tuple(parts), 222))
    form = f" A sparse regression suggests {item.form}." if item.form.terms else ""
    about = f"The residual over the two signals on which it depends most, and means over equal numbers of values.{form}"
    title = f"What the model lacks in {item.channel}, {item.recording}"
    return Figure(title, about, tuple(panels), side_by_side=True)
