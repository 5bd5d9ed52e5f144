"""Several recordings of one rig as one problem: predictions of the model, and their derivatives by the parameters.

The recordings share the free parameters, and each may deviate from them a little, see
:mod:`~pam_antagonist.inference.spread`. The terms of a force map nearly cancel each other. A step of a single
coefficient would move a joint out of stiction, and differences of such derivatives would contain false information. So
the coefficients are moved along combinations that change the force in independent ways, each by a thousandth of the
force.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.free_parameters import FreeParameter
from pam_antagonist.inference.free_run import SANE, Run, predict, predict_each
from pam_antagonist.inference.long_steps import stride_blocks
from pam_antagonist.inference.normal_equations import Arrow, Local
from pam_antagonist.inference.threads import side_by_side
from pam_antagonist.inference.trial import CHANNELS, Trial
from pam_antagonist.inference.valve_driven import STARTS, ValveDriven
from pam_antagonist.model import dynamics
from pam_antagonist.model import parameters as par
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

_STEP = 0.02
"""Step of the central differences in standard deviations of the prior."""
_FORCE_STEP = 1e-3
"""Relative change of the force by a step of a map's coefficients."""
_RANGE = 0.35
"""[rad] Largest angle, to either side, at which the maps are evaluated."""


@dataclass(frozen=True, eq=False)
class JointProblem:
    """A fit: trials, free parameters, and the channels that count.

    The vector that is fitted holds standard normal values: the free parameters in units of their priors, then for each
    trial its deviations from them (:mod:`pam_antagonist.inference.spread`) and those of its start from the
    measured one (pressures, and the angle of a free joint).

    Attributes:
        rig: start values.
        trials: recordings.
        free: parameters that may move.
        channels: indices of ``CHANNELS`` that are compared.
        jobs: threads for the Jacobian.
        between: change of the free parameters (F, G) by a trial's deviations of 1, in units of their priors; None:
            all trials share all parameters.
    """

    rig: Rig
    trials: Sequence[Trial]
    free: Sequence[FreeParameter]
    channels: Sequence[int] = tuple(range(len(CHANNELS)))
    jobs: int = 1
    between: Floats | None = None

    @property
    def size(self) -> int:
        """Length of the fitted vector."""
        return len(self.free) + len(self.trials) * self._own

    @property
    def _own(self) -> int:
        """Number of own values of each trial."""
        return STARTS + (0 if self.between is None else self.between.shape[1])

    @cached_property
    def experiments(self) -> tuple[ValveDriven, ...]:
        """The trials as experiments, each fitted as a whole."""
        return tuple(ValveDriven(self.rig, trial, len(trial)) for trial in self.trials)

    @cached_property
    def _steps(self) -> Floats:
        return step_directions(self.rig, self.free)

    def with_between(self, between: Floats | None) -> JointProblem:
        """The same with other deviations of the trials."""
        return dataclasses.replace(self, between=between)

    def place(self, index: int) -> slice:
        """Where a trial's own values stand in the fitted vector: its deviations, then its start."""
        first = len(self.free) + index * self._own
        return slice(first, first + self._own)

    def map(self, index: int) -> Floats:
        """Matrix (F + 3, size) from the fitted vector to a trial's local values: its parameters and its start."""
        count = len(self.free)
        out = np.zeros((count + STARTS, self.size))
        out[:count, :count] = np.eye(count)
        own = out[:, self.place(index)]
        if self.between is not None:
            own[:count, :-STARTS] = self.between
        own[count:, -STARTS:] = np.eye(STARTS)
        return out

    def local(self, theta: Floats, index: int) -> Floats:
        """Local values (F + 3,) of a trial at a fitted vector."""
        count = len(self.free)
        own = theta[self.place(index)]
        common = theta[:count] if self.between is None else theta[:count] + self.between @ own[:-STARTS]
        return np.concatenate([common, own[-STARTS:]])

    def arrow(self, parts: Sequence[Local]) -> Arrow:
        """Normal equations of the fitted vector from the information of each trial about its local values."""
        return Arrow.of(parts, self.between, len(self.free))

    def values(self, theta: Floats) -> dict[str, float]:
        """Parameter values at a fitted vector, or at the local values of a trial, within their bounds."""
        return {item.name: item.value(float(t)) for item, t in zip(self.free, theta, strict=False)}

    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest fitted vector."""
        low = [(item.low - item.start) / item.prior_std for item in self.free]
        high = [(item.high - item.start) / item.prior_std for item in self.free]
        rest = [8.0] * (self.size - len(self.free))
        return np.array(low + [-value for value in rest]), np.array(high + rest)

    def predict_local(self, local: Floats, index: int, steps: Trial | None = None) -> Floats:
        """Prediction of one trial (N, 4) at its local values.

        Args:
            local: local values of the trial (F + 3,).
            index: of the trial.
            steps: the trial with longer steps of the integration; default: as it is.
        """
        experiment = self.experiments[index]
        return predict(steps or experiment.trial, self._run(local, index), experiment.first)

    def _run(self, local: Floats, index: int) -> Run:
        """Model and start of one trial at its local values."""
        experiment = self.experiments[index]
        start = experiment.start_std * local[len(self.free) :]
        return Run(par.changed(experiment.vector, self.values(local)), np.asarray(start))

    def predict(self, theta: Floats, index: int) -> Floats:
        """Prediction of one trial (N, 4) at a fitted vector."""
        return self.predict_local(self.local(theta, index), index)

    def counted(self, trial: Trial) -> list[int]:
        """Channels of a trial that are compared."""
        return [channel for channel in self.channels if trial.has(channel)]

    def residuals(self, theta: Floats) -> list[Floats]:
        """Prediction minus measurement in blocks, one array (B, counted channels) a trial.

        NaN where nothing was measured; all of a trial is infinite if its simulation diverged.
        """
        predicted = side_by_side(lambda index: self.predict(theta, index), range(len(self.trials)), self.jobs)
        out = []
        for trial, values in zip(self.trials, predicted, strict=True):
            counted = self.counted(trial)
            if diverged(values):
                out.append(np.full((len(trial) // trial.block, len(counted)), np.inf))
            else:
                out.append(trial.blocks((values - trial.measured)[:, counted]))
        return out

    def changes(self, theta: Floats, others: Sequence[Floats], index: int) -> list[Floats]:
        """Changes of a trial's :meth:`residuals` from one fitted vector to others.

        Args:
            theta: fitted vector (size,).
            others: other vectors (size,).
            index: of the trial.
        """
        trial = self.trials[index]
        base, *moved = self._means_each([self.local(one, index) for one in (theta, *others)], index, trial)
        counted, none = self.counted(trial), np.full((len(base), len(self.counted(trial))), np.inf)
        return [none if diverged(one) else (one - base)[:, counted] for one in moved]

    def local_jacobians(self, theta: Floats, exact: bool = False) -> list[Floats]:
        """:meth:`local_jacobian` of every trial at a fitted vector (size,)."""
        return [self.local_jacobian(self.local(theta, index), index, exact) for index in range(len(self.trials))]

    def local_jacobian(self, local: Floats, index: int, exact: bool = False) -> Floats:
        """Derivatives of a trial's :meth:`residuals` by its local values (B, counted channels, F + 3).

        For a fit, derivatives may use longer integration steps than the residual, as long as the model's course stays
        the same. Standard errors need exact derivatives.

        Args:
            local: local values of the trial (F + 3,).
            index: of the trial.
            exact: whether to use the steps of the residual.
        """
        trial = self.trials[index]
        simulated = trial if exact else self._in_longest_steps(local, index)
        width = len(self.free) + STARTS
        steps = _STEP * np.eye(width)
        steps[: len(self.free), : len(self.free)] = self._steps
        moved = [local + sign * steps[:, k] for k in range(width) for sign in (1.0, -1.0)]
        means = self._means_each(moved, index, simulated)
        counted, none = self.counted(trial), np.zeros((len(means[0]), len(self.counted(trial))))
        # A step with which the simulation diverges says nothing.
        columns = np.stack(
            [
                none if diverged(up) or diverged(down) else (up - down)[:, counted] / 2.0
                for up, down in zip(means[::2], means[1::2], strict=True)
            ],
            axis=2,
        )
        return np.asarray(columns @ np.linalg.inv(steps))

    def _means(self, local: Floats, index: int, steps: Trial) -> Floats:
        """Block means (B, 4) of the prediction of one trial, simulated with the steps of ``steps``."""
        return self._means_each([local], index, steps)[0]

    def _means_each(self, local: Sequence[Floats], index: int, steps: Trial) -> list[Floats]:
        """:meth:`_means` of several predictions, which run side by side."""
        experiment, trial = self.experiments[index], self.trials[index]
        stride, count = round(steps.dt / trial.dt), len(trial) // trial.block
        runs = [self._run(part, index) for part in local]

        def means(_: int, shown: Floats) -> Floats:
            return stride_blocks(shown, stride, count, trial.block)

        return predict_each(steps, runs, experiment.first, self.jobs, means)

    def _in_longest_steps(self, local: Floats, index: int) -> Trial:
        """A trial with the longest steps at which the model's course stays the same."""
        experiment = self.experiments[index]
        channels = list(experiment.channels)
        # Long steps cannot follow short lags, so the derivative by an effect's time constant would be 0.
        if not any(item.name.startswith("effects.") for item in self.free):
            exact = self._means(local, index, experiment.trial)[:, channels]
            for steps in experiment.in_long_steps if not diverged(exact) else ():
                longer = self._means(local, index, steps)[:, channels]
                if not diverged(longer) and experiment.goes_its_way(longer - exact):
                    return steps
        return experiment.trial


