"""Places: what one unit of an unknown input there does to each residual equation, and what a law may depend on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.model import parameters as par
from pam_antagonist.model.dynamics import ANGLE, PRESSURE_1, PRESSURE_2
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

PLACES: dict[str, tuple[str, ...]] = {
    "flow": ("flow_1", "flow_2", "flow_both"),
    "valve": ("valve_1", "valve_2", "valve_both"),
    "supply": ("supply",),
    "exchange": ("exchange",),
    "volume": ("volume_1", "volume_2"),
    "force": ("force_1", "force_2"),
    "strength": ("strength_1", "strength_2", "strength_both"),
    "sensor": ("sensor_1", "sensor_2", "sensor_both"),
    "line": ("line_1", "line_2", "line_both"),
    "encoder": ("encoder",),
    "meter": ("meter",),
    "torque": ("torque",),
    "friction": ("friction",),
}
"""Places of each class."""


def places_of(
    columns: Floats,
    slope: Floats,
    step: float,
    by_pressure: Floats,
    by_angle: Floats,
    shown: Floats,
    p: Floats,
    direction: Floats,
    has_torque: NDArray[np.bool_],
    valve: bool,
) -> dict[str, tuple[Floats, Floats]]:
    """What one unit at each place does: over a block (K, 2), and to the residuals (K, 4).

    Args:
        columns: of :func:`~pam_antagonist.diagnosis.law_kernels.air_columns` (K, 2, 8).
        slope: of the errors of the pressures over a block (K, 2).
        step: length of a block [s].
        by_pressure: slopes of the torque by the pressures (K, 2) [N m/Pa].
        by_angle: likewise by the angle (K,) [N m/rad].
        shown: states with measured pressures and motion (K, n).
        p: parameter vector (m,).
        direction: of the motion (K,).
        has_torque: whether the torque was measured (K,) [-].
        valve: whether valves drive the joint.
    """
    count = len(shown)
    arm = np.cos(shown[:, ANGLE]) if p[par.PULLEY] == 0.0 else np.ones(count)
    lever = p[par.RADIUS] * np.column_stack([arm, -arm])
    pressure_force = by_pressure / lever * (shown[:, 2:4] - p[par.ATMOSPHERE])
    shaft = p[par.SHAFT_RADIUS] * p[par.SHAFT_FRICTION] * direction
    per_flow, per_opening, per_supply, passed, _, swell, by_own, _ = np.moveaxis(columns, 2, 0)
    zero = np.zeros(count)
    out: dict[str, tuple[Floats, Floats]] = {}

    def place(
        name: str, inside: Sequence[Floats] = (zero, zero), shown_as: Sequence[Floats] = (zero, zero),
        torque: Floats = zero, motion: Floats = zero, pulled: bool = False,
    ) -> None:  # fmt: skip
        # Without a torque meter what the muscles lack shows in the motion, with one what they pull beside.
        if pulled:
            motion = np.where(has_torque, motion, motion - torque)
        out[name] = (np.column_stack(inside), np.column_stack([*shown_as, torque, motion]))

    for i in (0, 1):
        n = i + 1

        def own(values: Floats, i: int = i) -> list[Floats]:
            return [values if k == i else zero for k in (0, 1)]

        c, one = step * per_flow[:, i], np.ones(count)
        place(f"flow_{n}", own(c))
        if valve:
            place(f"valve_{n}", own(c * per_opening[:, i]))
            place(f"line_{n}", own(c * by_own[:, i]), own(one), -by_pressure[:, i], pulled=True)
        # With e' = e + k2 P φ no derivative of φ is needed.
        share = p[par.POLYTROPIC_VOLUME] * shown[:, 2 + i]
        place(f"volume_{n}", own((1.0 - slope[:, i]) * share - c * passed[:, i]), own(-share))
        place(f"force_{n}", torque=lever[:, i], motion=shaft, pulled=True)
        scaled = pressure_force[:, i]
        place(f"strength_{n}", torque=lever[:, i] * scaled, motion=shaft * scaled, pulled=True)
        place(f"sensor_{n}", shown_as=own(one), torque=-by_pressure[:, i], pulled=True)
    for kind in ("flow", "valve", "strength", "sensor", "line"):
        if f"{kind}_1" in out:
            (g1, h1), (g2, h2) = out[f"{kind}_1"], out[f"{kind}_2"]
            out[f"{kind}_both"] = (g1 + g2, h1 + h2)
    if valve:
        place("supply", list((step * per_flow * per_supply).T))
    place("exchange", (-step * per_flow[:, 0], step * per_flow[:, 1]))
    # An angle that is read too high by φ: lengths and volumes are wrong, their rates as well.
    grow = p[par.RADIUS] * np.column_stack([-np.ones(count), np.ones(count)]) * swell
    carried = p[par.POLYTROPIC_VOLUME] * shown[:, 2:4] * grow
    through = step * per_flow * passed * grow - (1.0 - slope) * carried
    stiff = np.full(count, -p[par.STIFFNESS])
    place("encoder", list(through.T), list(carried.T), -by_angle, stiff, pulled=True)
    place("meter", torque=np.where(has_torque, 1.0, 0.0), motion=np.where(has_torque, 1.0, 0.0))
    place("torque", motion=-np.ones(count))
    place("friction", motion=direction)
    if not has_torque.any():
        # One torque that is missing: of muscles or of the joint, nothing tells them apart.
        out.pop("meter")
    return {name: value for name, value in out.items() if np.any(value[0]) or np.any(value[1])}


def arguments_of(
    reference: Floats, blocks: Mapping[str, Floats], columns: Floats, p: Floats, rig: Rig, velocity: Floats
) -> dict[str, Floats]:
    """What a law may depend on (K,), by name; of a muscle with its number.

    Args:
        reference: states of the observer, which hold no noise of what they explain (K, n).
        blocks: means of what was measured (K,) or (K, 2), by name.
        columns: of :func:`~pam_antagonist.diagnosis.law_kernels.air_columns` (K, 2, 8).
        p: parameter vector (m,).
        rig: for its drive.
        velocity: of the joint (K,) [rad/s].
    """
    first, second = reference[:, PRESSURE_1], reference[:, PRESSURE_2]
    angle = blocks["angle"]
    speed = np.nan_to_num(velocity)
    sine = np.sin(angle) if p[par.PULLEY] == 0.0 else angle
    arm = np.cos(angle) if p[par.PULLEY] == 0.0 else np.ones(len(angle))
    out = {
        "pressure_1": first, "pressure_2": second,
        "pressure_difference": first - second, "pressure_sum": first + second,
        "angle": angle, "velocity": speed, "speed": np.abs(speed), "time": blocks["time"],
        "valve_flow_1": columns[:, 0, 3], "valve_flow_2": columns[:, 1, 3],
        "draw": columns[:, 0, 4] + columns[:, 1, 4],
        "length_1": p[par.LENGTH] - p[par.RADIUS] * sine, "length_2": p[par.LENGTH] + p[par.RADIUS] * sine,
        "length_rate_1": -p[par.RADIUS] * arm * speed, "length_rate_2": p[par.RADIUS] * arm * speed,
    }  # fmt: skip
    if rig.drive == "valve" and not rig.valves.sealed:
        for i in (0, 1):
            out[f"open_rate_{i + 1}"] = columns[:, i, 7]
    return out
