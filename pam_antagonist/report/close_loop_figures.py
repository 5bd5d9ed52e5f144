"""Figures of ``close_loop``: residuals before and after, their statistics, and what is left of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pam_antagonist.diagnosis import remaining
from pam_antagonist.diagnosis.remaining import RemainingResidual
from pam_antagonist.diagnosis.residual_statistics import Relation
from pam_antagonist.diagnosis.result import FoundEffect, HeldOutComparison, Residuals, SizeProfile
from pam_antagonist.inference.point import Span
from pam_antagonist.report.document import Block, Findings, Text, note
from pam_antagonist.report.figure import Axis, Band, Figure, Line, Panel, Points, Series
from pam_antagonist.report.figures import matrix, profile_panel, residual_figure
from pam_antagonist.report.style import ESTIMATE, MODEL, PAPER, QUIET, SECOND
from pam_antagonist.report.table import MISSING, Table, number, percent
from pam_antagonist.report.units import readable

if TYPE_CHECKING:
    from pam_antagonist.report.close_loop import DiagnoseResult

_NEAR = 4.0
"""Half width of a profile's plot, in standard errors."""
_SIGNED = (MODEL, PAPER, ESTIMATE)
_BLUES = (PAPER, MODEL)
_CERTAIN = 0.05
_SHOWN = 5.0
"""End of the colour scale, in multiples of the value that chance alone exceeds once in twenty times."""
_POINTS = 300
_DRAWN = 3
"""Number of residuals of each recording that are drawn over the signals that they depend on."""
_LEAST_SHARE = 0.5
"""A map is left out if all its shares are smaller and would show as 0 % [%]."""
_CELL = "{value:.0f} %"
_SIGNALS = ("voltage 1", "voltage 2", "pressure 1", "pressure 2", "angle", "velocity")
_KINDS = {"equation": "Equations", "sensor": "Sensors", "innovation": "Estimator's innovations"}
_ABOUT = (
    "On held-out data. Sensors: measurement minus model, which starts with the recording and gets the voltages only. "
    "Equations: errors of flow, torque and motion, where the model starts again from the measurement every fifth of a "
    "second, so that the error of one equation does not enter the next. Innovations: measured pressures minus the "
    "estimator's prediction. Each residual is compared with signals up to 2 s before it. Later signals do not count: "
    "in a closed loop, commands follow from residuals."
)
_ABOUT_DRIVEN = (
    "On held-out data: measurement minus model, which is driven by the measured angle. Each residual is compared with "
    "signals up to 2 s before it."
)


def residuals(found: DiagnoseResult) -> tuple[Figure, ...]:
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


def statistics(found: DiagnoseResult, with_figures: bool) -> tuple[Block, ...]:
    """Table and figure of the residuals of each recording with held-out data."""
    out: list[Block] = [Text(_ABOUT_DRIVEN if found.driven else _ABOUT)]
    models = ("recalibrated", "extended") if found.effects else ("recalibrated",)
    for part in found.recordings:
        if part.residuals is None:
            continue
        out.append(_table(part.recording, part.residuals, models))
        if with_figures:
            about = (
                "How strongly each residual (left) is correlated with what came before it (below). The number is the "
                "largest correlation of the whitened series, relative to the one that chance alone exceeds once in "
                "twenty times. Outside ±1 it is significant: the model lacks something that depends on the signal. "
                "The sign is that of the correlation."
            )
            figure = Figure(f"Correlations of the residuals, {part.recording}", about, _map(part.residuals, models))
            out.append(figure)
    return tuple(out)


def _table(recording: str, shown: Residuals, models: Sequence[str]) -> Table:
    rows: list[tuple[str, ...]] = []
    last = models[-1]
    kind = ""
    for k, row in enumerate(shown[last]):
        if row.kind != kind:
            kind = row.kind
            rows.append((_KINDS[kind], *[""] * (len(models) + 4)))
        times = [shown[model][k].rms / shown[model][k].noise for model in models]
        rows.append(
            (
                f"  {row.title}, RMS {number(row.rms, 2)} {row.unit}",
                *(number(value, 2) for value in times),
                percent(row.above_noise),
                number(row.memory_s, 2),
                _chance(row.whiteness_p),
                _strongest(row.relations),
            )
        )
    header = ("Residual", *(f"× noise, {model}" for model in models), "above noise", "memory [s]", "white: p", "after")
    caption = (
        f"Residuals of {recording} on held-out data. RMS and the columns from “above noise” on are of the {last} "
        "model. Above noise: share of the mean square that the sensors' noise does not explain. Memory: time between "
        "independent values. White: probability of such an autocorrelation in white noise. After: the signal with the "
        "most significant correlation (p < 0.05), and its lag."
    )
    return Table(header, tuple(rows), caption)


