"""The laws of control that a joint has, of which one is in force: the paper's PI, or the one through the model."""

from __future__ import annotations

import math

from pam_antagonist.control.command import PI_MODES, Command, Law, Mode, Status
from pam_antagonist.control.governor import Governor
from pam_antagonist.control.model_law import ModelController, Seen
from pam_antagonist.control.pi import PiController
from pam_antagonist.control.reachable import Reachable
from pam_antagonist.control.reference import Wanted
from pam_antagonist.errors import BadInput

LAWS = ("pi", "model")
"""The choices of parameter ``law``."""


class Laws:
    """Both laws behind one door. A change from one to the other makes no jump.

    Args:
        pi: the paper's; None: this rig has pressure regulators, and the law through the model alone.
        model: through the model; None: this rig has none.
        reachable: what the model's law can reach; None as well.
        name: the one in force, of ``LAWS``.
        governor: between reference and the model's law; None: none is.

    Raises:
        BadInput: a law that there is not.

    Attributes:
        name: of the law in force.
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
            raise BadInput("no law of control: expected the PI, or the one through the model")
        self._law: Law = first
        self.name = "model" if pi is None else "pi"
        self.choose(name, None)

    def choose(self, name: str, mode: Mode | None) -> None:
        """Put a law in force; it goes on from the voltages that the valves have.

        Args:
            name: of ``LAWS``.
            mode: of the reference that is followed now; None: none is.

        Raises:
            BadInput: this joint has no such law, or the law has no such mode.
        """
        if name == self.name:
            return
        if name == "pi" and self.pi is None:
            raise BadInput("law: pi puts voltages on valves, and this joint has pressure regulators: expected model")
        if name == "model" and self.model is None:
            raise BadInput("law: model: the rig's supply leaves no pressures to choose (see lowest_pressure)")
        if name == "pi" and mode is not None and mode.has_stiffness:
            raise BadInput(f"law: pi has no mode {mode.name}: send a reference of mode ANGLE or TORQUE first")
        before, chosen = self._law, self.pi if name == "pi" else self.model
        assert chosen is not None  # as looked at above
        self._law = chosen
        self._law.stop(before.valves)
        self.name = name

    def nearest(self, mode: Mode, value: float, stiffness: float, angle: float) -> tuple[float, float, str]:
        """The reference that is followed in place of a wanted one (:meth:`Reachable.nearest`); the PI's as it is.

        Args:
            mode: what the value is.
            value: [rad] or [N m].
            stiffness: [N m/rad]; NaN: free.
            angle: estimated [rad].

        Raises:
            BadInput: the law in force has no such mode.
        """
        if self.name == "pi":
            if mode not in PI_MODES:
                raise BadInput(f"reference has mode {mode.name}, which law: pi does not have: set law to model")
            return value, stiffness, ""
        assert self._reachable is not None  # as there is a law through the model
        return self._reachable.nearest(mode, value, stiffness, angle)

    @property
    def running(self) -> bool:
        """Whether the next command goes on from the integral, rather than starting bumplessly."""
        return self._law.running

    def stop(self, valves: tuple[float, float] | None = None) -> None:
        """As :meth:`Law.stop`, of the law in force.

        Args:
            valves: the voltages (2,) [V] that the valves have now; None: those that were commanded last.
        """
        self._law.stop(valves)

    def safe(self, status: Status) -> Command:
        """The safe voltages, for one sample without anything to go by."""
        return self._law.safe(status)

    def step(self, wanted: Wanted, seen: Seen, *, late: bool = False) -> Command:
        """The command for one estimate.

        Args:
            wanted: what is asked for.
            seen: what is estimated.
            late: whether the estimate is too old to act on.
        """
        if self.pi is not None and self._law is self.pi:
            value = seen.torque if wanted.mode is Mode.TORQUE else seen.angle
            return self.pi.step(wanted.mode, wanted.value, value, velocity=wanted.velocity, late=late)
        assert self.model is not None  # it is in force
        mode, value, stiffness = wanted.mode, wanted.value, wanted.stiffness
        if self.governor is not None and mode is not None:
            if late or not self.model.running or not all(map(math.isfinite, (value, *seen[:5]))):
                self.governor.reset()
            else:
                value, stiffness = self.governor.step(mode, value, stiffness, seen, self.model)
        damping = 0.0 if math.isnan(wanted.damping) else wanted.damping
        return self.model.step(mode, value, stiffness, seen, damping=damping, late=late)
