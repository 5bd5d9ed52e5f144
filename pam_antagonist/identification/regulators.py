"""The pressure regulators of a joint from episodes: from what they were asked for to what was measured.

The package's own model of the air runs each episode from its first row, with the commands and with the joint's measured
motion (:mod:`pam_antagonist.model.command_driven`). The lag is fitted always. Dead time, dead zone, largest
rate, threshold and range are each freed where that explains enough of episodes that no fit has seen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pam_antagonist.inference.bootstrap import Interval, ratio, steps
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.inference.held_episodes import Held, thinned
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.inference.threads import side_by_side
from pam_antagonist.model.command_driven import pressures
from pam_antagonist.model.effects import CATALOGUE, parameter_path
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

_LAG = ("regulator_lag.frequency_1", "regulator_lag.frequency_2", "regulator_lag.damping")
_MORE: Mapping[str, Mapping[str, float]] = {
    "dead time": {f"regulator_dead_time.time_{i}": 8e-3 for i in (1, 2)},
    "dead zone": {"regulator_lag.dead_zone": 3e3},
    "largest rate": {"regulator_lag.largest_rate": 2e6},
    "threshold": {f"regulator_threshold.threshold_{i}": 5e3 for i in (1, 2)},
}
"""What a regulator may have beside its lag, and where its fit starts where the rig has no value [s, Pa, Pa/s]."""
_ITEMS = {
    parameter_path(name, item.name): item
    for name, effect in CATALOGUE.items() if name.startswith("regulator_")
    for item in effect.parameters
}  # fmt: skip
_LEAST_REMOVED = 0.05
"""Share of the squared error of unseen episodes that each of them removes at least, as effects of a joint do."""
_USED = 150
"""Episodes in a fit: more tell hardly more and take longer."""
_LONGEST_STEP = 2.7e-3
"""[s] Step of the integration, a quarter of the row of 10 ms of a measured arm."""
_STEP = 0.01
_SCALE = 1e5


@dataclass(frozen=True)
class TriedMore:
    """What a regulator may have beside its lag.

    Attributes:
        name: what it is.
        removed: share of the squared error of unseen episodes that it removes, with a corrected interval.
        taken: whether it is in the model.
    """

    name: str
    removed: Interval
    taken: bool


@dataclass(frozen=True, eq=False)
class RegulatorsFound:
    """Regulators that were identified.

    Attributes:
        values: with 95 % intervals by episode, by dotted path.
        tried: what was tried beside the lag.
        errors: RMSE [Pa] of each muscle's pressure on later episodes.
        command_errors: RMSE [Pa] by which the command itself differs from it.
        gains: measured over modelled pressure on fitted episodes, of each muscle; 1 where both are on one scale.
    """

    values: Mapping[str, Interval]
    tried: tuple[TriedMore, ...]
    errors: tuple[float, float]
    command_errors: tuple[float, float]
    gains: tuple[float, float]

    @property
    def resonance(self) -> float:
        """Highest gain of the lag over its gain at rest [-]; 1 for regulators that do not resonate."""
        d = self.values["effects.regulator_lag.damping"].value
        return 1.0 / (2.0 * d * math.sqrt(1.0 - d * d)) if d < math.sqrt(0.5) else 1.0

    def on(self, rig: Rig) -> Rig:
        """A rig with these regulators."""
        return moved(rig, {name: interval.value for name, interval in self.values.items()})


@dataclass(frozen=True, eq=False)
class _Commanded:
    """Episodes whose commands are the input; numbers are fitted by their logarithms."""

    joint: PressureDriven

    @cached_property
    def angle(self) -> Floats:
        """Measured, missing values filled in linearly (N,) [rad]."""
        known = np.isfinite(self.joint.angle)
        at = np.arange(len(known))
        return np.interp(at, at[known], self.joint.angle[known])

    def simulated(self, rig: Rig) -> Floats:
        one = self.joint
        p = rig.parameters("locked", 0.0)
        start = np.ascontiguousarray(one.pressure[one.first[:-1]])
        return np.asarray(pressures(one.first, start, one.time, one.command, self.angle, p, _LONGEST_STEP))

    def residual(self, values: Mapping[str, float]) -> Floats:
        """Modelled less measured pressure (2 N,) [bar], row by row."""
        apart = self.simulated(moved(self.joint.rig, values)) - self.joint.pressure
        return np.asarray(np.clip(apart / _SCALE, -1e2, 1e2).ravel())

    def jacobian(self, values: Mapping[str, float]) -> Floats:
        """Derivatives by the logarithms of the values (2 N, K)."""
        left = self.residual(values)
        points = [{**values, name: value * math.exp(_STEP)} for name, value in values.items()]
        columns = side_by_side(lambda point: self.residual(point) - left, points, self.joint.jobs)
        return np.column_stack(columns) / _STEP

    def squares(self, values: Mapping[str, float]) -> Floats:
        """Squared error by episode (E,)."""
        return np.asarray(np.add.reduceat(self.residual(values) ** 2, 2 * self.joint.first[:-1]))

    def squares_of_all(self, values: Mapping[str, float]) -> float:
        """Squared error of all episodes together."""
        return float(self.squares(values).sum())

    @cached_property
    def quickest(self) -> float:
        """A rate that the measured pressures go beyond now and then only [Pa/s]."""
        one = self.joint
        rate = np.abs(np.diff(one.pressure, axis=0)) / np.diff(one.time)[:, None]
        rate[one.first[1:-1] - 1] = 0.0
        return float(np.quantile(rate, _QUICK))

    @cached_property
    def reached(self) -> tuple[float, float]:
        """Pressures that the measured ones hardly leave [Pa]."""
        low, high = np.quantile(self.joint.pressure, [1.0 - _QUICK, _QUICK])
        return float(low), float(high)

    def tells(self, path: str, value: float) -> bool:
        """Whether the commands tell a value: an end of the range only where some go beyond it."""
        command = self.joint.command
        if path == "effects.regulator_limits.lowest":
            return bool((command < value).any())
        return path != "effects.regulator_limits.highest" or bool((command > value).any())

    def fit(self, start: Mapping[str, float]) -> dict[str, float]:
        names = list(start)
        items = [_ITEMS[name] for name in names]
        low = [math.log(max(item.low, 1e-3 * item.scale)) for item in items]
        high = [math.log(item.high) for item in items]

        def values(z: Floats) -> dict[str, float]:
            return dict(zip(names, np.exp(z).tolist(), strict=True))

        begin = np.clip(np.log(list(start.values())), np.add(low, 1e-6), np.subtract(high, 1e-6))
        found = least_squares(
            lambda z: self.residual(values(z)), begin, jac=lambda z: self.jacobian(values(z)), bounds=(low, high),
            ftol=1e-4, xtol=1e-4, max_nfev=20,
        )  # fmt: skip
        return values(found.x)

    def intervals(self, values: Mapping[str, float]) -> dict[str, Interval]:
        spans = [(2 * a, 2 * b) for a, b in zip(self.joint.first[:-1], self.joint.first[1:], strict=True)]
        drawn = steps(spans, self.jacobian(values), self.residual(values))
        return {
            name: Interval.of(value, value * np.exp(column))
            for (name, value), column in zip(values.items(), drawn.T, strict=True)
        }


_QUICK = 0.99
_HIDDEN: Mapping[str, Callable[[_Commanded], Mapping[str, float]]] = {
    "dead zone": lambda fitted: {"regulator_lag.dead_zone": 3e3},
    "largest rate": lambda fitted: {"regulator_lag.largest_rate": fitted.quickest},
    "range": lambda fitted: dict(
        zip(("regulator_limits.lowest", "regulator_limits.highest"), fitted.reached, strict=True)
    ),
}
"""Where these are looked for as well: a search that begins at the rig's values may not see them."""


