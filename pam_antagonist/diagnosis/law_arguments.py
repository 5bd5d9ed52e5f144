"""What a law may depend on, along a model of a recording: pressures, motion and what the valves do."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pam_antagonist._jit import kernel
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.point import Point
from pam_antagonist.model import flow
from pam_antagonist.model import parameters as par
from pam_antagonist.model.dynamics import FIRST, SECOND

Floats = NDArray[np.float64]

# numba compiles calls of plain names, not of attributes that it would have to look up again.
_open_rate, _valve_flow = flow.open_rate, flow.valve_flow
_VALVES = ("open_rate_1", "open_rate_2", "valve_flow_1", "valve_flow_2", "draw")


@kernel
def _through_valves(pressure, voltage, p):
    """Open rates, flows [kg/s] and the air that is drawn [kg/s] (N, 5). `pressure`, `voltage`: (N, 2) [Pa, V]."""
    out = np.zeros((pressure.shape[0], 5))
    for k in range(pressure.shape[0]):
        for i in range(2):
            muscle = FIRST if i == 0 else SECOND
            out[k, i] = _open_rate(muscle, voltage[k, i], p)
            passed, drawn = _valve_flow(muscle, out[k, i], pressure[k, i], p[par.SUPPLY], p)
            out[k, 2 + i] = passed
            out[k, 4] += drawn
    return out


def arguments(experiment: Experiment, point: Point) -> dict[str, Floats]:
    """What a law of any joint may depend on, at each sample of a recording (N,), by name."""
    p = experiment.parameters(point)
    states, torque = experiment.states(point)
    states = np.ascontiguousarray(states[:, :4])
    angle, velocity, first, second = states.T
    out = {
        "pressure_1": first, "pressure_2": second, "pressure_difference": first - second,
        "pressure_sum": first + second, "angle": angle, "velocity": velocity, "speed": np.abs(velocity),
        "torque": torque,
    }  # fmt: skip
    if experiment.in_one_piece:
        out["time"] = np.arange(len(states)) * experiment.trial.dt
    if experiment.rig.drive == "valve" and not experiment.rig.valves.sealed:
        voltage = np.ascontiguousarray(experiment.trial.voltage)
        out |= {"voltage_1": voltage[:, 0], "voltage_2": voltage[:, 1]}
        out |= zip(_VALVES, _through_valves(np.ascontiguousarray(states[:, 2:]), voltage, p).T, strict=True)
    on_pulley = p[par.PULLEY] != 0.0
    sine, arm = (angle, np.ones(len(angle))) if on_pulley else (np.sin(angle), np.cos(angle))
    for i, side in ((1, -1.0), (2, 1.0)):
        out[f"length_{i}"] = p[par.LENGTH] + side * p[par.RADIUS] * sine
        out[f"length_rate_{i}"] = side * p[par.RADIUS] * arm * velocity
    return out
