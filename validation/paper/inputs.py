"""The input profile, and which of the 18 subsystems a run of it visits."""

from __future__ import annotations

from typing import Any

import numpy as np

from pam_antagonist.report import figures
from pam_antagonist.report.figure import TIME, Axis, Figure, Line, Panel
from pam_antagonist.report.replay_figures import SUBSYSTEMS
from pam_antagonist.report.style import MEASURED, SECOND
from pam_antagonist.report.table import Table, number, percent
from pam_antagonist.simulation.excitation import PAPER_DURATION
from validation.paper.result import Beside, Context, Result, Spread
from validation.paper.seed_work import SeedWork


def of_seed(work: SeedWork) -> dict[str, Any]:
    """Range of the pressures, and the subsystems that the plant itself is in."""
    sigma = work.truth.subsystem
    return {
        "lowest_kpa": float(work.free.pressure.min()) / 1e3,
        "highest_kpa": float(work.free.pressure.max()) / 1e3,
        "visited": len(np.unique(sigma)),
        "share": [float(np.mean(sigma == k)) for k in range(1, 19)],
    }


def profile_result(context: Context) -> Result:
    """The profile."""
    work = context.work
    figure: tuple[Figure, ...] = ()
    if context.with_figures:
        x = figures.seconds(work.free.stamp_ns, int(work.free.stamp_ns[0]))
        muscles = ((0, MEASURED), (1, SECOND))
        voltages = tuple(Line(f"valve {i + 1}", x, work.voltage[:, i], color) for i, color in muscles)
        pressures = tuple(
            Line(f"P{i + 1}", x, work.free.pressure[:, i] / 1e3, color, quiet=True) for i, color in muscles
        )
        panels = (Panel(TIME, Axis("u [V]"), voltages, 170), Panel(TIME, Axis("P [kPa abs]"), pressures, 190))
        about = "Voltages on the valves, and what pressures they make in the virtual rig with its joint free."
        figure = (Figure("Input profile", about, panels, "profile"),)
    return Result(
        name="profile",
        title="Input profile",
        question="130 s of steps of both valves. The paper shows its own as a picture only; this one is ours.",
        beside=(
            Beside(
                "Length",
                Spread.of([len(work.voltage) * work.rig.declared.sample_period]),
                PAPER_DURATION,
                "s",
                "The same.",
            ),
            Beside(
                "Lowest pressure",
                context.spread("lowest_kpa"),
                200.0,
                "kPa",
                "Set by voltage, so it depends on the rig's valves.",
            ),
            Beside(
                "Highest pressure",
                context.spread("highest_kpa"),
                700.0,
                "kPa",
                "Bounded by the supply: 710 kPa, 2 % off here.",
            ),
        ),
        figures=figure,
        numbers={"seeds": list(context.seeds), "of_seed": list(context.of_seeds)},
    )


def subsystems_result(context: Context) -> Result:
    """The subsystems."""
    work = context.work
    sigma = work.truth.subsystem
    shares = np.array([entry["share"] for entry in context.of_seeds])
    rows = []
    period = work.rig.declared.sample_period
    for k, name in enumerate(SUBSYSTEMS):
        at = np.flatnonzero(sigma == k + 1)
        number_, _, what = name.partition(": ")
        rows.append(
            (
                number_,
                what,
                percent(float(shares[0, k])) if len(at) else "–",
                number(float(at[0] * period), 3) + " s" if len(at) else "never",
                f"{int(np.sum(shares[:, k] > 0.0))} of {len(shares)}",
            )
        )
    figure: tuple[Figure, ...] = ()
    if context.with_figures:
        x = figures.seconds(work.free.stamp_ns, int(work.free.stamp_ns[0]))
        about = "Rows are the subsystems that were active, darker where more of the time was spent."
        panel = figures.strip(SUBSYSTEMS, sigma - 1, x)
        figure = (Figure("Active subsystem over the profile", about, (panel,), "sigma"),)
    missing = [str(k) for k in range(1, 19) if not np.any(sigma == k)]
    return Result(
        name="subsystems",
        title="The 18 subsystems",
        question="Three flow regimes of either muscle, a joint that slides or sticks: which 130 s visit, and when.",
        beside=(
            Beside(
                "Subsystems visited, of 18",
                context.spread("visited"),
                None,
                "-",
                "The paper names 18 and does not say which its run visits.",
            ),
        ),
        tables=(
            Table(
                ("σ", "muscle 1, muscle 2, joint", f"share of seed {work.seed}", "first at", "visited on rigs"),
                tuple(rows),
                "σ = 1 + 6 a + 2 b + c, docs/explanation/model.md",
            ),
        ),
        findings=(
            f"Seed {work.seed} visits all 18."
            if not missing
            else f"Seed {work.seed} does not visit σ = {', '.join(missing)}. "
            "A muscle whose inflow alone is choked is below 192 kPa, the edge of the profile's range.",
        ),
        figures=figure,
        numbers={"seeds": list(context.seeds), "of_seed": list(context.of_seeds)},
    )
