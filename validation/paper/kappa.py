"""The valve curve κ(u) by the paper's three steps, beside the virtual rig's own."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.identification.valve_curve import SteadyPoints, steady_open_rate, steady_points, valve_curve
from pam_antagonist.model import equilibrium, flow, integration
from pam_antagonist.recording import Recording
from pam_antagonist.report.figure import Axis, Figure, Line, Panel, Points, Series
from pam_antagonist.report.style import ESTIMATE, MEASURED, MODEL, SECOND
from pam_antagonist.report.table import Table, number
from pam_antagonist.rig.schema import Curve as ValveCurve
from validation.paper.result import Beside, Context, Result, Spread
from validation.paper.scenario import START
from validation.paper.seed_work import SeedWork

Floats = NDArray[np.float64]

LEVELS = (4.2, 4.4, 4.6, 4.8, 5.0, 5.25, 5.5, 5.75, 6.0, 6.3, 6.6, 7.0, 7.5)
"""Voltages that are held [V]: the range of the profile."""
_HOLD_S = 25.0
_SIMULATED = np.linspace(0.2, 0.8, 13)
"""Open rates whose steady pressure is simulated [-]."""


def staircase(work: SeedWork) -> Recording:
    """Each voltage held on both valves until the pressures stand, with the joint locked."""
    period = work.rig.declared.sample_period
    steps = np.repeat(np.array(LEVELS), round(_HOLD_S / period))
    return work.rig.record(np.column_stack([steps, steps]), "locked")


def simulated_pressures(work: SeedWork) -> Floats:
    """Step one as the paper does it: steady pressures (K,) [Pa] at open rates, by simulating the declared model."""
    rig = work.rig.declared
    straight = rig.valve_1.replaced(curve=ValveCurve(voltage=(0.0, 10.0), open_rate=(0.0, 1.0)))
    p = rig.replaced(valve_1=straight, valve_2=straight).parameters("locked")
    out = []
    for rate in _SIMULATED:
        voltage = np.full((round(60.0 / rig.sample_period), 2), 10.0 * rate)
        states, _ = integration.course(
            equilibrium.initial_state(0.0, *START, voltage[0], p), voltage, p, rig.sample_period, 1
        )
        out.append(states[-1, 2])
    return np.array(out)


def found(work: SeedWork, recording: Recording, valve: int) -> tuple[SteadyPoints, Floats, Floats]:
    """Steps two and three for valve 0 or 1: steady points, and the curve's voltages and open rates.

    Args:
        work: the virtual rig and its recordings.
        recording: with a staircase of voltages.
        valve: 0 or 1.
    """
    rig = work.rig.declared
    points = steady_points(recording.voltage[:, valve], recording.pressure[:, valve], rig.sample_period)
    voltage, rate = valve_curve(points, rig.parameters("locked"))
    return points, voltage, rate


def true_rates(work: SeedWork, valve: int, voltage: Floats) -> Floats:
    """Open rates of the virtual rig's own valve.

    Args:
        work: the virtual rig and its recordings.
        valve: 0 or 1.
        voltage: (K,) [V].
    """
    p = work.rig.plant("locked").parameters
    return np.array([flow.open_rate(valve, value, p) for value in voltage])


def of_seed(work: SeedWork) -> dict[str, Any]:
    """Errors of the found curve and of the declared one over the levels of both valves: median, and largest."""
    recording = staircase(work)
    declared = work.rig.declared.parameters()
    after, before, levels = [], [], []
    for valve in (0, 1):
        _, voltage, rate = found(work, recording, valve)
        true = true_rates(work, valve, voltage)
        after.append(np.abs(rate - true))
        before.append(np.abs(np.array([flow.open_rate(valve, u, declared) for u in voltage]) - true))
        levels.append(len(voltage))
    return {
        "found": {"median": float(np.median(np.concatenate(after))), "largest": float(np.max(np.concatenate(after)))},
        "declared": {
            "median": float(np.median(np.concatenate(before))),
            "largest": float(np.max(np.concatenate(before))),
        },
        "levels": min(levels),
    }


def result(context: Context) -> Result:
    """Curves of the first seed, errors over all."""
    work = context.work
    recording = staircase(work)
    simulated = simulated_pressures(work)
    closed = steady_open_rate(simulated, work.rig.declared.parameters("locked"))
    difference = float(np.max(np.abs(closed - _SIMULATED)))
    rows = []
    declared = work.rig.declared.parameters()
    curves = [found(work, recording, valve) for valve in (0, 1)]
    for voltage in curves[0][1]:
        row = [number(float(voltage), 3)]
        for valve in (0, 1):
            points, held, rate = curves[valve]
            at = int(np.argmin(np.abs(held - voltage)))
            true = float(true_rates(work, valve, held[at : at + 1])[0])
            row += [number(points.pressure[at] / 1e3, 4), number(float(rate[at])), number(true)]
        row.append(number(float(flow.open_rate(0, voltage, declared))))
        rows.append(tuple(row))
    header = ("u [V]", "P₁ [kPa]", "κ₁ found", "κ₁ true", "P₂ [kPa]", "κ₂ found", "κ₂ true", "κ declared")
    return Result(
        name="kappa",
        title="The valve curve κ(u)",
        question=(
            f"{len(LEVELS)} voltages, each held for {_HOLD_S:g} s on both valves of the virtual rig. Step one: open "
            "rate against steady pressure, from the declared model. Step two: steady pressure against voltage, from "
            "the recording. Step three: both joined through the pressure. It is the function that identification uses."
        ),
        beside=(
            Beside(
                "Error of the found open rate, median over the voltages",
                context.spread("found", "median"),
                None,
                "-",
                "The paper shows its curve as a picture and has no truth to compare with. What is left comes from the "
                "supply pressure, which the virtual rig has about 2 % off.",
            ),
            Beside(
                "Error of the declared open rate, median over the voltages",
                context.spread("declared", "median"),
                None,
                "-",
                "The declared mismatch.",
            ),
            Beside(
                "Error of the found open rate, largest",
                context.spread("found", "largest"),
                None,
                "-",
                "At the highest voltages: near the supply's pressure a small error of pressure is a large one of "
                "open rate, and where the true supply is above the declared one the procedure finds an open valve. "
                "It matters little there: so much open rate makes so little pressure.",
            ),
            Beside(
                "Error of the declared open rate, largest",
                context.spread("declared", "largest"),
                None,
                "-",
                "The declared mismatch.",
            ),
            Beside(
                "Step one: closed form against simulation",
                Spread.of([difference]),
                None,
                "-",
                "The paper simulates; in the steady state (5) has a closed form, in which neither areas nor indices "
                "stand.",
            ),
        ),
        tables=(Table(header, tuple(rows), f"Virtual rig of seed {work.seed}"),),
        findings=(),
        figures=_figures(work, curves, simulated) if context.with_figures else (),
        numbers={"closed_form_difference": difference, "seeds": list(context.seeds), "of_seed": list(context.of_seeds)},
    )


def _figures(
    work: SeedWork, curves: list[tuple[SteadyPoints, Floats, Floats]], simulated: Floats
) -> tuple[Figure, ...]:
    color = (MODEL, ESTIMATE)
    smooth = np.linspace(150e3, 705e3, 120)
    closed = steady_open_rate(smooth, work.rig.declared.parameters("locked"))
    first: list[Series] = [
        Line("closed form", closed, smooth / 1e3, SECOND, width=1.7),
        Points("simulated", _SIMULATED, simulated / 1e3, MEASURED),
    ]
    second: list[Series] = []
    third: list[Series] = []
    for valve in (0, 1):
        points, voltage, rate = curves[valve]
        name = f"valve {valve + 1}, found"
        second.append(Points(name, points.voltage, points.pressure / 1e3, color[valve], quiet=True))
        fine = np.linspace(voltage[0], voltage[-1], 200)
        third.append(Line(f"valve {valve + 1}, true", fine, true_rates(work, valve, fine), color[valve], width=1.7))
        third.append(Points(name, voltage, rate, color[valve]))
    p = work.rig.declared.parameters()
    fine = np.linspace(LEVELS[0], LEVELS[-1], 200)
    declared = np.array([flow.open_rate(0, value, p) for value in fine])
    third.append(Line("declared", fine, declared, MEASURED, "dot", width=1.7))
    panels = (
        Panel(Axis("Open rate α [-]"), Axis("Steady P [kPa abs]"), tuple(first), 262),
        Panel(Axis("u [V]"), Axis("Steady P [kPa abs]"), tuple(second), 262),
        Panel(Axis("u [V]"), Axis("κ [-]"), tuple(third), 262),
    )
    about = "From left: step one (model), step two (recording), step three: the curve found and the true one."
    title = f"The three steps to κ(u), virtual rig of seed {work.seed}"
    return (Figure(title, about, panels, "kappa", beside=True),)
