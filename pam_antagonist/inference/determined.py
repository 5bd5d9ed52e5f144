"""Whether recordings determine a parameter: one rule for terminal, report and Python.

A standard error is the curvature of the posterior at the values where a search ended. It is small as well where the
search stopped too early, where the model is wrong, or where the posterior is no parabola. So an identified value is
*determined* if four things hold:

* it is no bound of the search, and not more than three standard deviations of the prior from the rig file's value;
* the posterior falls on both sides (its profile);
* its error is less than half of the prior's standard deviation. The error is the standard error, widened to the profile
  where that is flatter, and what the value moves beyond its 95 % interval: to the optimum, if the search has not
  arrived there, or where fewer data are fitted; and by what of the residuals is no noise, at worst;
* its 95 % interval does not contain 0, unless it was 0 in the rig file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.joint_fit import JointFit
from pam_antagonist.inference.profile import Profile, rises

_NARROWED = 0.5
"""Largest error of a determined parameter, over the standard deviation of its prior."""
_NORMAL = 1.96
_PARABOLA = 2.0
"""Rise of the loss at two standard errors by the standard error alone."""
_LASTING = 2.0
"""Blocks per independent one from which on a residual lasts; white noise has 1."""
_AT = 1e-6
"""Distance from a bound, in standard deviations of the prior, that only rounding makes."""
_FLAT = 0.5
"""A profile is flatter than the standard error says if it rises by less than this share of the parabola."""
_FAR = 3.0
"""Distance from the rig file's value, in standard deviations of the prior, that contradicts the prior."""


@dataclass(frozen=True)
class Evidence:
    """What is known about one identified value.

    Attributes:
        value: identified.
        start: in the rig file.
        prior_std: standard deviation of the prior.
        std: standard error, of the curvature at the optimum.
        moves: how far the optimum moves beyond its 95 % interval, in the parameter's unit.
        misfit: how far errors of the model may have moved it at worst, likewise.
        rise: of the loss at two standard errors, the mean of both sides.
        bound: bound of the search that the value met; None for none.
    """

    value: float
    start: float
    prior_std: float
    std: float
    moves: float = 0.0
    misfit: float = 0.0
    rise: float = _PARABOLA
    bound: float | None = None

    @property
    def error(self) -> float:
        """Standard error by the profile, and movement, together; infinite where the posterior does not fall."""
        if self.rise <= 0.0:
            return math.inf
        flatter = math.sqrt(_PARABOLA / self.rise) if self.rise < _FLAT * _PARABOLA else 1.0
        return math.hypot(self.std * flatter, self.moves, self.misfit)

    @property
    def determined(self) -> bool:
        """Whether the recordings determine the value."""
        return not self.reason

    @property
    def reason(self) -> str:
        """Why the value is not determined, in few words; empty where it is."""
        if self.bound is not None:
            return "met a bound"
        wide = self.error >= _NARROWED * self.prior_std
        unsigned = self.start != 0.0 and _NORMAL * self.error >= abs(self.value)
        if wide and abs(self.value - self.start) <= self.prior_std and self.std >= _NARROWED * self.prior_std:
            return "stays near its prior"
        if not math.isfinite(self.error):
            return "flat profile"
        if (wide or unsigned) and self.misfit > max(self.std, self.moves):
            return "errors of the model may have moved it"
        if (wide or unsigned) and self.moves > self.std:
            return "depends on the part that is fitted"
        if wide:
            return "moved, but uncertain"
        if unsigned:
            return "uncertain by more than its value"
        return "contradicts its prior" if abs(self.value - self.start) > _FAR * self.prior_std else ""


def evidence(found: JointFit, inner: JointFit, profiles: tuple[Profile, ...] = ()) -> dict[str, Evidence]:
    """What is known about each parameter of a fit, by name.

    Args:
        found: the fit.
        inner: the same fit of fewer data.
        profiles: of some parameters.
    """
    values, stds, fewer, rise = found.values, found.std, inner.values, rises(found)
    misfit = _misfits(found)
    drawn = {item.name: item for item in profiles}
    out = {}
    for k, item in enumerate(found.problem.free):
        name, std = item.name, stds[item.name]
        moves = [abs(fewer[name] - values[name])]
        if found.step is not None:
            moves.append(abs(float(found.step[k])) * item.prior_std)
        mean, slope = float(rise[k].mean()), abs(float(rise[k, 1] - rise[k, 0]))
        if mean > 0.0:
            moves.append(std * slope / (2.0 * mean))  # the lowest point of the parabola through both sides
        if name in drawn:
            profile = drawn[name]
            moves.append(abs(float(profile.value[int(np.argmin(profile.loss))]) - values[name]))
        met = [bound for bound in (item.low, item.high) if abs(values[name] - bound) <= _AT * item.prior_std]
        out[name] = Evidence(
            values[name],
            item.start,
            item.prior_std,
            std,
            max(0.0, max(moves) - _NORMAL * std),
            float(misfit[k]) * item.prior_std,
            mean,
            met[0] if met else None,
        )
    return out


def _misfits(found: JointFit) -> NDArray[np.float64]:
    """How far errors of the model may move each parameter (F,), in units of the prior.

    White residuals of the size of a sensor's noise move it by its standard error. What is larger and lasts from block
    to block is an error of the model. At worst it has the form of the parameter's derivative: by the inequality of
    Cauchy and Schwarz, a channel then moves the parameter by the root of its excess over noise, in independent blocks,
    times the channel's share of the standard error.
    """
    problem, count = found.problem, len(found.problem.free)
    total = np.zeros(count)
    slopes = problem.local_jacobians(found.theta)
    for index, (residual, slope) in enumerate(zip(problem.residuals(found.theta), slopes, strict=True)):
        trial, turned = problem.trials[index], problem.map(index) @ found.full[:, :count]
        for column, channel in enumerate(problem.counted(trial)):
            left, memory = residual[:, column], found.memory[index][column]
            size, noise = float(np.nanmean(left**2)), trial.noise(channel) ** 2
            if memory < _LASTING or size <= noise:
                continue
            scale = found.weights[index][column] ** 2 * memory
            share = np.sum((np.nan_to_num(slope[:, column]) @ turned) ** 2, axis=0) / scale
            total += share * np.isfinite(left).sum() * (size - noise) / scale
    return np.asarray(np.sqrt(total))
