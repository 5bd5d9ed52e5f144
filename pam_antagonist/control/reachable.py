"""Angles, torques and stiffnesses that a joint can reach within its bounds of pressure.

At rest and without a torque from outside, an angle needs one torque, and this torque is possible with an interval of
stiffness (:func:`~pam_antagonist.control.stiffness.set_pressures`). Friction, which extends the range a little, is
neglected. For a joint that is locked or held, the torques at its angle count.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pam_antagonist.control.command import Mode
from pam_antagonist.control.model_law import Seen, wanted_pressures
from pam_antagonist.control.stiffness import Box
from pam_antagonist.model import parameters as par
from pam_antagonist.model.equilibrium import largest_angle

_OUT_OF_REACH = 1e-5
"""[N m] An angle with a larger missing torque is out of reach; above the tolerance of the solution."""
_GRID = 73
_HALVINGS = 40
_UNIT = {Mode.ANGLE: "rad", Mode.TORQUE: "N m"}


@dataclass(frozen=True)
class Range:
    """Stiffness that is possible with an angle or torque.

    Attributes:
        softest: [N m/rad].
        stiffest: [N m/rad].
        missing: torque [N m] that the muscles lack; positive: they would need more torque.
    """

    softest: float
    stiffest: float
    missing: float

    @property
    def reached(self) -> bool:
        """Whether the angle or torque is within reach."""
        return abs(self.missing) <= _OUT_OF_REACH


class Reachable:
    """The reachable set of a joint.

    Args:
        p: parameter vector (parameters.SIZE,).
        box: bounds of pressures and forces.

    Attributes:
        angles: lowest and highest angle (2,) [rad] at which the joint can rest.
    """

    def __init__(self, p: np.ndarray, box: Box) -> None:
        self._p, self._box = p, box
        self._x, self._held = np.zeros(int(p[par.STATES])), np.full(2, 5.0)
        bound = float(largest_angle(p))
        grid = np.linspace(-bound, bound, _GRID)
        within = [angle for angle in grid if self.at_angle(float(angle)).reached]
        # If the joint rests nowhere without friction, the angle with the least missing torque counts.
        nearest = min(grid, key=lambda angle: abs(self.at_angle(float(angle)).missing))
        first, last = (within[0], within[-1]) if within else (nearest, nearest)
        self.angles = (self._edge(float(first), -bound), self._edge(float(last), bound))

    def _edge(self, inside: float, outside: float) -> float:
        if self.at_angle(outside).reached or not self.at_angle(inside).reached:
            return outside if self.at_angle(outside).reached else inside
        for _ in range(_HALVINGS):
            middle = 0.5 * (inside + outside)
            inside, outside = (middle, outside) if self.at_angle(middle).reached else (inside, middle)
        return inside

    def _range(self, of_torque: bool, value: float, angle: float) -> Range:
        seen = Seen(angle, 0.0, 0.0, self._box.lowest, self._box.lowest)
        return Range(
            *wanted_pressures(of_torque, value, math.nan, seen, 0.0, 1.0, self._box, self._held, self._x, self._p)
        )

    def at_angle(self, angle: float) -> Range:
        """Stiffness that is possible at an angle of rest [rad]."""
        return self._range(False, angle, angle)

    def at_torque(self, torque: float, angle: float) -> Range:
        """Stiffness that is possible with a torque [N m], at an angle [rad] at which the joint is held."""
        return self._range(True, torque, angle)

    def torques(self, angle: float) -> tuple[float, float]:
        """Lowest and highest torque [N m] at an angle [rad] at which the joint is held."""
        far = 1e6
        return -far - self.at_torque(-far, angle).missing, far - self.at_torque(far, angle).missing

    def pressures(self, angle: float, stiffness: float) -> tuple[float, float]:
        """Pressures (2,) [Pa] that hold an angle [rad] with a stiffness [N m/rad], or the nearest possible ones."""
        seen = Seen(angle, 0.0, 0.0, self._box.lowest, self._box.lowest)
        wanted_pressures(False, angle, stiffness, seen, 0.0, 1.0, self._box, self._held, self._x, self._p)
        return float(self._x[2]), float(self._x[3])

    def torque_pressures(self, torque: float, stiffness: float, angle: float = 0.0) -> tuple[float, float]:
        """Pressures (2,) [Pa] that give a torque with a stiffness, or the nearest possible ones.

        Args:
            torque: [N m].
            stiffness: [N m/rad].
            angle: at which the joint is held [rad].
        """
        seen = Seen(angle, 0.0, 0.0, self._box.lowest, self._box.lowest)
        wanted_pressures(True, torque, stiffness, seen, 0.0, 1.0, self._box, self._held, self._x, self._p)
        return float(self._x[2]), float(self._x[3])

    def nearest(self, mode: Mode, value: float, stiffness: float, angle: float = 0.0) -> tuple[float, float, str]:
        """The reachable reference nearest to a wanted one: nearest in angle or torque first, then in stiffness.

        Args:
            mode: of the reference.
            value: [rad] or [N m].
            stiffness: [N m/rad]; NaN: free.
            angle: at which a torque is produced [rad].

        Returns:
            Value and stiffness within reach, and a sentence on the difference; empty if there is none.
        """
        if mode.quantity is Mode.TORQUE:
            low, high = self.torques(angle)
        else:
            low, high = self.angles
        followed = min(max(value, low), high)
        found = self.at_torque(followed, angle) if mode.quantity is Mode.TORQUE else self.at_angle(followed)
        possible = stiffness if math.isnan(stiffness) else min(max(stiffness, found.softest), found.stiffest)
        if followed == value and (possible == stiffness or math.isnan(stiffness)):
            return value, stiffness, ""
        unit = _UNIT[mode.quantity]
        words = (
            f"reference {_pair(value, unit, stiffness)} is out of reach: {_pair(followed, unit, possible)} is "
            f"followed; the stiffness can be {found.softest:.3g} to {found.stiffest:.3g} N m/rad there"
        )
        return followed, possible, words


def _pair(value: float, unit: str, stiffness: float) -> str:
    return f"{value:.4g} {unit}" + ("" if math.isnan(stiffness) else f" with {stiffness:.4g} N m/rad")
