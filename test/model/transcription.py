"""Equations (2) to (11) of the paper once more, in plain Python: slow, plain, and a check on the compiled physics.

Written from the paper's text, not from the package, of which it imports nothing: only ``math``. The numbers
are Table II, typed in by hand. Where the print cannot be right the corrected form stands here and says so.
Functions take the table first, then the muscle's number (1 or 2, as in the paper), then what varies.
"""

import math

TABLE_II = {
    "r_p": 0.006,
    "r": 0.0365,
    "L_0": 0.165,
    "M": 0.256,
    "g": 9.80,
    "P_tank": 0.7100e6,
    "P_out": 0.1013e6,
    "k": 1.40,
    "R": 287.0,
    "T": 293.0,
    "J": 4.263e-4,
    "k_s": 4.117e-4,
    "c_s": 2.256e-3,
    "k_1": 1.100,
    "k_2": 0.4545,
    "D_1": -2.440e-2,
    "D_2": 6.824e-3,
    "D_3": -4.254e-4,
    "p_v11": 7.045e-3,
    "p_v21": -1.017e-3,
    "p_w11": -5.568e2,
    "p_w21": 72.86,
    "p_v12": 6.423e-3,
    "p_v22": -9.184e-4,
    "p_w12": -197.8,
    "p_w22": -15.75,  # as printed; see CORRECTED
    "A_11": 5.184e-8,
    "A_12": 7.776e-8,
    "T_p'": 4e8,
    "mu_s": 0.2,
}
"""Table II of the paper to the letter, SI units."""

ASSUMED = {
    "T_stp": 1e-3,  # the paper's sampling period [s]
    "stop": math.radians(25.0),  # the paper's range of rotation
    "gauge_floor": 20e3,  # [Pa] T_p is singular at atmospheric pressure; the paper gives no bound
    "curve": [  # kappa(u) [V] -> [-]; the paper only draws it
        (0.0, 0.0),
        (4.0, 0.20),
        (4.6, 0.26),
        (5.0, 0.33),
        (5.5, 0.394),
        (6.0, 0.47),
        (6.6, 0.56),
        (7.5, 0.80),
        (10.0, 1.0),
    ],
}
"""What the equations need and the table does not hold."""

AS_PRINTED = {**TABLE_II, **ASSUMED}
CORRECTED = {**AS_PRINTED, "p_w22": 15.75}
"""The table with the one sign changed without which the joint does not rest near zero at equal pressures."""


# Geometry and volume: equations (2), (3)


def length(t, i, psi):
    shift = t["r"] * math.sin(psi)
    return t["L_0"] - shift if i == 1 else t["L_0"] + shift


def length_rate(t, i, psi, psi_dot):
    rate = t["r"] * math.cos(psi) * psi_dot
    return -rate if i == 1 else rate


def volume(t, l_i):
    return t["D_1"] * l_i**2 + t["D_2"] * l_i + t["D_3"]


def volume_rate(t, l_i, l_dot):
    return (2 * t["D_1"] * l_i + t["D_2"]) * l_dot


# Fluid: equations (4), (5)


def kappa(t, u):
    points = t["curve"]
    if u <= points[0][0]:
        return points[0][1]
    if u >= points[-1][0]:
        return points[-1][1]
    for (u_a, a), (u_b, b) in zip(points, points[1:], strict=False):
        if u_a <= u <= u_b:
            return a + (b - a) * (u - u_a) / (u_b - u_a)
    raise AssertionError(f"no segment holds {u} V")


def critical_ratio(t):
    return (2 / (t["k"] + 1)) ** (t["k"] / (t["k"] - 1))


def nozzle(t, before, behind):
    """m_in and m_out of equation (5) without A_0; the print covers behind <= before only."""
    k, gas, temperature = t["k"], t["R"], t["T"]
    if behind <= before * critical_ratio(t):
        return before / math.sqrt(temperature) * math.sqrt(k / gas * (2 / (k + 1)) ** ((k + 1) / (k - 1)))
    ratio = behind / before
    return (
        before
        / math.sqrt(temperature)
        * math.sqrt(2 * k / (gas * (k - 1)))
        * ratio ** (1 / k)
        * math.sqrt(1 - ratio ** ((k - 1) / k))
    )


def nozzle_either_way(t, before, behind):
    """The same with flow back where the pressures stand the other way round (not in the paper)."""
    return nozzle(t, before, behind) if behind <= before else -nozzle(t, behind, before)


def mass_flow(t, u, pressure):
    alpha = kappa(t, u)
    per_area = alpha * nozzle_either_way(t, t["P_tank"], pressure) - (1 - alpha) * nozzle_either_way(
        t, pressure, t["P_out"]
    )
    # A_0 = A_1 if m > 0, else A_2; the table's A_11 and A_12 taken as inflow and outflow area of both valves.
    return (t["A_11"] if per_area > 0 else t["A_12"]) * per_area