def diverged(values: Floats) -> bool:
    """Whether a simulation has left all numbers that a joint can have.

    Args:
        values: of it, in SI units (N, C).
    """
    return not bool(np.all(np.abs(values) < SANE))


def step_directions(rig: Rig, free: Sequence[FreeParameter]) -> Floats:
    """Steps as columns (F, F), in units of the priors.

    Args:
        rig: start values.
        free: parameters of the fit.
    """
    steps = _STEP * np.eye(len(free))
    for number in (1, 2):
        own = [k for k, item in enumerate(free) if item.name.startswith(f"muscle_{number}.force.")]
        if len(own) > 1:
            steps[np.ix_(own, own)] = _force_steps(rig, [free[k] for k in own], number - 1)
    return steps


def _force_steps(rig: Rig, free: Sequence[FreeParameter], muscle: int) -> Floats:
    p = rig.parameters()
    stop = min(p[par.STOP], _RANGE)
    low = 0.5 * (rig.supply.pressure + rig.atmosphere.pressure) - 0.4 * (rig.supply.pressure - rig.atmosphere.pressure)
    states = [
        np.array([angle, 0.0, pressure, pressure])
        for angle in np.linspace(-stop, stop, 5)
        for pressure in np.linspace(low, rig.supply.pressure, 5)
    ]

    def forces(q: Floats) -> Floats:
        return np.array([dynamics.forces(state, q)[muscle] for state in states])

    base = forces(p)
    design = np.column_stack(
        [forces(par.changed(p, {item.name: item.start + 0.01 * item.prior_std})) - base for item in free]
    ) / (0.01 * np.sqrt(len(states)))
    _, strength, turned = np.linalg.svd(design, full_matrices=False)
    wanted = _FORCE_STEP * float(np.sqrt(np.mean(base**2)))
    # A combination that hardly changes the force is moved by at most one standard deviation.
    return np.asarray(turned.T * np.minimum(wanted / np.maximum(strength, 1e-300), 1.0))