def _chance(p: float | None) -> str:
    if p is None or not np.isfinite(p):
        return MISSING
    return "< 0.001" if p < 1e-3 else f"{p:.3f}"


def _strongest(relations: Mapping[str, Relation]) -> str:
    significant = [(item.p, name, item.lag_s) for name, item in relations.items() if item.p < _CERTAIN]
    if not significant:
        return MISSING
    _, name, lag = min(significant)
    return f"{name}, {lag:.2g} s"


def _map(shown: Residuals, models: Sequence[str]) -> tuple[Panel, ...]:
    """One map for each model, one above the other."""
    known = [signal for signal in _SIGNALS if any(signal in row.relations for row in shown[models[0]])]
    grids = []
    for model in models:
        found = [[row.relations.get(signal) for signal in known] for row in shown[model]]
        cells = [[float("nan") if item is None else item.over_chance for item in line] for line in found]
        grids.append((model, np.array(cells, dtype=np.float64)))
    names = [row.title for row in shown[models[0]]]
    return matrix(grids, names, known, _SIGNED, (-_SHOWN, _SHOWN), "{value:.1f}×")


def left(found: Sequence[RemainingResidual], with_figures: bool) -> tuple[Block, ...]:
    """The remaining residual: in words, and drawn over the signals that it depends on."""
    out: list[Block] = [Findings(tuple(note(item.line()) for item in found))]
    if not with_figures:
        return tuple(out)
    for name in dict.fromkeys(item.recording for item in found):
        mine = [item for item in found if item.recording == name]
        kinds = list(mine[0].depends_on)
        shares = np.array([[100.0 * item.depends_on[kind] for kind in kinds] for item in mine])
        about = "Share of each residual's variance that one kind of dependence explains alone, minus what chance gives."
        rows = [item.channel for item in mine]
        if np.max(shares) >= _LEAST_SHARE:
            grid = matrix([("", shares)], rows, kinds, _BLUES, (0.0, 100.0), _CELL)
            out.append(Figure(f"What the remaining residual depends on, {name}", about, grid))
        widest = max(mine, key=lambda item: len(item.bands))
        power = np.array([[100.0 * item.bands.get(band, float("nan")) for band in widest.bands] for item in mine])
        about = "Share of each residual's power in each band of frequency. Equations are known up to 2.5 Hz."
        bands = [_short(band) for band in widest.bands]
        grid = matrix([("", power)], rows, bands, _BLUES, (0.0, 100.0), _CELL)
        out.append(Figure(f"Frequencies of the remaining residual, {name}", about, grid))
        clear = sorted(mine, key=lambda item: -item.times_noise * max(item.depends_on.values()))[:_DRAWN]
        out += [_drawn(item) for item in clear]
    return tuple(out)


def _short(band: str) -> str:
    return band.replace("below ", "< ").replace("above ", "> ").replace(" to ", "–")


def _drawn(item: RemainingResidual) -> Figure:
    """A residual over the two signals that it depends on most."""
    axes = item.around.axes()
    spread = {}
    for title, over in axes.items():
        means = remaining.means(item.values, over)
        spread[title] = float(np.var(means[:, 1])) if len(means) else 0.0
    chosen = sorted(spread, key=lambda title: -spread[title])[:2]
    velocity = item.around.velocity
    panels: list[Panel] = []
    every = max(1, len(item.values) // _POINTS)
    named: set[str] = set()
    for title in chosen:
        single = Points("residual", axes[title][::every], item.values[::every], QUIET, quiet=bool(named))
        parts: list[Series] = [single]
        groups: list[tuple[str, np.ndarray | None, str]]
        if velocity is None or title.startswith("Time"):
            groups = [("mean", None, MODEL)]
        else:
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
    return Figure(title, about, tuple(panels), beside=True)
