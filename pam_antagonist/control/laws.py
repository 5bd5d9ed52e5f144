"""The control laws of a joint, one of which is active: the paper's PI, or the law through the model."""

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
    """Both laws behind one interface. A change between them is bumpless.

    Args:
        pi: the paper's law; None for a rig with pressure regulators, which has only the law through the model.
        model: the law through the model; None if the rig has none.
        reachable: references that the law through the model can reach; None if the rig has none.
        name: the active law, of ``LAWS``.
        governor: between reference and the law through the model; None: no governor.

    Raises:
        BadInput: a law that does not exist.

    Attributes:
        name: of the active law.
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
        self._law: Law = first
        self.name = "model" if pi is None else "pi"
        self.choose(name, None)

    def choose(self, name: str, mode: Mode | None) -> None:
        """Make a law the active one; it starts from the present voltages of the valves.

        Args:
            name: of ``LAWS``.
            mode: of the present reference; None: there is none.

        Raises:
            BadInput: this joint has no such law, or the law has no such mode.
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
        before, chosen = self._law, self.pi if name == "pi" else self.model
        assert chosen is not None  # checked above
        self._law = chosen
        self._law.stop(before.valves)
        self.name = name

    def nearest(self, mode: Mode, value: float, stiffness: float, angle: float) -> tuple[float, float, str]:
        """The reachable reference nearest to a wanted one (:meth:`Reachable.nearest`); unchanged for the PI.

        Args:
            mode: of the reference.
            value: [rad] or [N m].
            stiffness: [N m/rad]; NaN: free.
            angle: estimated [rad].

        Raises:
            BadInput: the active law has no such mode.
        """
        if self.name == "pi":
            if mode not in PI_MODES:
                raise BadInput(f"reference has mode {mode.name}, which law: pi does not have: set law to model")
            return value, stiffness, ""
        assert self._reachable is not None  # comes with the law through the model
        return self._reachable.nearest(mode, value, stiffness, angle)

    @property
    def running(self) -> bool:
        """Whether the next command goes on with the present integral; otherwise it starts bumplessly."""
        return self._law.running

    def stop(self, valves: tuple[float, float] | None = None) -> None:
        """:meth:`Law.stop` of the active law.

        Args:
            valves: present voltages (2,) [V] of the valves; None: the last commanded ones.
        """
        self._law.stop(valves)

    def safe(self, status: Status) -> Command:
        """The safe voltages, for one sample without a usable reference or estimate."""
        return self._law.safe(status)

    def step(self, wanted: Wanted, seen: Seen, *, late: bool = False) -> Command:
        """The command for one estimate.

        Args:
            wanted: reference.
            seen: estimate.
            late: whether the estimate is too old to act on.
        """
        if self.pi is not None and self._law is self.pi:
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
