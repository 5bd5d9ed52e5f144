"""Comparison of force maps by their torque estimates (Table IV), and on a map that was measured on a real muscle."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from pam_antagonist.identification.static_fit import StaticFit, compare_forms, largest, rms
from pam_antagonist.identification.static_table import StaticTable, read_force_map
from pam_antagonist.identification.tobit import Undetermined
from pam_antagonist.report.figure import Axis, Figure, Line, Panel, Points, Series
from pam_antagonist.report.style import MEASURED, PALETTE, QUIET
from pam_antagonist.report.table import MISSING, Table, number
from validation.paper.bench import static_fits, with_fits
from validation.paper.comparison import (
    COMPARED_S,
    Model,
    comparison_figure,
    comparison_table,
    ranked,
)
from validation.paper.offline import consistency
from validation.paper.result import Beside, Context, Result
from validation.paper.seed_work import TUNINGS, SeedWork, filtered, judged

MODELS = (
    Model("linear", "Equation (6)", (0.0899, 0.299, 0.0601)),
    Model("hildebrandt", "Polynomial model 1 (Hildebrandt 2005)", (0.422, 0.687, 0.135)),
    Model("sarosi", "Polynomial model 2 (Sárosi 2010)", (0.323, 0.544, 0.106)),
    Model("polynomial", "Polynomial model 3 (2012)", (0.550, 0.985, 0.193)),
)
_FORMS = tuple(model.name for model in MODELS)
_REAL_ATMOSPHERE = 101_325.0


_UNKNOWN = ("rmse", "largest", "ratio", "coverage", "pressure_1", "pressure_2", "nis_mean", "nis_in_95")
_NOTHING = {
    "static": {"fitted": math.nan, "left_out": math.nan},
    **{tuning: dict.fromkeys(_UNKNOWN, math.nan) for tuning in TUNINGS},
}


def of_seed(work: SeedWork) -> dict[str, Any]:
    """Errors of each force map, fitted to the static test of the rig, with both tunings."""
    rig = work.rig.declared
    samples = round(COMPARED_S / rig.sample_period)
    out: dict[str, Any] = {}
    for form in _FORMS:
        try:
            fits = static_fits(work, form)
        except Undetermined:
            # A straight map leaves the exponent of a curved form free.
            out[form] = _NOTHING
            continue
        model = with_fits(rig, form, fits)
        out[form] = {"static": {"fitted": _mean(fits, "fitted_rmse"), "left_out": _mean(fits, "left_out_rmse")}}
        for tuning in TUNINGS:
            track = filtered(model, work.locked, tuning, "locked", samples)
            errors = judged(track, work.locked, rig, "torque")
            out[form][tuning] = {**dataclasses.asdict(errors), **consistency(track, work.locked)}
    return out


def _mean(fits: tuple[StaticFit, StaticFit], name: str) -> float:
    return 0.5 * (getattr(fits[0], name) + getattr(fits[1], name))


def result(context: Context) -> Result:
    """Put the seeds together."""
    real = None if context.force_map is None else read_force_map(context.force_map, _REAL_ATMOSPHERE)
    fits = {} if real is None else _real_fits(real)
    tables = [comparison_table(context, MODELS, tuning, "N m") for tuning in TUNINGS]
    tables.append(_static_table(context))
    figures: list[Figure] = [comparison_figure(context, MODELS, "torque")] if context.with_figures else []
    if real is not None:
        tables.append(_real_table(fits))
        if context.with_figures:
            figures += [_real_figure(real, fits), _left_out_figure(fits)]
    return Result(
        name="compare_torque",
        title="Comparison of force maps: torque",
        question=(
            f"The first {COMPARED_S:g} s of the profile with the joint locked at 0°. Each of the four forms of the "
            "contraction force is fitted to the same static test of the virtual rig's muscles (6 lengths, 11 "
            "pressures, both ways, 0.5 N noise). Each then runs in the same filter. Below, the same four are fitted "
            "to the measured force map of a real muscle."
        ),
        beside=_beside(context),
        tables=tuple(tables),
        findings=(*_findings(context), *_real_findings(real, fits)),
        figures=tuple(figures),
        numbers={
            "seeds": list(context.seeds),
            "of_seed": list(context.of_seeds),
            "real_map": None if real is None else _real_numbers(real, fits),
        },
    )


def _beside(context: Context) -> tuple[Beside, ...]:
    rows = []
    for model in MODELS:
        assert model.paper is not None
        why = (
            "Fitted to the rig's own static test, so little but the sensors' noise is left."
            if model.name == "linear"
            else "Fitted to the same data as equation (6), which makes it a comparison of forms; the paper does not "
            "say to what its coefficients were fitted."
        )
        rows.append(
            Beside(
                f"{model.label}, ℚ, tuning published",
                context.spread(model.name, "published", "ratio"),
                model.paper[2],
                "%",
                why,
            )
        )
    return tuple(rows)


def _findings(context: Context) -> tuple[str, ...]:
    order = tuple(ranked(context, MODELS, tuning, "ratio") for tuning in TUNINGS)
    medians = {model.name: context.spread(model.name, "default", "rmse").median for model in MODELS}
    wide = max(medians.values()) / min(medians.values())
    known = {model.name: context.spread(model.name, "default", "rmse").count for model in MODELS}
    undetermined = [
        f"{model.label} on {len(context.seeds) - known[model.name]} of {len(context.seeds)} rigs"
        for model in MODELS
        if known[model.name] < len(context.seeds)
    ]
    return (
        *order,
        *(
            [
                f"Left out where the static test does not determine the coefficients: {', '.join(undetermined)}. A map "
                "that is straight in length leaves an exponent free."
            ]
            if undetermined
            else []
        ),
        f"All four have about the same error (largest over least median 𝕀: {number(wide)}). Two of the other forms "
        "contain equation (6): with c3 = c6 = c7 = 0 Hildebrandt's is linear in pressure and length, with c4 = c6 = 0 "
        "the 2012 polynomial is. The virtual rig's muscles follow (6), so a fit to the same data finds (6) in each, "
        "and only noise is left. In the paper their ℚ is 1.8 to 3.2 times that of (6). This comes from the "
        "coefficients or from the data of their fit, which the paper does not give, and not from the forms.",
        "A simulated muscle that follows (6) cannot tell which form real muscles follow; the measured map below can.",
    )


def _static_table(context: Context) -> Table:
    rows = tuple(
        (
            model.label,
            context.spread(model.name, "static", "fitted").text(),
            context.spread(model.name, "static", "left_out").text(),
        )
        for model in MODELS
    )
    caption = "Static test of the virtual rig: RMSE over both muscles; right, at lengths that the fit had not seen"
    return Table(("Force map", "of the data it was fitted to [N]", "leave one length out [N]"), rows, caption)


# ------------------------------------------------------------------ the real map


def _real_fits(real: StaticTable) -> dict[str, StaticFit | str]:
    """Every form, or why the map does not determine it."""
    # Any L_0 gives the same fit: each form holds all shifts of the contraction.
    fits = compare_forms(real, float(np.max(real.length)), _FORMS)
    return {form: fit if isinstance(fit, StaticFit) else str(fit) for form, fit in fits.items()}


def _labels() -> Mapping[str, str]:
    return {model.name: model.label for model in MODELS}


def _real_table(fits: Mapping[str, StaticFit | str]) -> Table:
    known = {form: fit.left_out_rmse for form, fit in fits.items() if isinstance(fit, StaticFit)}
    rows: list[tuple[str, ...]] = []
    best: list[frozenset[int]] = []
    for form, fit in fits.items():
        if not isinstance(fit, StaticFit):
            rows.append((_labels()[form], MISSING, fit, MISSING, MISSING))
            best.append(frozenset[int]())
            continue
        cells = (fit.fitted_rmse, fit.left_out_rmse, largest(fit.left_out_errors), fit.overshoot)
        rows.append((f"{_labels()[form]}, {len(fit.names)} coefficients", *(number(value) for value in cells)))
        best.append(frozenset({2}) if known[form] == min(known.values()) else frozenset[int]())
    caption = (
        "Real muscle (Festo DMSP-20-300N, measured): errors [N]; points without force count as known to be below 0 "
        "only (censored)"
    )
    header = ("Force map", "RMSE, fitted", "RMSE, leave one length out", "largest there", "force where there was none")
    return Table(header, tuple(rows), caption, tuple(best))


def _real_findings(real: StaticTable | None, fits: Mapping[str, StaticFit | str]) -> tuple[str, ...]:
    if real is None:
        return ("No real force map was given (--force-map), so that part is left out.",)
    known = {form: fit for form, fit in fits.items() if isinstance(fit, StaticFit)}
    order = sorted(known, key=lambda form: known[form].left_out_rmse)
    span = float(np.max(real.value))
    errors = ", ".join(f"{_labels()[form]} {number(known[form].left_out_rmse)} N" for form in order)
    best = _labels()[order[0]]
    return (
        f"Real muscle, at lengths that were left out: {errors}, of forces up to {number(span)} N "
        f"({int(real.slack.sum())} of {len(real)} points are censored). The best is {best}"
        + (
            ", as in the paper."
            if order[0] == "linear"
            else ", not equation (6) as in the paper: over this muscle's whole"
        )
        + (
            ""
            if order[0] == "linear"
            else " range of lengths force is not linear in length, and a plane cannot follow it."
        ),
    )


def _real_numbers(real: StaticTable, fits: Mapping[str, StaticFit | str]) -> dict[str, Any]:
    out: dict[str, Any] = {"sha256": real.sha256, "points": len(real), "censored": int(real.slack.sum())}
    for form, fit in fits.items():
        if not isinstance(fit, StaticFit):
            out[form] = {"undetermined": fit}
            continue
        out[form] = {
            "coefficients": dict(zip(fit.names, fit.coefficients.tolist(), strict=True)),
            "fitted_rmse_n": fit.fitted_rmse,
            "left_out_rmse_n": fit.left_out_rmse,
            "left_out_largest_n": largest(fit.left_out_errors),
            "overshoot_n": fit.overshoot,
            "left_out": [
                {"length_m": item.length, "measured": item.measured, "slack": item.slack, "rmse_n": rms(item.errors)}
                for item in fit.left_out
            ],
        }
    return out


def _real_figure(real: StaticTable, fits: Mapping[str, StaticFit | str]) -> Figure:
    panels: list[Panel] = []
    for form, fit in fits.items():
        if not isinstance(fit, StaticFit):
            continue
        parts: list[Series] = []
        for group in range(real.lengths):
            inside = (real.group == group) & ~real.slack
            if not inside.any():
                continue
            length = float(real.length[real.group == group].mean())
            color = PALETTE[group % len(PALETTE)]
            quiet = bool(panels)
            pressure = np.linspace(real.pressure.min(), real.pressure.max(), 40)
            name = f"{1e3 * length:.0f} mm"
            fitted = np.maximum(fit.value(np.full(40, length), pressure), 0.0)
            parts.append(Line(name, pressure / 1e3, fitted, color, width=1.7, quiet=quiet))
            parts.append(Points(name, real.pressure[inside] / 1e3, real.value[inside], color, quiet=True))
        panels.append(Panel(Axis("P [kPa abs]"), Axis(f"F [N], {form}"), tuple(parts), 242))
    about = "Points: measured. Lines: the form fitted to all of them, cut off at 0 N."
    return Figure("A real muscle's force map and the four forms", about, tuple(panels), "real map", beside=True)


def _left_out_figure(fits: Mapping[str, StaticFit | str]) -> Figure:
    parts: list[Series] = []
    colors = (MEASURED, *PALETTE[:2], QUIET)
    for k, (form, fit) in enumerate(fits.items()):
        if isinstance(fit, StaticFit):
            length = np.array([item.length for item in fit.left_out if np.isfinite(rms(item.errors))])
            rmse = np.array([rms(item.errors) for item in fit.left_out if np.isfinite(rms(item.errors))])
            parts.append(Line(_labels()[form], 1e3 * length, rmse, colors[k], width=1.7))
            parts.append(Points(_labels()[form], 1e3 * length, rmse, colors[k], quiet=True))
    about = "Each length predicted from the others; the two ends are extrapolation."
    panel = Panel(Axis("Length that was left out [mm]"), Axis("RMSE there [N]"), tuple(parts), 222)
    return Figure("Error at a length that the fit had not seen", about, (panel,), "real map left out")
