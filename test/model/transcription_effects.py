"""The effects once more, in plain Python, written from the words and laws of docs/effects.md.

Like :mod:`transcription` it imports nothing of the package. ``e`` holds the effects' numbers under
``"effect.parameter"``; what is not in it is not there. Added states follow P_2 in the order of ``ORDER``.
"""

import math

import transcription as paper

ORDER = (
    ("hysteresis_1", "hysteresis.amplitude_1"),
    ("hysteresis_2", "hysteresis.amplitude_2"),
    ("supply", "supply_droop.stiffness"),
    ("open_rate_1", "valve_lag.time_1"),
    ("open_rate_2", "valve_lag.time_2"),
    ("chamber_1", "line_resistance.resistance_1"),
    ("chamber_2", "line_resistance.resistance_2"),
    ("reading_drift_1", "pressure_sensor.drift_1"),
    ("reading_drift_2", "pressure_sensor.drift_2"),
    ("reading_drift_rate_1", "pressure_sensor.drift_1"),
    ("reading_drift_rate_2", "pressure_sensor.drift_2"),
    ("creep_1", "creep.share_1", "creep.stiffness"),
    ("creep_2", "creep.share_2", "creep.stiffness"),
    ("warmth_1", "thermal.share_1"),
    ("warmth_2", "thermal.share_2"),
    ("external_torque", "external_torque.noise"),
    ("spool_voltage_1", "valve_play.play_1"),
    ("spool_voltage_2", "valve_play.play_2"),
    ("warmed", "warm_up.share_1", "warm_up.share_2"),
    ("regulator_goal_1", "regulator_threshold.threshold_1"),
    ("regulator_goal_2", "regulator_threshold.threshold_2"),
    ("late_command_1", "regulator_dead_time.time_1"),
    ("late_command_2", "regulator_dead_time.time_2"),
    ("late_command_rate_1", "regulator_dead_time.time_1"),
    ("late_command_rate_2", "regulator_dead_time.time_2"),
    ("regulator_rate_1", "regulator_lag.frequency_1"),
    ("regulator_rate_2", "regulator_lag.frequency_2"),
)
"""Added states, and the numbers that bring each."""


def states(e):
    """Names of the states that are there."""
    return [name for name, *switches in ORDER if any(e.get(switch, 0.0) != 0.0 for switch in switches)]


def open_rate(t, e, i, u_i):
    """What a voltage opens a valve to in the end: never more than wholly, never less than not at all."""
    raised = paper.kappa(t, u_i - e.get(f"valve_offset.voltage_{i}", 0.0)) + e.get(f"valve_offset.open_rate_{i}", 0.0)
    return sorted((0.0, raised, 1.0))[1]


def exchange(t, alpha, at_valve, supply):
    """Mass flow through a valve into the muscle, and what of it comes out of the supply."""
    inflow = alpha * paper.nozzle_either_way(t, supply, at_valve)
    per_area = inflow - (1 - alpha) * paper.nozzle_either_way(t, at_valve, t["P_out"])
    area = t["A_11"] if per_area > 0 else t["A_12"]
    return area * per_area, t["A_11"] * inflow


def relaxes(t, e, i, psi, chamber):
    """What of a muscle's force is borne by parts that give way: a share of it, and a spring of the tube's own."""
    l_i = paper.length(t, i, psi)
    return e.get(f"creep.share_{i}", 0.0) * paper.force(t, i, l_i, chamber) - e.get("creep.stiffness", 0.0) * l_i


def contraction_force(t, e, i, psi, chamber, loop, late, warm):
    l_i = paper.length(t, i, psi)
    static = paper.force(t, i, l_i, chamber)
    force = static - relaxes(t, e, i, psi, chamber) + late + e.get(f"hysteresis.amplitude_{i}", 0.0) * loop
    # By (6) that is v_i times the gauge pressure.
    force -= e.get(f"warm_up.share_{i}", 0.0) * warm * (static - paper.force(t, i, l_i, t["P_out"]))
    width = e.get("slack.width", 0.0)
    force = force if width == 0.0 else (force + math.hypot(force, width)) / 2
    return force * (
        1 + sum(e.get(f"strength_by_signal.slope{k}", 0.0) * s for k, s in enumerate(t.get("signals", ()), 1))
    )


def in_chamber(x, added, i):
    """Pressure of a muscle: behind its line where there is one, without what its reading drifts."""
    return added.get(f"chamber_{i}", x[1 + i]) - added.get(f"reading_drift_{i}", 0.0)


