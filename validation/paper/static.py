"""Static characteristics: force against pressure at several lengths, slope and intercept against length (6), (7)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.identification.static_force import fit_force
from pam_antagonist.identification.static_table import ForceMap
from pam_antagonist.report.figure import Axis, Figure, Line, Panel, Points, Series
from pam_antagonist.report.style import ESTIMATE, MEASURED, MODEL, PALETTE
from pam_antagonist.report.table import Table, number
from validation.paper.bench import static_test, true_map
from validation.paper.result import Beside, Context, Result, Spread
from validation.paper.seed_work import SeedWork

Floats = NDArray[np.float64]

_NAMES = {"v1": "p_v1 [m]", "v2": "p_v2 [m²]", "w1": "p_w1 [N/m]", "w2": "p_w2 [N]"}
_AT = ((0.165, 450e3), (0.155, 600e3), (0.175, 300e3))
"""Lengths [m] and pressures [Pa] at which maps are compared: coefficients nearly cancel, forces do not."""


def lines(test: ForceMap) -> tuple[Floats, Floats, Floats]:
    """Equation (6) at each length by itself.

    Args:
        test: a muscle's static test.

    Returns:
        Lengths (G,) [m], slopes v (G,) [m²] and intercepts w (G,) [N].
    """
    found = []
    for group in range(test.lengths):
        inside = test.group == group
        slope, intercept = np.polyfit(test.pressure[inside], test.force[inside], 1)
        found.append((test.length[inside].mean(), slope, intercept))
    length, slope, intercept = np.array(found).T
    return length, slope, intercept


def of_seed(work: SeedWork) -> dict[str, Any]:
    """How far the fitted map is from the muscle's own, in force."""
    out: dict[str, Any] = {}
    for which in (1, 2):
        fit = fit_force(static_test(work, which), "linear", work.rig.declared.geometry.length)
        true, declared = true_map(work, which), getattr(work.rig.declared, f"muscle_{which}").force
        force = np.array([_force(true, *at) for at in _AT])
        named = dict(zip(fit.names, fit.coefficients.tolist(), strict=True))
        out[f"muscle_{which}"] = {
            "fitted_error_n": float(np.max(np.abs([_force(named, *at) for at in _AT] - force))),
            "declared_error_n": float(
                np.max(np.abs([_force({name: getattr(declared, name) for name in _NAMES}, *at) for at in _AT] - force))
            ),
            "residual_rmse_n": fit.fitted_rmse,
        }
    return out


def _force(names: dict[str, float], length: float, pressure: float) -> float:
    return (names["v1"] * length + names["v2"]) * pressure + names["w1"] * length + names["w2"]


def result(context: Context) -> Result:
    """Fits of the first seed's muscles, and how good such fits are over the seeds."""
    work = context.work
    rows, numbers, straight = [], {}, []
    for which in (1, 2):
        test = static_test(work, which)
        fit = fit_force(test, "linear", work.rig.declared.geometry.length)
        true, declared = true_map(work, which), getattr(work.rig.declared, f"muscle_{which}").force
        length, slope, intercept = lines(test)
        straight.append((_determination(length, slope, 1), _determination(length, intercept, 1)))
        for name, value, std in zip(fit.names, fit.coefficients, fit.std, strict=True):
            rows.append(
                (
                    f"muscle {which}, {_NAMES[name]}",
                    f"{number(float(value), 4)} ± {number(float(std), 2)}",
                    number(true[name], 4),
                    number(getattr(declared, name), 4),
                )
            )
            numbers[f"muscle_{which}.{name}"] = {"fitted": float(value), "std": float(std), "true": true[name]}
    errors = {
        key: [max(pair) for pair in zip(*(context.values(f"muscle_{i}", key) for i in (1, 2)), strict=True)]
        for key in ("fitted_error_n", "declared_error_n")
    }
    table = Table(
        ("Coefficient", "fitted", "the virtual rig's own", "Table II (p_w22 with its sign corrected)"),
        tuple(rows),
        f"Equations (6), (7) fitted to the static test of seed {work.seed}",
    )
    return Result(
        name="static",
        title="Static characteristics",
        question=(
            "Force at six lengths and eleven pressures, each length approached from both sides, with hysteresis and "
            "0.5 N of noise: a line at each length (6), then slope and intercept against length (7)."
        ),
        beside=(
            Beside(
                "Force error of the fitted map, largest of three points and both muscles",
                Spread.of(errors["fitted_error_n"]),
                None,
                "N",
                "The paper shows its fit as a picture. Hysteresis (1.5 N to either side) averages out, since both "
                "ways are measured.",
            ),
            Beside(
                "The same of the declared map (Table II)",
                Spread.of(errors["declared_error_n"]),
                None,
                "N",
                "The declared mismatch: a force map is off by 2 % as a whole, about 1 N.",
            ),
        ),
        tables=(table,),
        findings=(
            f"v and w are straight in length, as in the paper (R² of seed {work.seed}: "
            + ", ".join(f"muscle {i + 1} {one:.4f} and {two:.4f}" for i, (one, two) in enumerate(straight))
            + "). This must be so, since the virtual muscle follows (6) and (7). Those of the measured muscle, in the "
            "comparison of force maps below, are not.",
        ),
        figures=_figures(work) if context.with_figures else (),
        numbers={"coefficients": numbers, "seeds": list(context.seeds), "of_seed": list(context.of_seeds)},
    )


def _determination(x: Floats, y: Floats, degree: int) -> float:
    left = y - np.polyval(np.polyfit(x, y, degree), x)
    return 1.0 - float(np.sum(left**2) / np.sum((y - y.mean()) ** 2))


def _figures(work: SeedWork) -> tuple[Figure, ...]:
    out = []
    for which in (1, 2):
        test = static_test(work, which)
        length, slope, intercept = lines(test)
        parts: list[Series] = []
        for group in range(test.lengths):
            inside = test.group == group
            ends = np.array([test.pressure.min(), test.pressure.max()])
            color = PALETTE[group % len(PALETTE)]
            fitted = slope[group] * ends + intercept[group]
            parts.append(Line(f"{1e3 * length[group]:.1f} mm", ends / 1e3, fitted, color, width=1.7))
            parts.append(Points("data", test.pressure[inside] / 1e3, test.force[inside], MEASURED, quiet=True))
        panels = [Panel(Axis("P [kPa abs]"), Axis("F [N]"), tuple(parts), 242)]
        for values, title in ((slope * 1e6, "v [N/MPa]"), (intercept, "w [N]")):
            line = np.asarray(np.polyval(np.polyfit(length, values, 1), length), dtype=np.float64)
            again = len(panels) > 1
            shown = (
                Line("fit (7)", 1e3 * length, line, ESTIMATE, width=1.7, quiet=again),
                Points("of each line", 1e3 * length, values, MODEL, quiet=again),
            )
            panels.append(Panel(Axis("l [mm]"), Axis(title), shown, 242))
        about = "Left: test and line (6) at each length. Middle and right: slope and intercept against length (7)."
        title = f"Static characteristics of muscle {which}, virtual rig of seed {work.seed}"
        out.append(Figure(title, about, tuple(panels), "static", beside=True))
    return tuple(out)
