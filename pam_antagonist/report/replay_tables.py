"""The tables of a replay's report, for terminal and page alike. Takes entries of ``report.json``, no arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from pam_antagonist.report.channels import CHANNELS, MODELS, Report, judged, lock_angle, moves
from pam_antagonist.report.document import Tile
from pam_antagonist.report.table import MISSING, Table, number, percent

_NOTHING: frozenset[int] = frozenset()


def tiles(report: Report) -> tuple[Tile, ...]:
    """The few numbers of one recording that matter most."""
    errors = [
        Tile(
            f"{channel.title} error (RMS)",
            channel.write(channel.value(report)),
            f"model alone {channel.write(channel.value(report, 'model_alone'))}",
        )
        for channel in judged(report)
    ]
    honesty = [
        Tile(f"{channel.title} in the 95 % interval", percent(channel.coverage(report)), "95 % or more is honest")
        for channel in judged(report)
    ]
    return (*errors, *honesty)


def errors_table(report: Report, caption: str = "") -> Table:
    """The filter beside the model alone, for one recording.

    Args:
        report: the recording's entry in the report.
        caption: of the table.
    """
    rows: list[tuple[str, str, str]] = []
    best: list[frozenset[int]] = []

    def add(name: str, *values: float, shown: Callable[[float], str] = number) -> None:
        ukf, model = values
        rows.append((name, shown(ukf), shown(model)))
        differ = math.isfinite(ukf) and math.isfinite(model) and shown(ukf) != shown(model)
        best.append(frozenset({1 if ukf < model else 2}) if differ else _NOTHING)

    def group(name: str) -> None:
        rows.append((name, "", ""))
        best.append(_NOTHING)

    for channel in CHANNELS:
        if report["ukf"][channel.name] is None:
            group(f"{channel.title}: not measured")
        elif channel not in judged(report):
            group(f"{channel.title}: locked at {lock_angle(report)}")
        else:
            group(channel.title)
            for name, what in (("RMSE 𝕀", "rmse"), ("largest error 𝕄", "max")):
                both = (channel.value(report, model, what) for model in MODELS)
                add(f"  {name} [{channel.unit}]", *both)
            add("  𝕄 over measured range, ℚ", *(channel.ratio(report, model) for model in MODELS), shown=percent)
            rows.append(("  in the 95 % interval", percent(channel.coverage(report)), MISSING))
            best.append(_NOTHING)
    external = report["ukf"].get("external_torque")
    if external:
        group("Torque from outside")
        rows.append(("  RMSE 𝕀 [N m]", number(external["rmse_nm"]), "given"))
        best.append(_NOTHING)
    group("Pressure")
    for muscle in (0, 1):
        add(
            f"  RMSE 𝕀, muscle {muscle + 1} [kPa]",
            *(report[model]["pressure"]["rmse_pa"][muscle] * 1e-3 for model in MODELS),
        )
    return Table(("", "UKF", "model alone"), tuple(rows), caption, tuple(best))


def overview(reports: Sequence[Report]) -> Table:
    """All recordings beside each other, one row each.

    Args:
        reports: the recordings' entries in the report.
    """
    header = ["Recording", "joint"]
    for channel in CHANNELS:
        header += [f"{channel.name} RMSE [{channel.unit}]", "model alone", "in 95 %"]
    rows = []
    for report in reports:
        row = [report["recording"]["name"], "free" if moves(report) else f"locked at {lock_angle(report)}"]
        for channel in CHANNELS:
            if channel in judged(report):
                row += [
                    number(channel.value(report)),
                    number(channel.value(report, "model_alone")),
                    percent(channel.coverage(report)),
                ]
            else:
                row += [MISSING] * 3
        rows.append(tuple(row))
    caption = (
        "Errors of the filter and of the model alone, and the share of measured values in the filter's 95 % interval"
    )
    return Table(tuple(header), tuple(rows), caption)
