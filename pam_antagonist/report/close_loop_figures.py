"""Figures of ``close_loop``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pam_antagonist.diagnosis.result import Diagnosis, FoundEffect, HeldOutComparison, SizeProfile
from pam_antagonist.inference.point import Span
from pam_antagonist.report.figure import Axis, Band, Figure, Line, Panel, Points
from pam_antagonist.report.figures import profile_panel, residual_figure
from pam_antagonist.report.style import ESTIMATE, MODEL
from pam_antagonist.report.table import number
from pam_antagonist.report.units import readable

_NEAR = 4.0
"""Half width of a profile's plot, in standard errors."""


def residuals(found: Diagnosis) -> tuple[Figure, ...]:
    """Residual of every channel of every recording, recalibrated and extended."""
    out = []
    shown = [("recalibrated", MODEL), *([("extended", ESTIMATE)] if found.extended.effects else [])]
    for part in found.compared:
        experiment, trial = part.experiment, part.experiment.trial
        count = len(experiment.measured)
        models = [(name, experiment.residual(part.points[name], whole=True)[:count], color) for name, color in shown]
        axes = [(f"{name} [{unit}]", scale) for name, unit, scale in experiment.titles]
        about = (
            f"Measurement minus model, means over {1e3 * trial.block_s:.0f} ms. The sensor's noise alone stays between "
            f"the dashed lines 95 % of the time. {_held(part)}"
        )
        x = (np.arange(len(models[0][1]), dtype=np.float64) + 0.5) * trial.block_s
        title = f"{trial.name} (joint {trial.joint})"
        edges = experiment.edges(part.points["extended"])
        if edges:
            about += f" At the line{'s' if len(edges) > 1 else ''} an effect begins or ends."
        held: tuple[Span, ...] = () if part.role == "fitted" else experiment.held_parts
        if part.role == "held out":
            held = (Span(0.0, float(x[-1])),)
        out.append(residual_figure(title, about, x, models, axes, experiment.noise, trial.name, edges, held))
    return tuple(out)


def _held(part: HeldOutComparison) -> str:
    from_s = part.experiment.errors_from * part.experiment.trial.dt
    if part.experiment.split is not None:
        parts = ", ".join(f"{begin:.0f} to {end:.0f}" for begin, end in part.experiment.held_parts)
        return f"Shaded: what was held out, {parts} s. No fit used it."
    return {
        "both": f"Shaded: the end, from {from_s:.4g} s on, was held out. No fit used it.",
        "fitted": "All of it was fitted; other recordings are held out.",
        "held out": f"Shaded: all of it was held out. Its first {from_s:.3g} s gave its initial state.",
    }[part.role]


def profiles(sizes: Sequence[SizeProfile]) -> tuple[Figure, ...]:
    """Profile likelihood of each size."""
    out = []
    for item in sizes:
        values, rise = np.array(item.values), np.array(item.rise)
        best, std = item.value, item.std
        near = np.abs(values - best) <= _NEAR * std
        if near.sum() < 3:
            near[:] = True
        x = np.linspace(values[near].min(), values[near].max(), 61)
        unit = readable(item.unit, best)
        panel = profile_panel(
            f"{item.parameter} [{unit.name}]",
            "Rise of −2 log posterior [-]",
            [Points("tried", values[near] * unit.scale, rise[near], MODEL)],
            ("by the standard error", x * unit.scale, ((x - best) / std) ** 2, ESTIMATE),
            3.84,
            206,
        )
        at = dict(zip(item.values, item.rise, strict=True))
        about = (
            "The number is held at each value and everything else is fitted again. Values below the dashed line lie in "
            "the 95 % interval. "
            f"At half the size the rise is {number(at[0.5 * best])}, at size 0 it is {number(at[0.0])}."
        )
        out.append(Figure(f"Profile likelihood of {item.parameter} ({item.recording})", about, (panel,)))
    return tuple(out)


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
        panel = Panel(Axis(across), Axis(up), series)
        about = "The measured law, over the range that was seen: outside of it, the law is constant."
        out.append(Figure(f"Learned law: {law.in_words()}", about, (panel,)))
    return tuple(out)
