"""Errors on the held-out part of each recording, with the rig before and after an identification."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, Literal

from pam_antagonist.estimation.errors import ChannelErrors
from pam_antagonist.identification.result import Held
from pam_antagonist.replays.result import ReplayReport
from pam_antagonist.report.channels import ANGLE, CHANNELS, Channel, judged
from pam_antagonist.report.result import picked
from pam_antagonist.report.table import Comparison, Table, percent

COLUMNS = {
    "identified": "UKF, identified rig",
    "as_configured": "UKF, rig file as configured",
    "model_alone": "model alone, from the commands",
    "pressures_alone": "joint driven by the measured pressures",
    "linear": "linear map of the two pressures",
}
"""What gives an angle that is compared on held-out data."""
_TITLES = {"as_configured": "as configured", "identified": "identified", "own": "own values"}


def rigs_of(held: Held) -> list[tuple[str, ReplayReport]]:
    """The compared rigs: title and numbers."""
    return [(title, held.reports[key]) for key, title in _TITLES.items() if key in held.reports]


def errors_of(held: Held) -> dict[str, float]:
    """Errors of a free joint's angle by what gives it, RMS [deg]; empty without any."""
    return {key: held.error(key) for key in COLUMNS if math.isfinite(held.error(key))}


def known(held: Held, channel: Channel, model: Literal["ukf", "model_alone"] = "ukf") -> list[ChannelErrors]:
    """Errors of a channel with each rig; empty if it was not measured, did not move or the joint was locked."""
    if channel is ANGLE and held.identified.joint.condition == "locked":
        return []
    errors = [channel.of(getattr(numbers, model)) for _, numbers in rigs_of(held)]
    found = [item for item in errors if item is not None and math.isfinite(item.ratio)]
    return found if len(found) == len(errors) else []


def entry(held: Held) -> dict[str, Any]:
    """The numbers of a held-out part in ``report.json``."""

    def numbers(rig: str) -> dict[str, Any] | None:
        one = held.reports.get(rig)
        return None if one is None else picked(one, "samples", "duration_s", "ukf", "model_alone", "innovation")

    about = {"name": held.name, "from_s": held.from_s, "joint": held.identified.joint}
    return {**about, **{rig: numbers(rig) for rig in _TITLES}, "errors_deg": errors_of(held)}


def pooled_coverage(every: Iterable[Held], rig: str = "identified") -> float:
    """Mean coverage of a rig's 95 % interval over recordings and channels; NaN without measurements."""
    reports = [held.reports[rig] for held in every if rig in held.reports]
    shares = [item.coverage for report in reports for item in judged(report)]
    return sum(shares) / len(shares) if shares else math.nan


def held_out_table(held: Held) -> Table:
    """Errors on one recording's held-out part, for all compared rigs."""
    titles, figures = zip(*rigs_of(held), strict=True)
    out = Comparison(f"{held.name}, from {held.from_s:.4g} s on", *titles)
    out.heading("Model alone")
    for channel in CHANNELS:
        _rows(out, channel, known(held, channel, "model_alone"))
    for muscle in (0, 1):
        values = [item.model_alone.pressure.rmse_pa[muscle] for item in figures]
        out.pressures(f"  pressure {muscle + 1} RMSE 𝕀", values)
    out.heading("UKF")
    for channel in CHANNELS:
        found = known(held, channel)
        _rows(out, channel, found)
        if found:
            shares = [item.coverage95 for item in found]
            out.values(f"  {channel.name} in the 95 % interval", shares, percent, best=None)
    external = [item.ukf.external_torque for item in figures]
    if all(external):
        out.values("  external torque RMSE 𝕀 [N m]", [None if item is None else item.rmse for item in external])
    out.values("  mean NIS (2 is right)", [item.innovation.nis_mean for item in figures], best=None)
    return out.table()


def _rows(out: Comparison, channel: Channel, found: Sequence[ChannelErrors]) -> None:
    if found:
        out.values(f"  {channel.name} RMSE 𝕀 [{channel.unit}]", [item.rmse for item in found])
        out.values(f"  {channel.name} 𝕄 over range, ℚ", [item.ratio for item in found], percent)
