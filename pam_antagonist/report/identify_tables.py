"""The tables of an identification's report, for terminal and page alike. They take the content of ``report.json``."""

from __future__ import annotations

import math
from typing import Any

from pam_antagonist.report.channels import CHANNELS
from pam_antagonist.report.table import MISSING, Table, number, percent

Document = dict[str, Any]

RIGS = (("as_configured", "as configured"), ("identified", "identified"), ("own", "own values"))
"""Rigs that are compared, with their column titles."""
_SIGNED = "{:+.2f} %"


def change(value: float | None) -> str:
    """A relative change in per cent, with its sign."""
    return MISSING if value is None or not math.isfinite(value) else _SIGNED.format(100.0 * value)


def held_out(entry: Document, caption: str = "") -> Table:
    """One recording's held-out part by the rig as configured and as identified.

    Args:
        entry: of ``held_out``.
        caption: of the table.
    """
    rigs = [(key, title) for key, title in RIGS if entry[key] is not None]
    rows: list[tuple[str, ...]] = []
    best: list[frozenset[int]] = []

    def add(name: str, values: list[float], write: Any = number, smaller: bool = True) -> None:
        rows.append((name, *(write(value) for value in values)))
        finite = [value for value in values if math.isfinite(value)]
        least = min(finite) if finite and smaller else math.nan
        winners = {k + 1 for k, value in enumerate(values) if value == least}
        best.append(frozenset(winners) if len(winners) < len(values) else frozenset())

    def group(name: str) -> None:
        rows.append((name, *[""] * len(rigs)))
        best.append(frozenset())

    for model, title in (("model_alone", "Model alone"), ("ukf", "UKF")):
        group(title)
        for channel in CHANNELS:
            figures = [entry[key][model][channel.name] for key, _ in rigs]
            if channel.name == "angle" and entry["joint"]["condition"] == "locked":
                continue
            if any(item is None for item in figures) or any(
                not math.isfinite(item["q"] or math.nan) for item in figures
            ):
                continue
            add(f"  {channel.name} RMSE 𝕀 [{channel.unit}]", [item[f"rmse_{channel.key}"] for item in figures])
            add(f"  {channel.name} 𝕄 over range, ℚ", [item["q"] for item in figures], percent)
            if model == "ukf":
                add(f"  {channel.name} in the 95 % interval", [item["coverage95"] for item in figures], percent, False)
        for muscle in (0, 1) if model == "model_alone" else ():
            values = [entry[key][model]["pressure"]["rmse_pa"][muscle] * 1e-3 for key, _ in rigs]
            add(f"  pressure {muscle + 1} RMSE 𝕀 [kPa]", values)
    add("  mean NIS (2 is right)", [entry[key]["innovation"]["nis_mean"] for key, _ in rigs], number, False)
    header = (f"{entry['name']}, from {entry['from_s']:.0f} s on", *(title for _, title in rigs))
    return Table(header, tuple(rows), caption, tuple(best))


def parameters(document: Document, caption: str = "") -> Table:
    """What became of each parameter.

    Args:
        document: of ``report.json``.
        caption: of the table.
    """
    rows = []
    for item in document["parameters"]:
        scale = abs(item["start"]) or math.nan
        rows.append(
            (
                item["name"],
                number(item["start"], 4),
                number(item["value"], 5),
                number(item["std"], 2),
                change(item["relative_change"]),
                change(1.96 * item["std"] / scale).lstrip("+"),
                "yes" if item["determined"] else "no: stays near its prior",
            )
        )
    header = ("Parameter", "configured", "identified", "std error", "change", "± 95 %", "determined")
    return Table(header, tuple(rows), caption)