def of_commands(joint: PressureDriven, held: Held, progress: Callable[[str], None]) -> RegulatorsFound:
    """Identify both regulators.

    Args:
        joint: episodes with commands.
        held: which of them may be fitted.
        progress: is called with what is being done.
    """
    fitted = _Commanded(joint.take(thinned(held.pool[::2], _USED)))
    judged = _Commanded(joint.take(thinned(held.pool[1::2], _USED)))
    rig = joint.rig
    lag = {f"effects.{name}": max(rig.value(f"effects.{name}"), 1e-2) for name in _LAG}
    values = fitted.fit(lag)
    tried: list[TriedMore] = []
    offered = {
        name: {f"effects.{path}": rig.value(f"effects.{path}") or start for path, start in more.items()}
        for name, more in {**_MORE, **_range(rig)}.items()
    }
    while offered:
        progress(f"regulators: {', '.join(offered)}")
        before = judged.squares(values)
        found = {}
        for name, more in offered.items():
            # A lag that was fitted alone may be so slow that a rate or a zone beside it changes nothing.
            starts = [{**values, **more}]
            if name in _HIDDEN and not any(item.taken for item in tried):
                starts.append({**lag, **{f"effects.{path}": value for path, value in _HIDDEN[name](fitted).items()}})
            found[name] = min((fitted.fit(start) for start in starts), key=fitted.squares_of_all)
        removed = {name: ratio(before - judged.squares(one), before, len(offered)) for name, one in found.items()}
        best = max(removed, key=lambda name: removed[name].value)
        enough = removed[best].low > 0.0 and removed[best].value >= _LEAST_REMOVED
        tried += [TriedMore(name, one, enough and name == best) for name, one in removed.items()]
        if not enough:
            break
        values = {path: value for path, value in found[best].items() if fitted.tells(path, value)}
        del offered[best]
    later = _Commanded(joint.take(held.later))
    model = fitted.simulated(moved(rig, values))
    gains = [float(np.polyfit(model[:, k], fitted.joint.pressure[:, k], 1)[0]) for k in (0, 1)]
    return RegulatorsFound(
        fitted.intervals(values), tuple(tried),
        _rms(later.simulated(moved(rig, values)) - later.joint.pressure),
        _rms(later.joint.command - later.joint.pressure), (gains[0], gains[1]),
    )  # fmt: skip


def _range(rig: Rig) -> dict[str, dict[str, float]]:
    """The range, where the rig has one: without a start nothing tells of commands that it holds back."""
    declared = rig.effects.get("regulator_limits", {})
    return {"range": {f"regulator_limits.{name}": value for name, value in declared.items()}} if declared else {}


def pressures_of(found: RegulatorsFound, joint: PressureDriven) -> Floats:
    """What the regulators make of the commands (N, 2) [Pa].

    Args:
        found: the regulators.
        joint: episodes with commands.
    """
    return _Commanded(joint).simulated(found.on(joint.rig))


def _rms(apart: Floats) -> tuple[float, float]:
    first, second = np.sqrt(np.mean(apart**2, axis=0))
    return float(first), float(second)
