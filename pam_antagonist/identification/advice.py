"""What to record so that a parameter shows."""

from __future__ import annotations

_ADVICE = (
    ("joint.inertia", "a free joint that is made to move fast: large voltage steps in opposite directions"),
    ("joint.viscous_friction", "a free joint that moves fast for long: alternate the valves' extremes every 0.3 s"),
    ("friction.", "a free joint with a measured angle that comes to rest at many angles and pressures"),
    ("force.v", "a free joint over its whole angle range, at low and at high pressures, with torque or angle measured"),
    ("force.w", "a free joint over its whole angle range, at low and at high pressures, with torque or angle measured"),
    ("force.c", "a free joint over its whole angle range, at low and at high pressures, with torque or angle measured"),
    ("inflow_area", "fast fillings of this muscle from low pressure: steps of its valve to the highest voltage"),
    ("outflow_area", "fast emptyings of this muscle from high pressure: steps of its valve to the lowest voltage"),
    ("gas.polytropic_flow", "the volume of the chambers or the orifice areas measured apart: they act together"),
    ("gas.polytropic_volume", "a free joint that moves while the valves are still, so that only the volume changes"),
    (".volume.", "the volume of the muscle by length in a graduated cylinder (a static CSV)"),
    ("supply.pressure", "a steady pressure with the valve fully open, or a gauge on the tank"),
    ("effects.", "longer recordings in which the effect is at work"),
)


def advice(name: str) -> str:
    """What to record so that a parameter shows.

    Args:
        name: its dotted path.
    """
    return next((text for part, text in _ADVICE if part in name), "a longer recording with larger steps")
