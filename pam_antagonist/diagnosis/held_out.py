"""Errors of the three models on held-out data, of the model alone and of the estimator.

In an angle-driven joint the torque is the torque from outside.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis import calibrations
from pam_antagonist.diagnosis.agreement import common_point, own_rig, with_tuning
from pam_antagonist.diagnosis.errors import Errors, Innovations, ModelErrors, Sliding, errors_of, total_of
from pam_antagonist.diagnosis.judged import Judged, JudgedJoint
from pam_antagonist.diagnosis.models import Model, in_threads
from pam_antagonist.diagnosis.preparation import DRIVEN, Group, Prepared
from pam_antagonist.diagnosis.residual_statistics import of_innovations, statistics
from pam_antagonist.diagnosis.result import MODELS, HeldOutComparison, RecordingEntry
from pam_antagonist.estimation import EstimateRun, Estimator, metrics
from pam_antagonist.inference import calibration
from pam_antagonist.inference.angle_driven import sweeps
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import refit
from pam_antagonist.inference.trial import ANGLE, CHANNELS, PRESSURE_1, PRESSURE_2, TORQUE
from pam_antagonist.model.effects import DISTURBANCE
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]


Ended = tuple[Group, Model, Model]
"""A group with its end held out, and its models without and with effects."""


def ended(joint: JudgedJoint) -> list[Ended]:
    """The parts of a joint; models that were fitted to all data are fitted again, to what is not held out."""
    return [_ended(one) for one in joint.parts]


def _ended(judged: Judged) -> Ended:
    group = judged.group
    if not any(experiment.splits for experiment in judged.model.experiments):
        return group, judged.base, judged.model

    def again(model: Model) -> Model:
        prepared = replace(model, experiments=group.experiments)
        return prepared.map(lambda experiment, fitted: refit(experiment, fitted.point, fitted.free))

    return group, again(judged.base), again(judged.model)


def comparisons(joint: JudgedJoint, parts: Sequence[Ended]) -> tuple[HeldOutComparison, ...]:
    """Every recording of a joint with the three models. `parts`: of :func:`ended`."""
    values = [one.values for one in joint.parts]
    return tuple(c for part, of in zip(parts, values, strict=True) for c in compare(joint.prepared, *part, of))


def compare(
    prepared: Prepared, group: Group, base: Model, model: Model, effects: Mapping[str, float]
) -> tuple[HeldOutComparison, ...]:
    """Every recording of a group with the three models; recordings that were held out as a whole come last.

    A recording that was held out as a whole has the common parameters of the fitted ones. Only its start is fitted to
    its own data.

    `effects`: values of its effects that suit all recordings, by dotted path.
    """
    one = partial(HeldOutComparison, prepared)
    role = "fitted" if group.held_out else "both"
    out = []
    for experiment, number, old, new in zip(model.experiments, group.numbers, base.fits, model.fits, strict=True):
        points = (experiment.origin, old.point, new.point)
        out.append(one(experiment.free_run, dict(zip(MODELS, points, strict=True)), role, number))
    if group.held_out:
        before, after = (common_point(m, values) for m, values in ((base, {}), (model, effects)))
        for number, other in enumerate(group.held_out, len(group.experiments)):
            points = (other.origin, other.started(before), other.started(after))
            out.append(one(other.free_run, dict(zip(MODELS, points, strict=True)), "held out", number))
    return tuple(out)


def rig_of(parts: Sequence[HeldOutComparison], model: str) -> Rig:
    """One recording's own rig. `model`: one of ``MODELS``."""
    own = [part.of(model) for part in parts]
    if model == "as_configured":
        return own[0].prepared.rig
    rig = own[0].prepared.base
    for part in own:
        rig = own_rig(part.experiment, part.points[model], rig)
    return rig


