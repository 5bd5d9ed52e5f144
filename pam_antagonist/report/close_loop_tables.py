"""Tables of ``close_loop``, for terminal and page alike. Takes ``report.json``, no arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from pam_antagonist.report import close_loop_sealed
from pam_antagonist.report.table import MISSING, Table, number, percent

Document = Mapping[str, Any]
_MODELS = ("as_configured", "recalibrated", "extended")


def before_after(document: Document) -> Table:
    """Errors of the three models on held-out data, the model alone and then the estimator."""
    rows: list[tuple[str, ...]] = []
    best: list[frozenset[int]] = []

    def add(name: str, values: list[float | None]) -> None:
        rows.append((name, *(number(value) for value in values)))
        known = [(value, k + 1) for k, value in enumerate(values) if value is not None and math.isfinite(value)]
        differ = len({number(value) for value, _ in known}) > 1
        best.append(frozenset({min(known)[1]}) if differ else frozenset())

    def group(name: str) -> None:
        rows.append((name, "", "", ""))
        best.append(frozenset())

    if close_loop_sealed.is_driven(document):
        for name, values in close_loop_sealed.rows(document):
            group(name) if values is None else add(name, values)
        return _compared(rows, best)
    errors = document["errors"]
    group("Model alone, from the voltages only")
    for channel, key, unit in (("angle", "deg", "°"), ("torque", "nm", "N m")):
        if errors["extended"][channel] is None:
            rows.append((f"  {channel}", "not measured", MISSING, MISSING))
            best.append(frozenset())
            continue
        add(f"  {channel} RMSE [{unit}]", [errors[model][channel][f"rmse_{key}"] for model in _MODELS])
        add(f"  {channel} largest [{unit}]", [errors[model][channel][f"max_{key}"] for model in _MODELS])
    for muscle in (0, 1):
        add(
            f"  pressure {muscle + 1} RMSE [kPa]",
            [errors[model]["pressure"]["rmse_pa"][muscle] / 1e3 for model in _MODELS],
        )
    for part in document["recordings"]:
        if "ukf" not in part or part["errors"] is None:
            continue
        group(f"Estimator from pressures alone, {part['recording']}")
        for channel, key, unit in (("angle", "deg", "°"), ("torque", "nm", "N m")):
            if part["errors"]["extended"][channel] is not None:
                add(f"  {channel} RMSE [{unit}]", [part["ukf"][m][channel][f"rmse_{key}"] for m in _MODELS])
    return _compared(rows, best)


def _compared(rows: list[tuple[str, ...]], best: list[frozenset[int]]) -> Table:
    return Table(("", "as configured", "recalibrated", "extended"), tuple(rows), "Errors on held-out data", tuple(best))


def ranking(document: Document) -> Table:
    """All candidates of all rounds."""
    rows = []
    for item in document["ranking"]:
        if item["round"] > 1 and item["delta_bic"] is None:
            continue
        refitted = item["delta_bic"] is not None
        rows.append(
            (
                item["name"] + (" (taken)" if item["taken"] else ""),
                str(item["round"]),
                f"{item['score']:.1f}",
                " · ".join(f"{value:.1f}" for value in item["score_by_muscle"] or ()) or MISSING,
                f"{item['delta_bic']:.1f}" if refitted else MISSING,
                percent(item["holdout_gain"]) if refitted else MISSING,
            )
        )
    header = ("Candidate", "round", "score", "muscle 1 · 2 alone", "ΔBIC", "held-out share")
    caption = (
        "Score: evidence to first order, on both muscles and on each alone; ΔBIC: after a refit in full simulation, "
        "where the score was worth one"
    )
    return Table(header, tuple(rows), caption)


def parameters(document: Document) -> Table:
    """The found effects' parameters."""
    rows = []
    for effect in document["effects"]:
        muscle = f", muscle {effect['muscle']}" if effect["muscle"] else ""
        for name, item in effect["parameters"].items():
            rows.append(
                (f"{effect['name']}{muscle}: {name} [{item['unit']}]", number(item["value"]), number(item["std"], 2))
            )
    return Table(("Parameter", "value", "std. error"), tuple(rows), "What was found")
