"""The experiment that would tell effects apart that a recording cannot."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

_STEADY = "hold each of six voltages for 10 s: the steady pressures tell it"
_PAIRS: Mapping[frozenset[str], str] = {
    frozenset({"leak", "valve_offset"}): "close the valves (or plug the muscle) under pressure: only a leak goes on",
    frozenset({"leak", "pressure_sensor"}): "close the valves under pressure: a leak falls to the atmosphere, "
    "a wrong sensor stands still",
    frozenset({"valve_offset", "pressure_sensor"}): "vent the muscle and read the sensor at the atmosphere's pressure",
    frozenset({"hysteresis", "friction"}): "turn the joint by hand with both muscles vented: friction of the shaft "
    "stays, hysteresis of the muscles goes with the pressure",
    frozenset({"hysteresis", "creep"}): "turn the joint by the same way slowly and fast: hysteresis gives the same "
    "loop, creep does not",
    frozenset({"creep", "thermal"}): "lock the joint, step the pressure and wait: warmth moves the pressures, creep "
    "only the torque",
    frozenset({"supply_droop", "line_resistance"}): "fill one muscle while the other is held: a drooping supply shows "
    "in both pressures, a line in one",
    frozenset({"valve_lag", "line_resistance"}): "step the valve at different pressures: a lag is the same, what a "
    "line adds grows with the flow",
    frozenset({"load_torque", "friction"}): "approach the same pressures from both sides: a load shifts both rest "
    "angles alike, friction apart",
    frozenset({"external_torque", "friction"}): "repeat the same command: friction repeats, a push does not",
    frozenset({"external_torque", "load_torque"}): "repeat the same command: a load repeats, a push does not",
}
_SINGLE: Mapping[str, str] = {
    "hysteresis": "turn the joint slowly to and fro at constant pressures and plot torque over angle",
    "leak": "close the valves under pressure and watch the pressures for a minute",
    "supply_droop": "record the pressure of the tank as well",
    "valve_lag": "step one valve by 1 V every 0.2 s",
    "valve_offset": _STEADY,
    "line_resistance": "record the pressure at the muscle's far end as well",
    "pressure_sensor": "compare the sensor with a gauge at three pressures",
    "load_torque": "move the joint slowly through its range with the load taken off",
    "friction": "move the joint slowly and fast through the same angles at constant pressures",
    "creep": "step the angle and hold for 60 s",
    "thermal": "lock the joint, step the pressure and hold for 30 s",
    "external_torque": "repeat the recording with nobody near the joint",
}


def experiments_that_tell(
    found: Sequence[str], ambiguous: Sequence[str], conditions: Collection[str]
) -> dict[str, str]:
    """For each effect that is as likely as a found one, what to record.

    Args:
        found: effects in the model.
        ambiguous: effects that do as well.
        conditions: of the joint in the recordings at hand.
    """
    said = {}
    for other in ambiguous:
        pair = _PAIRS.get(frozenset({other, found[0]})) if found else None
        said[other] = pair or _SINGLE[other]
        if len(set(conditions)) == 1:
            missing = "locked" if "free" in conditions else "free"
            said[other] += f"; or add a recording with the joint {missing}"
    return said
