"""Figures of ``close_loop``."""

from __future__ import annotations

from typing import Any

import numpy as np

from pam_antagonist.diagnosis.heldout import Compared
from pam_antagonist.diagnosis.result import Diagnosis
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.trial import BLOCK
from pam_antagonist.report import figures
from pam_antagonist.report.curves import Curve, chart
from pam_antagonist.report.figures import Clock, Level, Line, Panel
from pam_antagonist.report.html import Figure
from pam_antagonist.report.style import ESTIMATE, MODEL, QUIET

_NEAR = 4.0
"""Standard errors that a profile shows."""


def residuals(found: Diagnosis) -> tuple[Figure, ...]:
    """Residual of every channel of every recording, recalibrated and extended."""
    out = []
    for part in found.compared:
        experiment = part.experiment
        shown = [("recalibrated", MODEL), *([("extended", ESTIMATE)] if found.extended.effects else [])]
        count = len(experiment.measured)
        curves = [(name, experiment.residual(part.points[name], whole=True)[:count], color) for name, color in shown]
        panels = []
        for k, (title, unit, scale) in enumerate(experiment.titles):
            lines = [Line(name, values[:, k] * scale, color, quiet=k > 0) for name, values, color in curves]
            noise = experiment.noise[k] * scale
            levels = [Level(sign * 2.0 * noise, "", QUIET) for sign in (-1.0, 1.0)]
            panels.append(Panel(f"{title} [{unit}]", [*lines, *levels], 170))
        about = (
            f"Measurement minus model, means over {BLOCK} samples. Dashed: within these lines 95 % of the values lie "
            f"that the sensor's noise alone gives. {_held(part)}"
        )
        plot = figures.stack(panels, _clock(experiment, len(curves[0][1])))
        out.append(
            Figure(f"{experiment.trial.name} (joint {experiment.trial.joint})", about, plot, experiment.trial.name)
        )
    return tuple(out)


def _held(part: Compared) -> str:
    from_s = part.experiment.fitted * part.experiment.trial.dt
    return {
        "both": f"From {from_s:.0f} s on nothing was fitted.",
        "fitted": "All of it was fitted; other recordings are held out.",
        "held out": f"Held out as a whole: but for its first state, told from its first {from_s:.0f} s, nothing of it "
        "was fitted.",
    }[part.role]


def _clock(experiment: Experiment, count: int) -> Clock:
    step = BLOCK * experiment.trial.dt
    return Clock(np.asarray((np.arange(count) + 0.5) * step, dtype=np.float64), np.zeros(count, dtype=np.int64))


def profiles(document: dict[str, Any]) -> tuple[Figure, ...]:
    """Profile likelihood of each size."""
    out = []
    for item in document["profiles"]:
        values, rise = np.array(item["values"]), np.array(item["rise"])
        best, std = item["value"], item["std"]
        near = np.abs(values - best) <= _NEAR * std
        if near.sum() < 3:
            near[:] = True
        x = np.linspace(values[near].min(), values[near].max(), 61)
        shown = [
            Curve("tried", values[near], rise[near], MODEL, points=True),
            Curve("by the standard error", x, ((x - best) / std) ** 2, ESTIMATE),
            Curve("95 %", x[[0, -1]], np.array([3.84, 3.84]), QUIET, dash="dash"),
        ]
        plot = chart([(f"{item['parameter']} [{item['unit']}]", "Rise of −2 log posterior [-]", shown)], 260)
        at = dict(zip(item["values"], item["rise"], strict=True))
        about = (
            "Everything else at its best while this number is held; below the dashed line it is as good as the best. "
            f"At half of it the rise is {at[0.5 * best]:.3g}, without it {at[0.0]:.3g}."
        )
        out.append(Figure(f"Profile likelihood of {item['parameter']} ({item['recording']})", about, plot, ""))
    return tuple(out)