def torque_on_muscles(t, e, x):
    """What a torque meter between muscles and joint shows."""
    added = dict(zip(states(e), x[4:], strict=True))
    forces = []
    for i in (1, 2):
        chamber = in_chamber(x, added, i)
        loop = added.get(f"hysteresis_{i}", 0.0)
        late = added.get(f"creep_{i}", relaxes(t, e, i, x[0], chamber))
        forces.append(contraction_force(t, e, i, x[0], chamber, loop, late, added.get("warmed", 0.0)))
    return t["r"] * math.cos(x[0]) * (forces[0] - forces[1]), forces


def moves(t, e, x, outside=0.0):
    """T_0, the Coulomb torque, and friction with whether the joint slides."""
    added = dict(zip(states(e), x[4:], strict=True))
    psi, psi_dot = x[0], x[1]
    tau, (f_1, f_2) = torque_on_muscles(t, e, x)
    c_1, c_2 = (in_chamber(x, added, i) for i in (1, 2))
    load = e.get("load_torque.constant", 0.0) + e.get("load_torque.sine", 0.0) * math.sin(psi)
    load -= e.get("limb_weight.torque", 0.0) * math.sin(psi - e.get("limb_weight.hanging", 0.5))
    load += sum(e.get(f"load_by_signal.slope{k}", 0.0) * s for k, s in enumerate(t.get("signals", ()), 1))
    further, held = weak_laws(e, t.get("coefficients", (0.0,) * 15), psi, psi_dot)
    load += further
    t_0 = tau + load + outside + added.get("external_torque", 0.0) - t["k_s"] * psi
    coulomb = paper.shaft_friction(t, f_1, f_2) + paper.muscle_friction(t, c_1, c_2)
    coulomb += e.get("friction.coulomb", 0.0)
    coulomb += e.get("friction.stribeck", 0.0) * math.exp(-abs(psi_dot) / e.get("friction.velocity", 0.3))
    coulomb += sum(
        e.get(f"friction_by_pressure.slope_{i + 1}", 0.0) * (c - t["P_out"]) for i, c in ((0, c_1), (1, c_2))
    )
    coulomb += sum(e.get(f"friction_by_signal.slope{k}", 0.0) * s for k, s in enumerate(t.get("signals", ()), 1))
    coulomb = max(coulomb + held, 0.0)
    return t_0, coulomb, paper.friction(t, psi_dot, t_0, coulomb)


def weak_laws(e, c, psi, psi_dot):
    """Torque and Coulomb torque of weak laws, by their equations; `c`: their 15 coefficients."""
    s = min(max(psi / e.get("weak_laws.angle", 0.5), -2.4), 2.4)
    fast = abs(psi_dot) / e.get("weak_laws.velocity", 0.5)
    torque = c[0] + c[1] * s + c[2] * s**2 + c[3] * s**3
    torque -= (c[4] + c[5] * s + c[6] * s**2 + c[7] * abs(psi_dot)) * psi_dot
    coulomb = c[8] + c[9] * s + c[10] * s**2 + (c[11] + c[12] * s) * math.exp(-fast) + (c[13] + c[14] * s) * fast
    amount = e.get("weak_laws.amount", 0.0)
    return amount * torque, amount * coulomb


def regulate(t, e, i, command, at_valve, added, rates, rate):
    """Rate of a pressure with its regulator; fills in the rates of the regulator's states."""
    asked = max(command, e.get("regulator_limits.lowest", -math.inf))
    asked = min(asked, e.get("regulator_limits.highest", math.inf))
    shortest = t["T_stp"] / 2
    if f"regulator_goal_{i}" in added:
        goal = added[f"regulator_goal_{i}"]
        outside_the_play = max(0.0, abs(asked - goal) - e[f"regulator_threshold.threshold_{i}"] / 2)
        rates[f"regulator_goal_{i}"] = math.copysign(outside_the_play, asked - goal) / shortest
        asked = goal
    if f"late_command_{i}" in added:
        late, late_rate, tau = (
            added[f"late_command_{i}"],
            added[f"late_command_rate_{i}"],
            e[f"regulator_dead_time.time_{i}"],
        )
        rates[f"late_command_{i}"] = late_rate
        rates[f"late_command_rate_{i}"] = (asked - late - tau * late_rate) / (tau**2 / 2)
        asked = late
    if f"regulator_rate_{i}" not in added:
        return rate
    omega, zeta, s = (
        e[f"regulator_lag.frequency_{i}"],
        e.get("regulator_lag.damping", 0.7),
        added[f"regulator_rate_{i}"],
    )
    off = asked - at_valve
    off = math.copysign(max(abs(off) - e.get("regulator_lag.dead_zone", 0.0), 0.0), off)
    speeding_up = omega**2 * off - 2 * zeta * omega * s
    if "regulator_lag.largest_rate" in e:
        most = e["regulator_lag.largest_rate"]
        speeding_up = sorted(((-most - s) / shortest, speeding_up, (most - s) / shortest))[1]
    rates[f"regulator_rate_{i}"] = speeding_up
    return max(rate + s, (t["P_out"] - at_valve) / shortest)


