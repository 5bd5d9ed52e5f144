"""Proposition 1 by computation: which parameters change the steady state, which the transients, and the guideline."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.model import equilibrium, integration
from pam_antagonist.report.figure import TIME, Axis, Figure, Line, Panel
from pam_antagonist.report.style import PALETTE
from pam_antagonist.report.table import Table, number
from pam_antagonist.rig import Rig
from pam_antagonist.simulation.excitation import Span
from validation.paper.result import Beside, Context, Result, Spread
from validation.paper.scenario import START

Floats = NDArray[np.float64]

AREAS = tuple(f"valve_{i}.{way}_area" for i in (1, 2) for way in ("inflow", "outflow"))
PARAMETERS = {
    "T_p'": ("friction.muscle",),
    "μ_s": ("friction.shaft",),
    "A_0": AREAS,
    "k_1": ("gas.polytropic_flow",),
    "k_2": ("gas.polytropic_volume",),
}
STEADY = ("T_p'", "μ_s")
"""Those that the paper says affect the steady state; the others, the transients."""
_FACTOR = 1.5
_SHOWN = (0.5, 1.0, 2.0)
_REST_S, _HOLD_S, _RAMP_S = 2.0, 60.0, 120.0
_DRIVE = 0.4
_PULSES_S, _PULSE = (0.3, 0.6, 1.0, 1.5, 3.0), (1.0, -1.0)
_SAME_PA, _SAME_RAD, _SAME_S = 50.0, math.radians(0.02), 0.005


@dataclass(frozen=True)
class Response:
    """What one set of parameters does.

    Attributes:
        pressures: where they stand in the end [Pa].
        slow_angle: of rest, after voltages that changed slowly [rad].
        abrupt_angle: of rest, after a step [rad].
        pulse_angles: of rest, after pulses of several lengths beyond those voltages [rad].
        pressure_time: from the step until pressure 1 has made 63 % of its way [s].
        angle_time: until the angle has made 90 % of its own way [s].
    """

    pressures: tuple[float, float]
    slow_angle: float
    abrupt_angle: float
    pulse_angles: tuple[float, ...]
    pressure_time: float
    angle_time: float


def drives(rig: Rig) -> tuple[Floats, Floats, list[Floats]]:
    """Ways to the same voltages, each (N, 2) [V]: a step, a slow ramp, and short pulses beyond them and back."""
    span, period = Span(), rig.sample_period
    end = np.array([_DRIVE, -_DRIVE])
    at = np.arange(round((_REST_S + _HOLD_S) / period)) * period
    abrupt = (at >= _REST_S)[:, None] * end
    pulses = []
    for length in _PULSES_S:
        pulse = abrupt.copy()
        pulse[(at >= _REST_S) & (at < _REST_S + length)] = _PULSE
        pulses.append(span.voltage(pulse))
    at = np.arange(round((_RAMP_S + _HOLD_S) / period)) * period
    slow = np.minimum(at / _RAMP_S, 1.0)[:, None] * end
    return span.voltage(abrupt), span.voltage(slow), pulses


def run(rig: Rig, voltage: Floats, factors: dict[str, float]) -> Floats:
    """States (N, 4) of the declared model with some parameters times a factor.

    Args:
        rig: with the declared parameters.
        voltage: (N, 2) [V].
        factors: by parameter.
    """
    changes = {name: rig.value(name) * factor for name, factor in factors.items()}
    p = rig.parameters("free", 0.0, changes)
    start = equilibrium.initial_state(float(equilibrium.rest_angle(*START, p)), *START, voltage[0], p)
    return np.asarray(integration.course(start, voltage, p, rig.sample_period, 1)[0])


def response(rig: Rig, factors: dict[str, float]) -> Response:
    """Steady state and transient times with some parameters times a factor."""
    step, ramp, pulses = drives(rig)
    abrupt, slow = run(rig, step, factors), run(rig, ramp, factors)
    first = round(_REST_S / rig.sample_period)

    def reached(values: Floats, share: float) -> float:
        way = values[first:] - values[first - 1]
        return float(np.argmax(way / way[-1] >= share) * rig.sample_period)

    return Response(
        (float(abrupt[-1, 2]), float(abrupt[-1, 3])),
        float(slow[-1, 0]),
        float(abrupt[-1, 0]),
        tuple(float(run(rig, pulse, factors)[-1, 0]) for pulse in pulses),
        reached(abrupt[:, 2], 0.63),
        reached(abrupt[:, 0], 0.9),
    )


def result(context: Context) -> Result:
    """All parameters, each up by half."""
    rig = context.work.rig.declared
    base = response(rig, {})
    changed = {label: response(rig, dict.fromkeys(names, _FACTOR)) for label, names in PARAMETERS.items()}
    degree = math.degrees(1.0)
    rows, beside = [], []
    numbers: dict[str, Any] = {"base": vars(base), "factor": _FACTOR}
    for label, other in changed.items():
        pressure = max(abs(a - b) for a, b in zip(other.pressures, base.pressures, strict=True))
        pulsed = np.subtract(other.pulse_angles, base.pulse_angles)
        angles = [
            (other.slow_angle - base.slow_angle) * degree,
            (other.abrupt_angle - base.abrupt_angle) * degree,
            float(pulsed[np.argmax(np.abs(pulsed))]) * degree,
        ]
        times = other.pressure_time - base.pressure_time, other.angle_time - base.angle_time
        rows.append(
            (
                label,
                _signed(pressure / 1e3) if pressure > _SAME_PA else "none",
                *(_signed(angle) if abs(angle) > _SAME_RAD * degree else "none" for angle in angles),
                _signed(times[0]) if abs(times[0]) > _SAME_S else "none",
                _signed(times[1]) if abs(times[1]) > _SAME_S else "none",
                "steady state" if label in STEADY else "transients",
            )
        )
        beside.append(_guideline(label, other, base))
        numbers[label] = vars(other)
    table = Table(
        (
            f"Parameter × {_FACTOR:g}", "steady pressure [kPa]", "steady angle, slow way [°]",
            "… after a step [°]", "… after a pulse, largest [°]", "time of P₁ to 63 % [s]", "time of ψ to 90 % [s]",
            "paper: affects",
        ),
        tuple(rows),
        f"Change against the declared parameters (steady angle {number(base.slow_angle * degree)}°, times "
        f"{number(base.pressure_time)} s and {number(base.angle_time)} s)",
    )  # fmt: skip
    return Result(
        name="influence",
        title="Proposition 1 and the influence of parameters",
        question=(
            "One parameter of the declared model at a time is 1.5 times as large. The model is driven to the same "
            "voltages in three ways: by a step, slowly (over 120 s), and by a pulse beyond them."
        ),
        beside=tuple(beside),
        tables=(table,),
        findings=_findings(changed, base),
        figures=_figures(rig) if context.with_figures else (),
        numbers=numbers,
    )


def _signed(value: float) -> str:
    return ("+" if value > 0 else "") + number(value)


def _guideline(label: str, other: Response, base: Response) -> Beside:
    """The paper's guideline for one parameter, as a change of the number that it speaks of."""
    if label in STEADY:
        change = (abs(other.slow_angle) - abs(base.slow_angle)) * math.degrees(1.0)
        holds = change < 0.0
        what, unit, claim = f"{label} up by half: steady |ψ|", "°", "decreases"
    else:
        change = other.angle_time - base.angle_time
        holds = change < -_SAME_S
        what, unit, claim = f"{label} up by half: time of ψ to 90 %", "s", "falls (the response becomes faster)"
    verdict = (
        f"The guideline says that it {claim}: it does."
        if holds
        else f"The guideline says that it {claim}: it does not."
    )
    if not holds and label == "k_2":
        verdict += (
            " The term −k_2 V̇ P/V works against every change of pressure that moves the joint. A larger k_2 slows "
            "the response; by how much depends on the step."
        )
    return Beside(what, Spread.of([change]), None, unit, verdict)


