"""Errors on the held-out part of each recording, with the rig before and after an identification."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from numpy.lib.recfunctions import repack_fields

from pam_antagonist.estimation.errors import ChannelErrors, FilterErrors, ModelErrors
from pam_antagonist.recording import Recording
from pam_antagonist.recording.joint import JointCondition
from pam_antagonist.replays import Replay, after, replay
from pam_antagonist.replays.result import Innovation, JointFacts, ReplayReport
from pam_antagonist.report.channels import ANGLE, CHANNELS, Channel
from pam_antagonist.report.channels import judged as judged_channels
from pam_antagonist.report.table import Comparison, Table, percent
from pam_antagonist.rig import Rig

Given = tuple[Recording, JointCondition, str]
"""A recording, its joint condition, and its name."""


@dataclass(frozen=True, eq=False)
class Judged:
    """One recording, replayed with two or three rigs.

    Attributes:
        from_s: begin of the held-out part [s].
        whole: name of the rig -> replay of the whole recording; ``own`` only with several recordings. To save memory,
            only the identified rig's replay is complete; the others keep only angle and torque.
        errors_deg: of a free joint's angle, by what gives it, RMS [deg].
    """

    name: str
    from_s: float
    whole: Mapping[str, Replay]
    reports: Mapping[str, ReplayReport]
    errors_deg: Mapping[str, float] = field(default_factory=dict)


def judge(
    recordings: Sequence[Given],
    rigs: Sequence[Mapping[str, Rig]],
    held_from: Sequence[float],
    progress: Callable[[str], None] | None = None,
) -> list[Judged]:
    """Replay every recording from its start, and compute errors on the held-out parts.

    Args:
        held_from: for each recording, the begin of its held-out part [s].
    """
    out = []
    for (recording, state, name), compared, begin in zip(recordings, rigs, held_from, strict=True):
        if progress:
            progress(f"held-out part of {name}")
        angle = state.lock_angle if state.condition == "locked" else None
        whole, held = {}, {}
        for key, rig in compared.items():
            item = replay(recording, rig, "default", state.condition, angle)
            held[key] = after(item, begin).report
            whole[key] = item if key == "identified" else _lean(item)
        out.append(Judged(name, begin, whole, held))
    return out


def _lean(item: Replay) -> Replay:
    """A copy of a replay that keeps only angle and torque of the estimates."""
    rows = repack_fields(item.run.rows[["angle", "torque"]])
    return replace(item, run=replace(item.run, rows=rows, added={}))


@dataclass(frozen=True)
class HeldOutFigures:
    """Numbers of the held-out part with one rig.

    Attributes:
        duration_s: of the part [s].
    """

    samples: int
    duration_s: float
    ukf: FilterErrors
    model_alone: ModelErrors
    innovation: Innovation

    @classmethod
    def of(cls, report: ReplayReport) -> HeldOutFigures:
        """The numbers of a replay's report."""
        return cls(report.samples, report.duration_s, report.ukf, report.model_alone, report.innovation)


@dataclass(frozen=True)
class HeldOut:
    """Numbers of one recording's held-out part, for all compared rigs.

    Attributes:
        from_s: begin of the part [s].
        own: with the recording's own values; None for a single recording.
        errors_deg: of a free joint's angle, by what gives it, RMS [deg].
    """

    name: str
    from_s: float
    joint: JointFacts
    as_configured: HeldOutFigures
    identified: HeldOutFigures
    own: HeldOutFigures | None
    errors_deg: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, item: Judged) -> HeldOut:
        """The entry of a recording."""
        own = item.reports.get("own")
        return cls(
            item.name,
            item.from_s,
            item.reports["identified"].joint,
            HeldOutFigures.of(item.reports["as_configured"]),
            HeldOutFigures.of(item.reports["identified"]),
            None if own is None else HeldOutFigures.of(own),
            item.errors_deg,
        )

    @property
    def rigs(self) -> list[tuple[str, HeldOutFigures]]:
        """The compared rigs: title and numbers."""
        both = [("as configured", self.as_configured), ("identified", self.identified)]
        return both if self.own is None else [*both, ("own values", self.own)]

    def known(self, channel: Channel, model: Literal["ukf", "model_alone"] = "ukf") -> list[ChannelErrors]:
        """Errors of a channel with each rig; empty if it was not measured, did not move or the joint was locked."""
        if channel is ANGLE and self.joint.condition == "locked":
            return []
        errors = [channel.of(getattr(figures, model)) for _, figures in self.rigs]
        known = [item for item in errors if item is not None and math.isfinite(item.ratio)]
        return known if len(known) == len(errors) else []


def pooled_coverage(judged: Sequence[Judged], rig: str = "identified") -> float:
    """Mean coverage of a rig's 95 % interval over recordings and channels; NaN without measurements.

    Args:
        judged: of :func:`judge`.
        rig: ``identified``, or ``own`` for each recording's own values.
    """
    reports = [item.reports[rig] for item in judged if rig in item.reports]
    shares = [item.coverage for report in reports for item in judged_channels(report)]
    return sum(shares) / len(shares) if shares else math.nan


def held_out_table(entry: HeldOut) -> Table:
    """Errors on one recording's held-out part, for all compared rigs."""
    out = Comparison(f"{entry.name}, from {entry.from_s:.4g} s on", *(title for title, _ in entry.rigs))
    figures = [item for _, item in entry.rigs]
    out.heading("Model alone")
    for channel in CHANNELS:
        _rows(out, channel, entry.known(channel, "model_alone"))
    for muscle in (0, 1):
        values = [item.model_alone.pressure.rmse_pa[muscle] for item in figures]
        out.pressures(f"  pressure {muscle + 1} RMSE 𝕀", values)
    out.heading("UKF")
    for channel in CHANNELS:
        known = entry.known(channel)
        _rows(out, channel, known)
        if known:
            shares = [item.coverage95 for item in known]
            out.values(f"  {channel.name} in the 95 % interval", shares, percent, best=None)
    external = [item.ukf.external_torque for item in figures]
    if all(external):
        out.values("  external torque RMSE 𝕀 [N m]", [None if item is None else item.rmse for item in external])
    out.values("  mean NIS (2 is right)", [item.innovation.nis_mean for item in figures], best=None)
    return out.table()


def _rows(out: Comparison, channel: Channel, known: Sequence[ChannelErrors]) -> None:
    if known:
        out.values(f"  {channel.name} RMSE 𝕀 [{channel.unit}]", [item.rmse for item in known])
        out.values(f"  {channel.name} 𝕄 over range, ℚ", [item.ratio for item in known], percent)
