"""Numbers of an identification's ``report.json``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from pam_antagonist.identification.directions import ConsideredDirection
from pam_antagonist.identification.session import Identified, recording_that_shows, relative
from pam_antagonist.recording.joint import JointCondition
from pam_antagonist.replays.result import JointFacts
from pam_antagonist.report.assumption import assumption
from pam_antagonist.report.held_out import Given, HeldOut, Judged, pooled_coverage
from pam_antagonist.report.identify_entries import (
    Between,
    Change,
    DifferenceEntry,
    DirectionEntry,
    IdentifyReport,
    Noise,
    Pair,
    ParameterEntry,
    ProfileEntry,
    RecordingEntry,
    RelativeChange,
    SensorNoise,
    Settings,
    StageEntry,
    TuningEntry,
)
from pam_antagonist.report.identify_findings import rejection
from pam_antagonist.report.units import unit_of
from pam_antagonist.rig import Rig
from pam_antagonist.software import versions

STRONG = 0.9
"""Least correlation of two parameters that are listed as a pair."""
_PAIRS = 12


def rigs_of(found: Identified) -> list[Mapping[str, Rig]]:
    """The rigs to compare on each recording of an identification."""
    both: dict[str, Rig] = {"as_configured": found.start, "identified": found.tuned.rig}
    return [{**both, "own": own} for own in found.own] if found.own else [both] * len(found.trials)


def report(
    recordings: Sequence[Given], found: Identified, judged: Sequence[Judged], refused: str = ""
) -> IdentifyReport:
    """The numbers of an identification.

    Args:
        recordings: as identified.
        found: the identification.
        judged: of :func:`judge`.
        refused: why the file of the identified rig would be refused; empty if it would not.
    """
    asked = found.options
    numbers = IdentifyReport(
        held_out=tuple(HeldOut.of(item) for item in judged),
        coverage95=pooled_coverage(judged),
        coverage95_own=pooled_coverage(judged, "own"),
        parameters=_parameters(found),
        stages=tuple(StageEntry.of(stage) for stage in found.stages),
        correlations=_correlations(found),
        profiles=tuple(ProfileEntry(p.name, tuple(p.value), tuple(p.loss), p.low, p.high) for p in found.profiles),
        between=_between(found),
        noise=Noise(SensorNoise.of(found.start), SensorNoise.of(found.tuned.rig)),
        tuning=_tuning(found),
        starts=found.starts,
        recordings=tuple(_recording(item, state) for item, (_, state, _) in zip(judged, recordings, strict=True)),
        warnings=found.warnings,
        settings=Settings(found.start.name, asked.free, asked.frozen, asked.holdout, asked.starts, asked.seed),
        software=versions(),
        assumption=assumption(found.start, identified=True),
    )
    return replace(numbers, rejected=rejection(numbers.held_out, refused, numbers.parameters, found.start.bounds))


def _parameters(found: Identified) -> tuple[ParameterEntry, ...]:
    fit = found.fit
    values, stds, known = fit.values, fit.std, found.evidence
    several = range(len(found.trials)) if len(found.trials) > 1 else range(0)
    owns, own_stds = [fit.own_values(k) for k in several], [fit.own_std(k) for k in several]
    return tuple(
        ParameterEntry(
            item.name,
            item.start,
            values[item.name],
            stds[item.name],
            relative(values[item.name], item.start),
            item.prior_std,
            known[item.name].moves,
            known[item.name].misfit,
            known[item.name].bound,
            known[item.name].determined,
            known[item.name].reason,
            None if known[item.name].determined else recording_that_shows(item.name),
            tuple(own[item.name] for own in owns),
            tuple(own[item.name] for own in own_stds),
            unit_of(found.start, item.name),
        )
        for item in found.free
    )


def _correlations(found: Identified) -> tuple[Pair, ...]:
    """Pairs of strongly correlated parameters, the strongest first."""
    names, matrix = [item.name for item in found.free], found.fit.correlation
    pairs = [(float(matrix[i, j]), i, j) for i in range(len(names)) for j in range(i)]
    strong = sorted((pair for pair in pairs if abs(pair[0]) >= STRONG), key=lambda pair: -abs(pair[0]))
    return tuple(Pair(names[j], names[i], value) for value, i, j in strong[:_PAIRS])


def _between(found: Identified) -> Between | None:
    if found.fit.spread is None:
        return None
    return Between(
        {way.group: float(value) for way, value in zip(found.ways, found.fit.spread, strict=True)},
        found.fit.evidence_gain,
        tuple(
            DifferenceEntry(item.name, tuple(item.deviations), item.largest, item.std, bool(item.certain))
            for item in found.differences
        ),
    )


def _tuning(found: Identified) -> TuningEntry:
    tuned = found.tuned
    now, before = tuned.rig.tuning("default"), found.start.tuning("default")
    return TuningEntry(
        process=tuple(now.process),
        process_before=tuple(before.process),
        measurement=tuple(now.measurement),
        measurement_before=tuple(before.measurement),
        log_likelihood_a_sample=Change(*tuned.likelihood),
        evaluations=tuned.evaluations,
        scale=tuned.scale,
        scale_from_reference=tuned.calibrated,
        directions=tuple(
            DirectionEntry(
                item.name,
                math.degrees(item.angle) * tuned.scale,
                item.torque * tuned.scale,
                item.share,
                _largest(found, item),
            )
            for item in tuned.directions
        ),
    )


def _largest(found: Identified, direction: ConsideredDirection) -> tuple[RelativeChange, ...]:
    """The parameters that a direction moves most, relative to their values."""
    moves = [
        RelativeChange(name, found.tuned.scale * relative(found.fitted.value(name) + step, found.fitted.value(name)))
        for name, step in direction.changes.items()
    ]
    moves.sort(key=lambda item: -abs(item.relative))
    return tuple(moves[:5])


def _recording(item: Judged, state: JointCondition) -> RecordingEntry:
    whole, joint = item.whole["identified"].report, JointFacts.of(state)
    return RecordingEntry(
        sha256=whole.recording.sha256,
        topics=whole.recording.topics,
        issues=whole.recording.issues,
        name=item.name,
        condition=joint.condition,
        lock_angle_rad=joint.lock_angle_rad,
        source=joint.source,
        samples=whole.samples,
        duration_s=whole.duration_s,
        fitted_until_s=item.from_s,
    )
