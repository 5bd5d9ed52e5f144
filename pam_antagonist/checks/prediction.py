"""Prediction of a rig's model from the recorded voltages, at the samples of the recording."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import simulate_model
from pam_antagonist.model import dynamics, equilibrium
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

SETTLE = 2.0
"""[s] After this time the model no longer depends on the pressures at its start."""
_START_S = 0.01
"""[s] Time at the beginning over which pressures are averaged for the start."""
STEP_S = 0.5
"""[s] Length of the steps that begin at measured pressures: long enough for a change above noise and lags."""
_MOST_STEPS, _MOST_ROWS = 200, 3000
"""Steps and rows that are compared at most, evenly spaced."""
_STEP = 0.02
"""Relative change of an orifice area, to find its effect on the pressures."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """The model alone at the samples of a recording, without the settling time."""

    time: Floats  # of the samples (K,) [s]
    pressure: Floats  # of the muscles (K, 2) [Pa]
    pressure_rate: Floats  # their rates of change (K, 2) [Pa/s]
    angle: Floats  # (K,) [rad]
    torque: Floats  # (K,) [N m]
    rows: NDArray[np.int64]  # indices of the samples in the recording (K,)


def predicted(recording: Recording, rig: Rig, joint: str, lock_angle: float, known_start: bool = False) -> Prediction:
    """Run a rig's model on the voltages of a recording.

    The model runs on the grid of the recording's own period, in steps of at most 1 ms.

    `lock_angle`: of a locked joint [rad]. `known_start`: whether the model starts from the recorded pressures, which
    are then absolute, in Pa and not exchanged; otherwise it starts midway between atmosphere and supply.
    """
    if recording.episode_ns is None:
        return _in_one_piece(recording, rig, joint, lock_angle, known_start)
    parts = []
    for episode in recording.episodes:
        begin, end = recording.time_s[[episode.start, episode.stop - 1]]
        alone = replace(recording.slice(begin, end + 1e-9), episode_ns=None)
        if len(alone) > 1 and np.isfinite(np.column_stack([alone.voltage, alone.pressure])).all(axis=1).any():
            one = _in_one_piece(alone, rig, joint, lock_angle, known_start)
            parts.append(replace(one, time=one.time + begin, rows=one.rows + episode.start))
    if not parts:
        raise BadInput(f"{recording.path.name}: no episode has two samples with commands and pressures")
    return Prediction(
        **{item.name: np.concatenate([getattr(one, item.name) for one in parts]) for item in fields(Prediction)}
    )


def _in_one_piece(recording: Recording, rig: Rig, joint: str, lock_angle: float, known_start: bool) -> Prediction:
    period, step = recording.even_grid(rig.sample_period)
    voltage = np.full((int(step[-1]) + 1, 2), np.nan)
    # A sample's voltage was on the valves over the time up to the sample.
    voltage[step] = recording.voltage
    known = np.isfinite(voltage).all(axis=1)
    following = np.flatnonzero(known)[np.minimum(np.searchsorted(np.flatnonzero(known), np.arange(len(voltage))),
                                                  int(known.sum()) - 1)]  # fmt: skip
    start = np.full(2, 0.5 * (rig.supply.pressure + rig.atmosphere.pressure))
    if known_start:
        first = recording.pressure[np.isfinite(recording.pressure).all(axis=1)][: max(1, round(_START_S / period))]
        start = np.clip(first.mean(axis=0), rig.atmosphere.pressure, rig.supply.pressure)
    run = simulate_model(rig, voltage[following], start, joint, lock_angle, period=period)
    rows = np.flatnonzero(recording.time_s >= min(SETTLE, 0.5 * recording.duration_s))
    at = step[rows]
    return Prediction(
        time=recording.time_s[rows],
        pressure=run.pressure[at],
        pressure_rate=np.gradient(run.pressure, period, axis=0)[at],
        angle=run.angle[at],
        torque=run.torque[at],
        rows=rows,
    )


def in_steps(
    recording: Recording, rig: Rig, joint: str, lock_angle: float, crossed: bool = False
) -> tuple[Floats, Floats]:
    """Changes of the pressures over short steps, each of which begins at the measured pressures.

    Over a whole recording, a valve that is closed in its middle integrates each error of the model. Over a step it
    does not. `crossed`: each pressure belongs to the other muscle's valve. Returns measured and simulated changes (K,
    2) each [Pa], in the order of the valves.
    """
    pressure = recording.pressure[:, ::-1] if crossed else recording.pressure
    known = np.asarray(np.isfinite(np.column_stack([recording.voltage, pressure])).all(axis=1))
    rows = max(2, round(STEP_S / recording.sample_period_s))
    begins = [k for one in recording.episodes for k in range(one.start, one.stop - rows, rows)
              if known[k : k + rows + 1].all()]  # fmt: skip
    measured, simulated = [], []
    period = recording.even_grid(rig.sample_period)[0]
    for begin in begins[:: max(1, len(begins) // _MOST_STEPS)]:
        start = np.clip(pressure[begin], rig.atmosphere.pressure, rig.supply.pressure)
        run = simulate_model(rig, recording.voltage[begin : begin + rows + 1], start, joint, lock_angle, period=period)
        measured.append(pressure[begin + rows] - pressure[begin])
        simulated.append(run.pressure[-1] - run.pressure[0])
    return np.reshape(measured, (-1, 2)), np.reshape(simulated, (-1, 2))


def from_pressures(recording: Recording, rig: Rig, joint: str, lock_angle: float) -> Prediction:
    """Angle and torque of the joint at rest under the measured pressures, where voltages do not give the pressures.

    `lock_angle`: of a locked joint [rad].
    """
    rows = np.flatnonzero(np.isfinite(recording.pressure).all(axis=1))
    rows = rows[:: max(1, len(rows) // _MOST_ROWS)]
    pressure = recording.pressure[rows]
    p = rig.parameters(joint, lock_angle)
    angle = np.array(
        [lock_angle if joint == "locked" else equilibrium.rest_angle(one, two, p) for one, two in pressure]
    )
    if joint == "locked":
        at = np.full(len(rows), lock_angle)
    else:
        at = np.full(len(rows), np.nan) if recording.angle is None else recording.angle[rows]
    bound = equilibrium.largest_angle(p)
    torque = np.full(len(rows), np.nan)
    for k in np.flatnonzero(np.abs(at) <= bound):
        state = equilibrium.initial_state(at[k], *pressure[k], np.nan_to_num(recording.voltage[rows[k]]), p)
        torque[k] = dynamics.torque(state, p)
    return Prediction(recording.time_s[rows], pressure, np.zeros_like(pressure), angle, torque, rows)


def with_other_areas(rig: Rig) -> list[Rig]:
    """Four rigs, each with one orifice area slightly larger, to find the effect of a wrong area."""
    out = []
    for name in ("valve_1", "valve_2"):
        valve = getattr(rig, name)
        for area in ("inflow_area", "outflow_area"):
            out.append(rig.unchecked(**{name: valve.unchecked(**{area: getattr(valve, area) * (1.0 + _STEP)})}))
    return out


def remainder(columns: Floats, values: Floats) -> Floats:
    """Residual of a least-squares fit of columns (K, C) to values (K,)."""
    scale = np.linalg.norm(columns, axis=0)
    scaled = columns[:, scale > 0.0] / scale[scale > 0.0]
    return np.asarray(values - scaled @ np.linalg.lstsq(scaled, values, rcond=1e-9)[0])


def correlation(values: Floats, expected: Floats) -> float:
    """Correlation of two series (K,), 0 where either is constant."""
    known = np.isfinite(values) & np.isfinite(expected)
    if known.sum() < 10 or np.std(values[known]) == 0.0 or np.std(expected[known]) == 0.0:
        return 0.0
    return float(np.corrcoef(values[known], expected[known])[0, 1])


def ratio_to(values: Floats, expected: Floats) -> float:
    """Ratio of the standard deviations of two series (K,)."""
    known = np.isfinite(values) & np.isfinite(expected)
    return float(np.std(values[known])) / max(float(np.std(expected[known])), 1e-300)
