"""Numbers of an identification's ``report.json``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pam_antagonist.identification.joint_stage import DELAY, ZERO
from pam_antagonist.identification.result import FromPressures
from pam_antagonist.identification.unknowns import Fit, Unknown
from pam_antagonist.recording.joint import JointCondition
from pam_antagonist.replays.result import JointFacts, ReplayReport
from pam_antagonist.report.assumption import assumption
from pam_antagonist.report.held_out import Given, HeldOut, Judged, pooled_coverage
from pam_antagonist.report.identify_entries import (
    Between,
    DifferenceEntry,
    IdentifyReport,
    Noise,
    Pair,
    ParameterEntry,
    RecordingEntry,
    SensorNoise,
    Settings,
    StageEntry,
    TuningEntry,
)
from pam_antagonist.report.identify_findings import rejection
from pam_antagonist.report.units import unit_of
from pam_antagonist.rig import Rig
from pam_antagonist.software import versions

COLUMNS = ("identified", "as_configured", "model_alone", "pressures_alone", "linear")
"""What gives an angle that is compared on held-out data."""
STRONG = 0.9
"""Least correlation of two parameters that are listed as a pair."""
_PAIRS = 12
_CERTAIN = 2.0
"""A difference is significant from so many standard errors on."""
_WHAT_SHOWS = (
    ("joint.inertia", "a free joint that is made to move fast: large voltage steps in opposite directions"),
    ("joint.viscous_friction", "a free joint that moves fast for long: alternate the valves' extremes every 0.3 s"),
    ("friction", "a free joint with a measured angle that comes to rest at many angles and pressures"),
    (".force.", "a free joint over its whole angle range, at low and at high pressures, with torque or angle measured"),
    ("limb:", "a free joint over its whole angle range, at low and at high pressures"),
    ("inflow_area", "fast fillings of this muscle from low pressure: steps of its valve to the highest voltage"),
    ("outflow_area", "fast emptyings of this muscle from high pressure: steps of its valve to the lowest voltage"),
    (
        "gas.polytropic_flow",
        "a separate measurement of the chambers' volume or of the orifice areas: a recording shows only both together",
    ),
    ("gas.polytropic_volume", "a free joint that moves while the valves are still, so that only the volume changes"),
    (".volume.", "the volume of the muscle by length in a graduated cylinder (a static CSV)"),
    ("supply.pressure", "a steady pressure with the valve fully open, or a gauge on the tank"),
    ("effects.regulator_", "steps of both commanded pressures of different sizes, a locked joint's as well"),
    ("effects.", "longer recordings in which the effect is at work"),
)
_UNITS = {ZERO: "rad", DELAY: "s"}


def judged_of(found: FromPressures) -> list[Judged]:
    """The recordings of an identification with errors on their held-out parts."""
    return [
        Judged(item.name, item.from_s, item.replays, item.reports,
               {key: item.error(key) for key in COLUMNS if math.isfinite(item.error(key))})
        for item in found.held
    ]  # fmt: skip


def report(recordings: Sequence[Given], found: FromPressures, refused: str = "") -> IdentifyReport:
    """The numbers of an identification.

    Args:
        refused: why the file of the identified rig would be refused; empty if it would not.
    """
    judged, asked = judged_of(found), found.options
    now, before = found.rig.tuning("default"), found.start.tuning("default")
    whole = {item.name: item.whole["identified"].report for item in judged}
    numbers = IdentifyReport(
        held_out=tuple(HeldOut.of(item) for item in judged),
        coverage95=pooled_coverage(judged),
        coverage95_own=pooled_coverage(judged, "own"),
        errors_deg={key: found.pooled(key) for key in COLUMNS if math.isfinite(found.pooled(key))},
        parameters=tuple(entry for fit in found.fits for entry in _parameters(found.start, fit)),
        stages=tuple(StageEntry.of(step) for step in found.steps),
        correlations=tuple(pair for fit in found.fits for pair in _correlations(fit)),
        between=_between(found),
        noise=Noise(SensorNoise.of(found.start), SensorNoise.of(found.rig)),
        tuning=TuningEntry(
            tuple(now.process), tuple(before.process), tuple(now.measurement), tuple(before.measurement),
            found.covered.torque, found.rig.directions,
        ),
        recordings=tuple(_recording(whole[name], name, state, end) for (_, state, name), (_, end)
                         in zip(recordings, _ends(recordings, found), strict=True) if name in whole),
        warnings=found.notes,
        settings=Settings(found.start.name, asked.free, asked.frozen, asked.holdout, asked.starts, asked.seed),
        software=versions(),
        assumption=assumption(found.start, identified=True),
    )  # fmt: skip
    declared = rejection(numbers.held_out, refused, numbers.parameters, found.start.bounds)
    return replace(numbers, rejected=found.rejected or declared)


def _ends(recordings: Sequence[Given], found: FromPressures) -> list[tuple[str, float]]:
    known = dict(found.fitted)
    return [(name, min(known.get(name, 0.0), recording.duration_s)) for recording, _, name in recordings]


def unit_of_unknown(rig: Rig, item: Unknown) -> str:
    """SI unit of an unknown."""
    path = next(iter((*item.paths, *item.adds)), "")
    return unit_of(rig, path) if path else _UNITS.get(item.name, "N m")


def _parameters(rig: Rig, fit: Fit) -> list[ParameterEntry]:
    stds, reasons, out = fit.stds, fit.reasons, []
    for item, amount in zip(fit.unknowns, fit.amounts, strict=True):
        value = item.value(float(amount))
        if not item.recording:
            reason = reasons[item.name]
            out.append(
                ParameterEntry(
                    item.name, item.start, value, stds[item.name],
                    (value - item.start) / abs(item.start) if item.start else math.nan,
                    item.std * abs(item.start) if item.positive else item.std,
                    value if item.name in fit.at_bounds else None, not reason, reason,
                    recording_that_shows(item.name) if reason else None, unit_of_unknown(rig, item),
                )
            )  # fmt: skip
    return out


def recording_that_shows(name: str) -> str:
    """What to record so that a value shows."""
    return next((text for part, text in _WHAT_SHOWS if part in name), "a longer recording with larger steps")


def _correlations(fit: Fit) -> list[Pair]:
    """Pairs of strongly correlated parameters, the strongest first."""
    common = [k for k, item in enumerate(fit.unknowns) if not item.recording]
    stds = np.sqrt(np.diag(fit.covariance))
    matrix = fit.covariance / np.outer(stds, stds)
    pairs = [(float(matrix[i, j]), i, j) for i in common for j in common if j < i]
    strong = sorted((pair for pair in pairs if abs(pair[0]) >= STRONG), key=lambda pair: -abs(pair[0]))
    return [Pair(fit.unknowns[j].name, fit.unknowns[i].name, value) for value, i, j in strong[:_PAIRS]]


def _between(found: FromPressures) -> Between | None:
    """How the recordings deviate from each other; None where they may not."""
    out = []
    for fit in found.fits:
        ways: dict[str, list[int]] = {}
        for k, item in enumerate(fit.unknowns):
            if item.recording:
                ways.setdefault(item.name.removeprefix(f"{item.recording}: "), []).append(k)
        for name, places in ways.items():
            values = np.array([fit.unknowns[k].value(float(fit.amounts[k])) for k in places])
            low, high = places[int(np.argmin(values))], places[int(np.argmax(values))]
            pick = np.zeros(len(fit.unknowns))
            pick[low] -= fit.unknowns[low].std
            pick[high] += fit.unknowns[high].std
            std, largest = math.sqrt(float(pick @ fit.covariance @ pick)), float(np.ptp(values))
            out.append(DifferenceEntry(name, tuple(values.tolist()), largest, std, largest > _CERTAIN * std))
    out.sort(key=lambda item: -item.largest / max(item.std, 1e-12))
    return Between(tuple(out)) if out else None


def _recording(whole: ReplayReport, name: str, state: JointCondition, end: float) -> RecordingEntry:
    joint = JointFacts.of(state)
    return RecordingEntry(
        sha256=whole.recording.sha256,
        topics=whole.recording.topics,
        issues=whole.recording.issues,
        name=name,
        condition=joint.condition,
        lock_angle_rad=joint.lock_angle_rad,
        source=joint.source,
        samples=whole.samples,
        duration_s=whole.duration_s,
        fitted_until_s=end,
    )