def pressure_rate(t, i, psi, psi_dot, pressure, u):
    l_i = length(t, i, psi)
    v = volume(t, l_i)
    v_dot = volume_rate(t, l_i, length_rate(t, i, psi, psi_dot))
    return t["k_1"] * t["R"] * t["T"] / v * mass_flow(t, u, pressure) - t["k_2"] * v_dot / v * pressure


# Force and torque: equations (6), (7), (9)


def force(t, i, l_i, pressure):
    v = t[f"p_v1{i}"] * l_i + t[f"p_v2{i}"]
    w = t[f"p_w1{i}"] * l_i + t[f"p_w2{i}"]
    return v * pressure + w


def torque(t, psi, p_1, p_2):
    f_1 = force(t, 1, length(t, 1, psi), p_1)
    f_2 = force(t, 2, length(t, 2, psi), p_2)
    return t["r"] * math.cos(psi) * (f_1 - f_2)


# Friction and motion: equations (8), (10)


def shaft_friction(t, f_1, f_2):
    return t["r_p"] * t["mu_s"] * abs(f_1 + f_2 - t["M"] * t["g"])


def muscle_friction(t, p_1, p_2):
    """T_p; the gauge pressures are bounded below, since the printed law is singular at P_out."""
    g_1 = max(p_1 - t["P_out"], t["gauge_floor"])
    g_2 = max(p_2 - t["P_out"], t["gauge_floor"])
    return t["T_p'"] * (1 / g_1**2 + 1 / g_2**2)


def friction(t, psi_dot_before, t_0, coulomb):
    """T_f, and whether the joint slides; Z = T_stp/J (printed upside down), and the viscous torque is that of now."""
    viscous = t["c_s"] * psi_dot_before
    free = psi_dot_before + t["T_stp"] / t["J"] * (t_0 - viscous)  # after a step without dry friction
    stopping = free / (t["T_stp"] / t["J"])
    if abs(stopping) > coulomb:
        return math.copysign(coulomb, stopping) + viscous, True
    return stopping + viscous, False


def printed_friction(t, psi_dot_before, t_0, coulomb):
    """T_f of equation (10), but for its Z: the viscous torque, too, is that at the end of the step."""
    z = t["T_stp"] / t["J"]
    psi_dot = psi_dot_before + z * t_0
    if abs(psi_dot) > z * coulomb:
        sgn = math.copysign(1.0, psi_dot)
        return (coulomb * sgn + t["c_s"] * psi_dot) / (1 + z * t["c_s"])
    return psi_dot / z


def balance(t, x):
    """tau, T_s + T_p and T_0 of a state."""
    psi, _, p_1, p_2 = x
    f_1 = force(t, 1, length(t, 1, psi), p_1)
    f_2 = force(t, 2, length(t, 2, psi), p_2)
    tau = t["r"] * math.cos(psi) * (f_1 - f_2)
    return tau, shaft_friction(t, f_1, f_2) + muscle_friction(t, p_1, p_2), tau - t["k_s"] * psi


def slides(t, x):
    _, coulomb, t_0 = balance(t, x)
    return friction(t, x[1], t_0, coulomb)[1]


# State space: equation (11)


def derivative(t, x, u, locked=False):
    psi, psi_dot, p_1, p_2 = x
    p_dot = [pressure_rate(t, i, psi, psi_dot, p_i, u_i) for i, p_i, u_i in ((1, p_1, u[0]), (2, p_2, u[1]))]
    if locked:
        return [0.0, 0.0, *p_dot]
    tau, coulomb, t_0 = balance(t, x)
    t_f, _ = friction(t, psi_dot, t_0, coulomb)
    return [psi_dot, (tau - t_f - t["k_s"] * psi) / t["J"], *p_dot]


def runge_kutta(t, x, u, h, locked=False):
    """The classical fourth-order step with the input held."""

    def shifted(by, share):
        return [a + share * b for a, b in zip(x, by, strict=True)]

    a = derivative(t, x, u, locked)
    b = derivative(t, shifted(a, h / 2), u, locked)
    c = derivative(t, shifted(b, h / 2), u, locked)
    d = derivative(t, shifted(c, h), u, locked)
    return [x[j] + h / 6 * (a[j] + 2 * b[j] + 2 * c[j] + d[j]) for j in range(4)]


def regime(t, pressure):
    """0: only the inflow is choked, 1: both are, 2: only the outflow (supply far above the atmosphere)."""
    inflow = pressure <= t["P_tank"] * critical_ratio(t)
    outflow = t["P_out"] <= pressure * critical_ratio(t)
    return {(True, False): 0, (True, True): 1, (False, True): 2}[inflow, outflow]


def rest(t, p_1, p_2, share=0.0):
    """Angle where T_0 is that share of T_s + T_p: 0 for the balance without friction, ±1 for the two ends of the
    range in which the joint sticks. By bisection; T_0 falls with the angle."""
    low, high = -1.0, 1.0
    for _ in range(80):
        middle = 0.5 * (low + high)
        _, coulomb, t_0 = balance(t, [middle, 0.0, p_1, p_2])
        low, high = (middle, high) if t_0 > share * coulomb else (low, middle)
    return 0.5 * (low + high)