def by_recording(
    compared: Sequence[HeldOutComparison], tuned: Mapping[str, Rig], estimator: bool, jobs: int
) -> tuple[RecordingEntry, ...]:
    """Errors and residuals of the three models on what was held out of each recording, model alone and estimator.

    `tuned`: rigs whose tuning the estimator uses, by model; default: the configured tuning.
    """

    def one(number: int) -> RecordingEntry:
        parts = [part for part in compared if part.number == number]
        rigs = {name: with_tuning(rig_of(parts, name), tuned.get(name)) for name in MODELS}
        first = parts[0]
        experiment, trial = first.experiment, first.experiment.trial
        entry = RecordingEntry(
            first.prepared.trials[number].name,
            trial.joint,
            trial.lock_angle if trial.joint == "locked" else None,
            first.role,
            experiment.held_parts[0].begin_s if first.judges else None,
            held_out_s=tuple((part.begin_s, part.end_s) for part in experiment.held_parts) if first.judges else None,
        )
        if not first.judges:
            return entry
        residuals = {
            model: [
                row for part in parts for row in statistics(part.of(model).experiment, part.of(model).points[model])
            ]
            for model in MODELS[1:]
        }
        ukf = None
        if estimator:
            runs = {model: estimator_errors(*corrected(first, model), rigs[model]) for model in MODELS}
            ukf = ModelErrors(*(runs[model][0] for model in MODELS))
            for model, rows in residuals.items():
                own = first.of(model)
                rows.extend(of_innovations(own.experiment, own.points[model], *runs[model][1:]))
        counted = None
        if experiment.slides is not None:
            spans = {"fitted": (0, experiment.fitted), "held_out": (experiment.fitted, len(trial))}
            counted = {name: sweeps(trial, *span) for name, span in spans.items()}
        return replace(
            entry,
            errors=ModelErrors(*(model_errors(first, model, rigs[model]) for model in MODELS)),
            residuals={model: tuple(rows) for model, rows in residuals.items()},
            ukf=ukf,
            sweeps=counted,
        )

    return tuple(in_threads(one, ((number,) for number in sorted({part.number for part in compared})), jobs))


def model_errors(part: HeldOutComparison, model: str, rig: Rig) -> Errors:
    """Errors of the model alone, run from the recording's start, on the samples that were held out.

    `model`: one of ``MODELS``.
    """
    part = part.of(model)
    experiment, held = part.experiment, part.experiment.held_samples
    measured, shown = experiment.trial.measured[held], experiment.shown(part.points[model], rig)[held]
    found = errors_of(measured, shown, experiment.judged_channels)
    if experiment.slides is None or found.torque is None:
        return found
    slides, error = experiment.slides[held], (shown - measured)[:, TORQUE]
    sliding, sticking = (
        metrics.rmse(error[rows]) if np.isfinite(error[rows]).any() else None for rows in (slides, ~slides)
    )
    return replace(found, sliding=Sliding(sliding, sticking, float(np.mean(slides))))


def total_errors(compared: Sequence[HeldOutComparison], entries: Sequence[RecordingEntry]) -> ModelErrors:
    """Errors over all recordings of which something was held out. `entries`: of :func:`by_recording`."""
    held = [(part.number, part.experiment) for part in compared if part.judges]
    samples = {number: int(experiment.held_samples.sum()) for number, experiment in held}
    known = [(errors, samples[number]) for number in sorted(samples) if (errors := entries[number].errors) is not None]
    by_model = zip(*(errors.all for errors, _ in known), strict=True)
    return ModelErrors(*(total_of(parts, [count for _, count in known]) for parts in by_model))


def _estimated(recording: Recording, rig: Rig, experiment: Experiment) -> tuple[EstimateRun, NDArray[np.bool_]]:
    """The estimator over all of a recording, and which of its samples were held out (M,)."""
    trial = experiment.trial
    joint = "free" if trial.joint == DRIVEN else trial.joint
    run = Estimator(rig, joint=joint, lock_angle=trial.lock_angle).run(
        recording.stamp_ns, recording.pressure, recording.voltage
    )
    held = experiment.held_samples
    sample = np.rint((recording.stamp_ns[run.index] - recording.stamp_ns[0]) * 1e-9 / trial.dt).astype(np.int64)
    return run, held[np.minimum(sample, len(held) - 1)]


def corrected(part: HeldOutComparison, model: str) -> tuple[Recording, Experiment]:
    """A recording corrected by the calibrations of a model: as read, and on its even grid."""
    own = part.of(model)
    corrections = calibrations.corrections(calibration.values_of(own.points[model].effects))
    return corrections.applied(own.recording), own.experiment.corrected(own.points[model])[0]