def derivative(t, e, x, u, outside=0.0, locked=False):
    """ẋ as a list in the order of the state."""
    names = states(e)
    added = dict(zip(names, x[4:], strict=True))
    psi, psi_dot = x[0], x[1]
    rates = dict.fromkeys(names, 0.0)
    supply = t["P_tank"] + added.get("supply", 0.0)
    drawn_in_all = 0.0
    shown = []
    for i in (1, 2):
        spool = added.get(f"spool_voltage_{i}", u[i - 1])
        if f"spool_voltage_{i}" in added:
            outside_the_play = max(0.0, abs(u[i - 1] - spool) - e[f"valve_play.play_{i}"] / 2)
            rates[f"spool_voltage_{i}"] = math.copysign(outside_the_play, u[i - 1] - spool) / (t["T_stp"] / 2)
        wanted = open_rate(t, e, i, spool)
        alpha = added.get(f"open_rate_{i}", wanted)
        if f"open_rate_{i}" in added:
            full_speed = 1.0 / e[f"valve_lag.time_{i}"]
            asked = (wanted - alpha) / (e.get("valve_lag.reach", 1.0) * e[f"valve_lag.time_{i}"])
            rates[f"open_rate_{i}"] = math.copysign(min(abs(asked), full_speed), asked)
        chamber = in_chamber(x, added, i)
        through_valve, drawn = exchange(t, alpha, x[1 + i], supply)
        drawn_in_all += drawn
        lost = e.get(f"leak.area_{i}", 0.0) * paper.nozzle_either_way(t, chamber, t["P_out"])
        lost *= (max(chamber - t["P_out"], 1.0) / 350e3) ** (e.get("leak.exponent", 1.0) - 1.0)
        l_i = paper.length(t, i, psi)
        l_dot = paper.length_rate(t, i, psi, psi_dot)
        volume = paper.volume(t, l_i)
        rate = t["k_1"] * t["R"] * t["T"] / volume * (through_valve - lost)
        rate -= t["k_2"] * paper.volume_rate(t, l_i, l_dot) / volume * chamber
        if f"warmth_{i}" in added:
            cooling = added[f"warmth_{i}"] / e["thermal.time"]
            rates[f"warmth_{i}"] = e[f"thermal.share_{i}"] * rate - cooling
            rate -= cooling
        if f"chamber_{i}" in added:
            rates[f"chamber_{i}"] = rate
            # The line carries what comes through the valve; a leak is in the muscle.
            turbulence = (abs(through_valve) / 5e-5) ** (e.get("line_resistance.exponent", 1.0) - 1.0)
            across = e[f"line_resistance.resistance_{i}"] * through_valve * turbulence
            rate = (chamber + across - x[1 + i]) / e["line_resistance.time"]
        if f"reading_drift_{i}" in added:
            # A critically damped oscillator that noise drives: its two poles are both at -1/T.
            drift, drift_rate, pole = (
                added[f"reading_drift_{i}"],
                added[f"reading_drift_rate_{i}"],
                1 / e["pressure_sensor.drift_time"],
            )
            rates[f"reading_drift_{i}"] = drift_rate
            rates[f"reading_drift_rate_{i}"] = -2 * pole * drift_rate - pole**2 * drift
            rate += drift_rate
        rate = regulate(t, e, i, u[i - 1], x[1 + i], added, rates, rate)
        shown.append(rate)
        if f"hysteresis_{i}" in added:
            z = added[f"hysteresis_{i}"]
            rates[f"hysteresis_{i}"] = (l_dot - 0.5 * (abs(l_dot) * z + l_dot * abs(z))) / e["hysteresis.width"]
        if f"creep_{i}" in added:
            rates[f"creep_{i}"] = (relaxes(t, e, i, psi, chamber) - added[f"creep_{i}"]) / e["creep.time"]
    if "supply" in added:
        rates["supply"] = -e["supply_droop.stiffness"] * drawn_in_all - added["supply"] / e["supply_droop.time"]
    if "warmed" in added:
        rates["warmed"] = (1.0 - added["warmed"]) / e["warm_up.time"]
    rest = [rates[name] for name in names]
    if locked:
        return [0.0, 0.0, *shown, *rest]
    t_0, _, (t_f, _) = moves(t, e, x, outside)
    return [psi_dot, (t_0 - t_f) / t["J"], *shown, *rest]