def differences(document: Document, caption: str = "") -> Table | None:
    """How the recordings deviate from each other; None where there is one only.

    Args:
        document: of ``report.json``.
        caption: of the table.
    """
    between = document["between"]
    if between is None:
        return None
    names = [item["name"] for item in document["held_out"]]
    rows = [
        (
            item["name"],
            *(change(value) for value in item["deviations"]),
            change(item["largest"]).lstrip("+"),
            change(1.96 * item["std"]).lstrip("+"),
            "yes" if item["certain"] else "no",
        )
        for item in between["differences"]
    ]
    return Table(("Direction", *names, "difference", "± 95 %", "certain"), tuple(rows), caption)


def correlated(document: Document, caption: str = "") -> Table | None:
    """Pairs of parameters that the data hardly tell apart; None where there are none.

    Args:
        document: of ``report.json``.
        caption: of the table.
    """
    pairs = document["correlations"]
    if not pairs:
        return None
    rows = tuple((p["first"], p["second"], f"{p['correlation']:+.3f}") for p in pairs)
    return Table(("Parameter", "with", "correlation"), rows, caption)


def stage_values(stage: Document, caption: str = "") -> Table | None:
    """What one step moved; None where it moved nothing.

    Args:
        stage: an entry of ``stages``.
        caption: of the table.
    """
    if not stage["values"]:
        return None
    rows = []
    for name, item in stage["values"].items():
        old, new = item["before"], item["after"]
        relative = (new - old) / abs(old) if old else math.nan
        rows.append((name, number(old, 4), number(new, 5), change(relative)))
    return Table(("Parameter", "before", "after", "change"), tuple(rows), caption)


def stage_residuals(stage: Document, caption: str = "") -> Table:
    """Residuals of the simulated model before and after one step.

    Args:
        stage: an entry of ``stages``.
        caption: of the table.
    """
    units = (("angle", "angle [°]", math.degrees(1.0)), ("torque", "torque [N m]", 1.0),
             ("pressure_1", "pressure 1 [kPa]", 1e-3), ("pressure_2", "pressure 2 [kPa]", 1e-3))  # fmt: skip
    rows = []
    for key, title, scale in units:
        values = [stage[when][key] for when in ("before", "after")]
        if all(value is not None for value in values):
            rows.append((title, *(number(value * scale) for value in values)))
    if stage["balance_nm"] is not None:
        both = stage["balance_nm"]
        rows.append(("torque at measured pressures [N m]", number(both["before"]), number(both["after"])))
    return Table(("RMS residual", "before", "after"), tuple(rows), caption)


def noise(document: Document, caption: str = "") -> Table:
    """Sensor noise, Q and R before and after.

    Args:
        document: of ``report.json``.
        caption: of the table.
    """
    declared, found, tuning = document["noise"]["declared"], document["noise"]["found"], document["tuning"]
    rows = [
        ("pressure sensor [Pa]", number(declared["pressure_std"]), number(found["pressure_std"])),
        ("encoder [°]", *(number(math.degrees(item["angle_std"])) for item in (declared, found))),
        (
            "encoder, step of its converter [°]",
            *(number(math.degrees(item["angle_step"])) for item in (declared, found)),
        ),
        ("torque meter [N m]", *(number(item["torque_std"]) for item in (declared, found))),
        ("torque meter, step [N m]", *(number(item["torque_step"]) for item in (declared, found))),
    ]
    for k, name in enumerate(("angle [rad²]", "velocity [rad²/s²]", "pressure 1 [Pa²]", "pressure 2 [Pa²]")):
        rows.append((f"Q a step, {name}", number(tuning["process_before"][k], 2), number(tuning["process"][k], 2)))
    for k in (0, 1):
        values = (number(tuning[key][k]) for key in ("measurement_before", "measurement"))
        rows.append((f"R, pressure {k + 1} [Pa²]", *values))
    like = tuning["log_likelihood_a_sample"]
    rows.append(("log-likelihood of the innovations a sample", number(like["before"], 5), number(like["after"], 5)))
    return Table(("", "configured", "identified"), tuple(rows), caption)
