"""Which angles and torques a joint can have together with which stiffness, at the pressures that it may have.

At rest and without a torque from outside, an angle takes one torque, and a torque leaves an interval of stiffness
(:func:`~pam_antagonist.control.stiffness.set_pressures`). Friction is left aside; it lets a joint stand a little
further. A locked joint, or one that somebody holds, is asked for its torques at its angle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pam_antagonist.control.command import Mode
from pam_antagonist.control.model_law import Seen, wanted_pressures
from pam_antagonist.control.stiffness import Box
from pam_antagonist.model import parameters as par

_OUT_OF_REACH = 1e-5
"""[N m] Torque that is missing where an angle is out of reach: above what the solution's tolerance leaves."""
_GRID = 73
_HALVINGS = 40
_UNIT = {Mode.ANGLE: "rad", Mode.TORQUE: "N m"}


@dataclass(frozen=True)
class Range:
    """Stiffness that one angle or torque leaves.

    Attributes:
        softest: [N m/rad].
        stiffest: [N m/rad].
        missing: torque [N m] by which it is out of reach; positive: more torque is needed than there is.
    """

    softest: float
    stiffest: float
    missing: float

    @property
    def reached(self) -> bool:
        """Whether the angle or torque is within reach."""
        return abs(self.missing) <= _OUT_OF_REACH


class Reachable:
    """The set of a joint.

    Args:
        p: parameter vector (parameters.SIZE,).
        box: within what pressures and forces have to be.

    Attributes:
        angles: lowest and highest angle (2,) [rad] at which it can rest.
    """

    def __init__(self, p: np.ndarray, box: Box) -> None:
        self._p, self._box = p, box
        self._x, self._held = np.zeros(int(p[par.STATES])), np.full(2, 5.0)
        bound = min(float(p[par.STOP]), math.pi / 3.0)
        grid = np.linspace(-bound, bound, _GRID)
        within = [angle for angle in grid if self.at_angle(float(angle)).reached]
        # A joint that rests nowhere without friction: the angle that takes least torque beside what there is.
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
        """Stiffness that an angle of rest [rad] leaves."""
        return self._range(False, angle, angle)

    def at_torque(self, torque: float, angle: float) -> Range:
        """Stiffness that a torque [N m] leaves where the joint is held at an angle [rad]."""
        return self._range(True, torque, angle)

    def torques(self, angle: float) -> tuple[float, float]:
        """Lowest and highest torque [N m] where the joint is held at an angle [rad]."""
        far = 1e6
        return -far - self.at_torque(-far, angle).missing, far - self.at_torque(far, angle).missing

    def pressures(self, angle: float, stiffness: float) -> tuple[float, float]:
        """Pressures (2,) [Pa] that hold an angle [rad] with a stiffness [N m/rad], or the nearest that can be."""
        seen = Seen(angle, 0.0, 0.0, self._box.lowest, self._box.lowest)
        wanted_pressures(False, angle, stiffness, seen, 0.0, 1.0, self._box, self._held, self._x, self._p)
        return float(self._x[2]), float(self._x[3])

    def torque_pressures(self, torque: float, stiffness: float, angle: float = 0.0) -> tuple[float, float]:
        """Pressures (2,) [Pa] that give a torque with a stiffness, or the nearest.

        Args:
            torque: [N m].
            stiffness: [N m/rad].
            angle: at which the joint is held [rad].
        """
        seen = Seen(angle, 0.0, 0.0, self._box.lowest, self._box.lowest)
        wanted_pressures(True, torque, stiffness, seen, 0.0, 1.0, self._box, self._held, self._x, self._p)
        return float(self._x[2]), float(self._x[3])

    def nearest(self, mode: Mode, value: float, stiffness: float, angle: float = 0.0) -> tuple[float, float, str]:
        """The reference that is followed in place of a wanted one: the angle or torque first, then the stiffness.

        Args:
            mode: what the value is.
            value: [rad] or [N m].
            stiffness: [N m/rad]; NaN: free.
            angle: at which a torque is produced [rad].

        Returns:
            Value and stiffness within reach, and words about the difference; empty where there is none.
        """
        if mode.quantity is Mode.TORQUE:
            low, high = self.torques(angle)
        else:
            low, high = self.angles
        followed = min(max(value, low), high)
        found = self.at_torque(followed, angle) if mode.quantity is Mode.TORQUE else self.at_angle(followed)
        softness = stiffness if math.isnan(stiffness) else min(max(stiffness, found.softest), found.stiffest)
        if followed == value and (softness == stiffness or math.isnan(stiffness)):
            return value, stiffness, ""
        unit = _UNIT[mode.quantity]
        words = (
            f"reference {_pair(value, unit, stiffness)} is out of reach: {_pair(followed, unit, softness)} is "
            f"followed; the stiffness can be {found.softest:.3g} to {found.stiffest:.3g} N m/rad there"
        )
        return followed, softness, words


def _pair(value: float, unit: str, stiffness: float) -> str:
    return f"{value:.4g} {unit}" + ("" if math.isnan(stiffness) else f" with {stiffness:.4g} N m/rad")
