"""How an angle answers to learned laws: the first order of all values of all tables, from one simulation.

Every law of these places is a further torque: of a friction against the motion, of a strength with the pressure's
torque, of a damping with the velocity. So one simulation, which also tells how each of its steps passes on a small
change of the state, gives the columns of any table.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.model import parameters as par
from pam_antagonist.model.drive import Inputs
from pam_antagonist.model.linearised import linearised, remembered, responses
from pam_antagonist.rig.learned import Law

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

OF_MOTION = ("angle", "velocity", "speed")
"""Arguments that the joint's motion changes; all others are inputs of the model."""
_MOVES = (1e-4, 1e-2, 1e-3)
"""Steps of the difference quotients, in the angle [rad], the velocity [rad/s] and in states of effects."""


class Responses:
    """The steps of a simulation of episodes, and how each passes on a small change of the state."""

    def __init__(
        self, first: Indices, start: Floats, time: Floats, pressure: Floats, signals: Floats, p: Floats, longest: float,
        names: list[str], laws: dict[int, Law],
    ) -> None:  # fmt: skip
        """The arguments before the last two are those of :func:`~pam_antagonist.model.linearised.linearised`.

        `names`: of the further signals. `laws`: of the model, by their numbers.
        """
        inputs = [f"law{number}_" for number, law in laws.items() if law.argument not in OF_MOTION]
        added = [k for k, name in enumerate(par.added_states(p)) if not name.startswith(tuple(inputs))]
        moving = np.array([0, 1, *(par.BASE_STATES + k for k in added)])
        moves = np.array([*_MOVES[:2], *_MOVES[2:] * len(added)])
        self._first, self._rows, self._inertia = first, len(time), p[par.INERTIA]
        held = Inputs.at(time, longest, first, pressure=pressure).vector(p)
        found = linearised(first, start, time, pressure, signals, held, longest, moving, moves)
        self._row, seen, self._passed = found
        since, self._length, angle, velocity, pressure_1, pressure_2, pull_1, pull_2, slides = seen[:, :9].T
        self._per_unit = {
            "strength_1": pull_1, "strength_2": pull_2, "torque": np.ones(len(seen)), "friction": -slides,
            "damping": -velocity,
        }  # fmt: skip
        self._seen = {
            "time": since, "angle": angle, "velocity": velocity, "speed": np.abs(velocity), "pressure_1": pressure_1,
            "pressure_2": pressure_2, "pressure_sum": pressure_1 + pressure_2,
            "pressure_difference": pressure_1 - pressure_2, **dict(zip(names, seen[:, 9:].T, strict=True)),
        }  # fmt: skip

    def argument(self, law: Law) -> Floats:
        """What a law's table gets at each step (S,)."""
        other = {"pressure": law.muscle, "other_pressure": 3 - law.muscle} if law.muscle in (1, 2) else {}
        name = f"pressure_{other[law.argument]}" if law.argument in other else law.argument
        values = self._seen[name]
        if law.operator == "none":
            return values
        lags = law.operator in ("lag", "high_pass")
        held = remembered(values, self._seen["time"], self._length, law.time if lags else law.width, lags)
        return np.asarray(values - held if law.operator in ("high_pass", "stop") else held)

    def columns(self, law: Law) -> Floats:
        """Derivatives of the angle by the values of a law (N, nodes)."""
        nodes, argument = np.array(law.nodes), self.argument(law)
        at = np.clip(np.searchsorted(nodes, argument) - 1, 0, len(nodes) - 2)
        share = np.clip((argument - nodes[at]) / (nodes[at + 1] - nodes[at]), 0.0, 1.0)
        unit = self._per_unit[law.at] * self._length / self._inertia
        torques = np.zeros((len(argument), len(nodes)))
        torques[np.arange(len(at)), at] = (1.0 - share) * unit
        torques[np.arange(len(at)), at + 1] = share * unit
        return np.asarray(responses(self._first, self._row, self._passed, torques, self._rows))
