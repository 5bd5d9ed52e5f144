"""Figures of ``close_loop``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pam_antagonist.diagnosis.result import Diagnosis, HeldOutComparison
from pam_antagonist.report.close_loop import Profile
from pam_antagonist.report.figure import Figure, Points
from pam_antagonist.report.figures import profile_panel, residual_figure
from pam_antagonist.report.style import ESTIMATE, MODEL

_NEAR = 4.0
"""Standard errors that a profile shows."""


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
            f"Measurement minus model, means over {1e3 * trial.block_s:.0f} ms. Dashed: within these lines 95 % of the "
            f"values lie that the sensor's noise alone gives. {_held(part)}"
        )
        x = (np.arange(len(models[0][1]), dtype=np.float64) + 0.5) * trial.block_s
        title = f"{trial.name} (joint {trial.joint})"
        onset = experiment.onset if found.extended.effects else None
        if onset is not None:
            about += f" The line at {onset:.1f} s: from then on the effect acts."
        out.append(residual_figure(title, about, x, models, axes, experiment.noise, trial.name, onset))
    return tuple(out)


def _held(part: HeldOutComparison) -> str:
    from_s = part.experiment.errors_from * part.experiment.trial.dt
    return {
        "both": f"From {from_s:.0f} s on nothing was fitted.",
        "fitted": "All of it was fitted; other recordings are held out.",
        "held out": f"Held out as a whole. Only its first state was estimated, from its first {from_s:.0f} s.",
    }[part.role]


def profiles(sizes: Sequence[Profile]) -> tuple[Figure, ...]:
    """Profile likelihood of each size."""
    out = []
    for item in sizes:
        values, rise = np.array(item.values), np.array(item.rise)
        best, std = item.value, item.std
        near = np.abs(values - best) <= _NEAR * std
        if near.sum() < 3:
            near[:] = True
        x = np.linspace(values[near].min(), values[near].max(), 61)
        panel = profile_panel(
            f"{item.parameter} [{item.unit}]",
            "Rise of −2 log posterior [-]",
            [Points("tried", values[near], rise[near], MODEL)],
            ("by the standard error", x, ((x - best) / std) ** 2, ESTIMATE),
            3.84,
            182,
        )
        at = dict(zip(item.values, item.rise, strict=True))
        about = (
            "The number is held at each value and everything else is fitted again. Values below the dashed line lie in "
            "the 95 % interval. "
            f"At half the size the rise is {at[0.5 * best]:.3g}, at size 0 it is {at[0.0]:.3g}."
        )
        out.append(Figure(f"Profile likelihood of {item.parameter} ({item.recording})", about, (panel,)))
    return tuple(out)