def _findings(changed: dict[str, Response], base: Response) -> tuple[str, ...]:
    transient = {label: other for label, other in changed.items() if label not in STEADY}
    pressure = max(
        abs(a - b) for other in changed.values() for a, b in zip(other.pressures, base.pressures, strict=True)
    )
    plain = max(
        abs(math.degrees(getattr(other, name) - getattr(base, name)))
        for other in transient.values()
        for name in ("slow_angle", "abrupt_angle")
    )
    pulse = max(
        float(np.degrees(np.max(np.abs(np.subtract(other.pulse_angles, base.pulse_angles)))))
        for other in transient.values()
    )
    lengths = ", ".join(f"{length:g}" for length in _PULSES_S)
    sentence = (
        "A pulse moves the joint beyond its final place. It then stops anywhere in the band in which friction holds "
        "it, and the transient decides where. The proof assumes that τ − T_f = 0 has one solution. With dry friction "
        "the solutions are an interval."
        if math.radians(pulse) > _SAME_RAD
        else "So it also holds for a joint that a pulse has moved beyond its final place."
    )
    thrown = np.degrees(np.subtract(changed["μ_s"].pulse_angles, base.pulse_angles)[-1])
    return (
        "Pressures: the proposition holds. None of the five parameters changes a steady pressure (largest change "
        f"{number(pressure)} Pa, the rest of the transient).",
        "Angle: the proposition holds for a joint that reaches its final place from one side, slowly or by a step. "
        f"A_0, k_1 and k_2 then change the angle by at most {number(plain, 2)}°. After pulses of {lengths} s to the "
        f"extreme voltages they change it by up to {number(pulse)}°. {sentence}",
        "The guideline on T_p' and μ_s holds for a joint that comes from the middle. A joint that comes back from "
        f"beyond stops on the other side of the band: after a pulse of {_PULSES_S[-1]:g} s, a larger μ_s changes its "
        f"angle by {_signed(float(thrown))}°.",
    )


def _figures(rig: Rig) -> tuple[Figure, ...]:
    abrupt, _, _ = drives(rig)
    until = round(12.0 / rig.sample_period)
    x = np.arange(until, dtype=np.float64) * rig.sample_period
    out = []
    shown = {"T_p'": ("T_p'",), "μ_s": ("μ_s",), "A_0": ("A_0",), "k_1 and k_2": ("k_1", "k_2")}
    for title, labels in shown.items():
        panels: list[Panel] = []
        for label in labels:
            angles = {}
            for factor in _SHOWN:
                states = run(rig, abrupt[:until], dict.fromkeys(PARAMETERS[label], factor))
                angles[f"× {factor:g}"] = np.degrees(states[:, 0])
            axis = Axis(f"ψ [°], {label}" if len(labels) > 1 else "ψ [°]")
            drawn = (
                Line(name, x, values, color, quiet=bool(panels))
                for (name, values), color in zip(angles.items(), PALETTE, strict=False)
            )
            panels.append(Panel(TIME, axis, tuple(drawn), 200))
        about = "A step of both valves at 2 s, declared model."
        out.append(Figure(f"Influence of {title}", about, tuple(panels), "influence"))
    return tuple(out)
