"""The control laws of a joint, one of which is active, and the angles, torques and stiffnesses within reach.

At rest and without a torque from outside, an angle needs one torque, and this torque is possible with an interval of
stiffness (:func:`~pam_antagonist.control.stiffness.set_pressures`). Friction, which extends the range a little, is
neglected. For a joint that is locked or held, the torques at its angle count.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pam_antagonist.control.command import PI_MODES, Command, ControlLaw, Mode
from pam_antagonist.control.governor import Governor
from pam_antagonist.control.model_law import ModelController, Seen, wanted_pressures
from pam_antagonist.control.pi import PiController
from pam_antagonist.control.reference import Wanted
from pam_antagonist.control.stiffness import Box
from pam_antagonist.errors import BadInput
from pam_antagonist.model import parameters as par
from pam_antagonist.model.equilibrium import largest_angle

_OUT_OF_REACH = 1e-5
"""[N m] An angle with a larger missing torque is out of reach; above the tolerance of the solution."""
_GRID = 73
_HALVINGS = 40


@dataclass(frozen=True)
class Range:
    """Stiffness that is possible with an angle or torque."""

    softest: float  # [N m/rad]
    stiffest: float  # [N m/rad]
    missing: float  # torque [N m] that the muscles lack; positive: they would need more torque

    @property
    def reached(self) -> bool:
        """Whether the angle or torque is within reach."""
        return abs(self.missing) <= _OUT_OF_REACH


class Reachable:
    """The reachable set of a joint. `angles`: lowest and highest angle (2,) [rad] at which the joint can rest."""

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

    def pressures(self, angle: float, stiffness: float, torque: float | None = None) -> tuple[float, float]:
        """Pressures (2,) [Pa] that hold an angle [rad] with a stiffness [N m/rad], or the nearest possible ones.

        With a torque [N m]: that give it at an angle at which the joint is held.
        """
        seen, value = Seen(angle, 0.0, 0.0, self._box.lowest, self._box.lowest), angle if torque is None else torque
        of_torque = torque is not None
        wanted_pressures(of_torque, value, stiffness, seen, 0.0, 1.0, self._box, self._held, self._x, self._p)
        return float(self._x[2]), float(self._x[3])

    def nearest(self, mode: Mode, value: float, stiffness: float, angle: float = 0.0) -> tuple[float, float, str]:
        """The reachable reference nearest to a wanted one: nearest in angle or torque first, then in stiffness.

        `stiffness`: NaN: free. `angle`: at which a torque is produced [rad]. Returns value and stiffness within reach,
        and a sentence on the difference; empty if there is none.
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
        unit = mode.unit
        words = (
            f"reference {_pair(value, unit, stiffness)} is out of reach: {_pair(followed, unit, possible)} is "
            f"followed; the stiffness can be {found.softest:.3g} to {found.stiffest:.3g} N m/rad there"
        )
        return followed, possible, words


def _pair(value: float, unit: str, stiffness: float) -> str:
    return f"{value:.4g} {unit}" + ("" if math.isnan(stiffness) else f" with {stiffness:.4g} N m/rad")


LAWS = ("pi", "model")
"""The choices of parameter ``law``."""


class Laws:
    """Both laws behind one interface. A change between them is bumpless.

    A rig with pressure regulators has no PI, one without pressures to choose from no law through the model. `active` is
    the law that commands now, `name` its name, one of ``LAWS``.
    """

    def __init__(
        self,
        pi: PiController | None,
        model: ModelController | None,
        reachable: Reachable | None,
        name: str = "pi",
        governor: Governor | None = None,
    ) -> None:
        self.pi, self.model, self._reachable, self.governor = pi, model, reachable, governor
        first = pi or model
        if first is None:
            raise BadInput("no law of control: expected the PI, the law through the model, or both")
        self.active: ControlLaw = first
        self.name = "model" if pi is None else "pi"
        self.choose(name, None)

    def choose(self, name: str, mode: Mode | None) -> None:
        """Make a law the active one; it starts from the present voltages of the valves.

        `mode`: of the present reference; None: there is none.
        """
        if name == self.name:
            return
        if name == "pi" and self.pi is None:
            raise BadInput("law: pi commands valve voltages, but this joint has pressure regulators: set law to model")
        if name == "model" and self.model is None:
            raise BadInput(
                "law: model has no pressures to choose from: expected lowest_pressure below the supply's pressure "
                "less supply_margin"
            )
        if name == "pi" and mode is not None and mode.has_stiffness:
            raise BadInput(f"law: pi has no mode {mode.name}: send a reference of mode ANGLE or TORQUE first")
        before, chosen = self.active, self.pi if name == "pi" else self.model
        assert chosen is not None  # checked above
        self.active = chosen
        chosen.stop(before.valves)
        self.name = name

    def nearest(self, mode: Mode, value: float, stiffness: float, angle: float) -> tuple[float, float, str]:
        """The reachable reference nearest to a wanted one (:meth:`Reachable.nearest`); unchanged for the PI."""
        if self.name == "pi":
            if mode not in PI_MODES:
                raise BadInput(f"reference has mode {mode.name}, which law: pi does not have: set law to model")
            return value, stiffness, ""
        assert self._reachable is not None  # comes with the law through the model
        return self._reachable.nearest(mode, value, stiffness, angle)

    def step(self, wanted: Wanted, seen: Seen, *, late: bool = False) -> Command:
        """The command for one estimate; `late`: it is too old to act on."""
        if self.pi is not None and self.active is self.pi:
            value = seen.torque if wanted.mode is Mode.TORQUE else seen.angle
            return self.pi.step(wanted.mode, wanted.value, value, velocity=wanted.velocity, late=late)
        assert self.model is not None  # it is the active law
        mode, value, stiffness = wanted.mode, wanted.value, wanted.stiffness
        if self.governor is not None and mode is not None:
            if late or not self.model.running or not all(map(math.isfinite, (value, *seen[:5]))):
                self.governor.reset()
            else:
                value, stiffness = self.governor.step(mode, value, stiffness, seen, self.model)
        damping = 0.0 if math.isnan(wanted.damping) else wanted.damping
        return self.model.step(mode, value, stiffness, seen, damping=damping, late=late)