def estimator_errors(recording: Recording, experiment: Experiment, rig: Rig) -> tuple[Errors, Floats, Floats]:
    """The estimator, which knows pressures and voltages only, on the samples that were held out.

    Its errors; the time of each sample since the recording's first (M,) [s]; innovations of the pressures, in their
    standard deviations (M, 2).
    """
    run, late = _estimated(recording, rig, experiment)
    rows, index = run.rows[late], run.index[late]
    variance = {ANGLE: rows["covariance"][:, 0, 0], TORQUE: rows["covariance"][:, 2, 2]}
    estimate = np.column_stack([rows["angle"], rows["torque"], rows["pressure"]])
    torque = recording.torque
    if experiment.trial.joint == DRIVEN:
        estimated = run.added.get(DISTURBANCE)
        estimate[:, TORQUE] = np.nan if estimated is None else estimated[late]
        torque = None if estimated is None else recording.external_torque
        del variance[TORQUE]
    measured = np.full((len(rows), len(CHANNELS)), np.nan)
    for channel, values in ((ANGLE, recording.angle), (TORQUE, torque)):
        if values is not None:
            measured[:, channel] = values[index]
    measured[:, PRESSURE_1:] = recording.pressure[index]
    known = {ANGLE: recording.angle is not None, TORQUE: torque is not None, PRESSURE_1: True, PRESSURE_2: True}
    channels = [c for c, there in known.items() if there and experiment.trial.has(c)]
    found = errors_of(measured, estimate, channels)
    reading = rig.sensors.reading
    for name, channel in (("angle", ANGLE), ("torque", TORQUE)):
        errors = getattr(found, name)
        if errors is not None and channel in variance:
            share = metrics.coverage(estimate[:, channel] - measured[:, channel], variance[channel], reading(name))
            found = replace(found, **{name: replace(errors, coverage95=share)})
    normal = rows["innovation"] / np.sqrt(np.diagonal(rows["innovation_covariance"], axis1=1, axis2=2))
    innovation = Innovations(
        float(np.nanmean(rows["nis"])), metrics.whiteness_p(normal), metrics.largest_autocorrelation(normal)
    )
    time = (recording.stamp_ns[index] - recording.stamp_ns[0]) * 1e-9
    return replace(found, innovation=innovation), np.asarray(time, dtype=np.float64), np.asarray(normal)


def deciding_evidence(
    prepared: Prepared, group: Group, base: Model, model: Model, effects: Mapping[str, float]
) -> float | None:
    """Evidence of the estimator's innovations where nothing but pressures was measured; None where anything else was.

    `effects`: values of its effects that suit all recordings, by dotted path.
    """
    if any(e.trial.has(c) for e in (*group.experiments, *group.held_out) for c in (ANGLE, TORQUE)):
        return None
    return innovation_evidence(compare(prepared, group, base, model, effects), model.jobs)


def innovation_evidence(compared: Sequence[HeldOutComparison], jobs: int) -> float:
    """Twice the log likelihood ratio of the innovations of held-out samples, extended over recalibrated model.

    Both filters have the tuning of the rig as configured. No parameter has a price: nothing was fitted there.
    """

    def likelihood(part: HeldOutComparison, model: str) -> float:
        rig = own_rig(part.experiment, part.points[model])
        recording, experiment = corrected(part, model)
        run, held = _estimated(recording, rig, experiment)
        rows = run.rows[held]
        s = rows["innovation_covariance"]
        determinant = s[:, 0, 0] * s[:, 1, 1] - s[:, 0, 1] * s[:, 1, 0]
        used = np.isfinite(rows["innovation"]).all(axis=1) & np.isfinite(rows["nis"]) & (determinant > 0.0)
        value = -0.5 * (rows["nis"][used] + np.log(determinant[used])) - math.log(2.0 * math.pi)
        return float(value.sum())

    tasks = [
        (sign, part, model)
        for part in compared
        if part.judges
        for sign, model in ((1.0, "extended"), (-1.0, "recalibrated"))
    ]
    found = in_threads(likelihood, (task for _, *task in tasks), jobs)
    return 2.0 * sum(sign * value for (sign, *_), value in zip(tasks, found, strict=True))


def static_map(prepared: Prepared) -> dict[str, float] | None:
    """Errors of maps without physics: the torque as a linear function of the angle, and of angle and pressures.

    They are fitted by least squares to what may be fitted, and judged on the rest. None for a joint that is not driven
    by its angle, and where no torque from outside was recorded.
    """
    known = {
        number: experiment
        for group in prepared.groups
        for number, experiment in zip(group.numbers, group.experiments, strict=True)
        if experiment.slides is not None and experiment.trial.has(TORQUE)
    }
    if not known:
        return None
    out = {}
    for name, columns in (("angle", [ANGLE]), ("angle_and_pressures", [ANGLE, PRESSURE_1, PRESSURE_2])):
        parts = []
        for experiment in known.values():
            measured = experiment.trial.measured / np.array([1.0, 1.0, 1e5, 1e5])
            rows = np.isfinite(measured).all(axis=1)
            design = np.column_stack([np.ones(len(measured)), measured[:, columns]])
            parts.append((design, measured[:, TORQUE], rows & (np.arange(len(rows)) < experiment.fitted), rows))
        early = np.concatenate([design[fit] for design, _, fit, _ in parts])
        given = np.concatenate([torque[fit] for _, torque, fit, _ in parts])
        solution = np.linalg.lstsq(early, given, rcond=None)[0]
        left = np.concatenate([(torque - design @ solution)[rows & ~fit] for design, torque, fit, rows in parts])
        out[name] = float(np.sqrt(np.mean(left**2)))
    return out
