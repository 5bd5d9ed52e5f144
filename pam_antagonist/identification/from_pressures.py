"""Identification of any rig from its measured pressures: joint, air, filter, and a judgement on held-out data.

1. Joint and muscles from the measured pressures (:mod:`~pam_antagonist.identification.joint_stage`).
2. The valves' curves, where the recordings hold steady pressures (:mod:`~pam_antagonist.identification.valve_curve`).
3. Chambers and valves, or regulators, from the measured motion (:mod:`~pam_antagonist.identification.air_stage`).
4. Noise and covariance of the filter (:mod:`~pam_antagonist.identification.filter_stage`).
5. Errors on data that no step saw, beside those of the rig as configured and of a linear map of the two pressures.

One long recording and many short trials take the same way, as do valves and regulators, forces by a data sheet's law
and by a linear map. A few long recordings may each deviate a little from the values that they have in common.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.identification import air_stage, joint_stage, noise
from pam_antagonist.identification.air_stage import errors, fit_air
from pam_antagonist.identification.filter_stage import (
    Given,
    UnknownTorque,
    with_least_error,
    with_process_noise,
    with_unknown_force,
    with_unknown_torque,
)
from pam_antagonist.identification.joint_stage import fit_joint, model_values
from pam_antagonist.identification.parts import (
    calibration_of,
    checked,
    fitted_until,
    has_commands,
    is_free,
    moving_parts,
    near_joints,
    parts_of,
    with_joint,
)
from pam_antagonist.identification.regulators import beside_the_lag
from pam_antagonist.identification.result import (
    AS_USUAL,
    FromPressures,
    HeldRecording,
    Options,
    Step,
    held_of,
    linear_map,
)
from pam_antagonist.identification.runs import Run, notes_of
from pam_antagonist.identification.said import CLEAR, values_in_words
from pam_antagonist.identification.valve_curve import identify_curves
from pam_antagonist.inference.fit import Fit, Residual, fitted, within_bounds
from pam_antagonist.inference.free_parameters import free_parameters, moved
from pam_antagonist.inference.trial import make_trial
from pam_antagonist.inference.unknown import Unknown, parameters
from pam_antagonist.recording import recording_hash, seen_in_words, seen_until
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.rig import Rig
from pam_antagonist.rig.file import refusal

__all__ = ["FromPressures", "HeldRecording", "concluded", "fitted_until", "identify", "parts_of", "with_joint"]

Floats = NDArray[np.float64]

_OTHER_RIG = 0.15
"""Relative difference of a valve's area beyond which two recordings may be of two rigs."""
_ENCODER_LEAVES = 0.5
"""Zero and delay alone have to leave less of the angle's squared error than this share. Chosen with two joints in view:
of one they left 0.0004, of the other, whose encoder was right, nearly all."""
_SEPARATE = 0.5
"""Recordings are of two rigs if separate fits leave less than this share of the common fit's held-out squared error."""


def identify(
    recordings: Sequence[Given],
    rig: Rig,
    holdout: float = 1.0 / 3.0,
    starts: int = 2,
    seed: int = 0,
    jobs: int = 1,
    progress: Callable[[str], None] | None = None,
    whole: int = 0,
    free: Sequence[str] = (),
    frozen: Sequence[str] = (),
    encoder: bool = False,
    walk: Callable[[Unknown], Unknown] | None = None,
) -> FromPressures:
    """Identify a rig.

    Args:
        recordings: each with its joint's condition and a name.
        rig: start values and priors.
        holdout: share of the data that is held out.
        starts: number of starts of the joint's fit.
        seed: of the further starts.
        jobs: threads.
        progress: called with a text about each step.
        whole: number of recordings at the end that are held out as a whole, in place of the share.
        free: names, or beginnings of names, of parameters that may move beside the usual ones.
        frozen: names, or beginnings of names, of parameters that may not move.
        encoder: whether the encoder of a known rig may read too high and too late; those of data sheets always may.
        walk: a number of a rig that was identified before, with what is known of it today; default: as it was then.

    Raises:
        BadInput: recordings that tell too little.
    """
    progress = progress or (lambda text: None)
    options = Options(tuple(free), tuple(frozen), holdout, starts, seed, walk is not None)
    ends = fitted_until(recordings, holdout, whole)
    model = rig
    runs = checked(recordings, ends, model)
    unknown, unknown_air, notes = _chosen(model, runs, options)
    if encoder and not model.is_from_data_sheets:
        unknown += _encoder(model, runs, jobs)
    if walk is not None:
        unknown, unknown_air = ([walk(item) for item in items] for items in (unknown, unknown_air))
    refine = not model.is_from_data_sheets
    joint = fit_joint(model, runs, starts=starts if refine or walk else max(starts, 2), seed=seed, jobs=jobs,
                      progress=progress, free=unknown, refine=refine)  # fmt: skip
    own, corrected = with_joint(model, joint, recordings)
    steps = [_joint_step(model, runs, joint)]
    moving = moving_parts(own, corrected, ends)
    if not model.is_from_data_sheets and rig.drive == "regulator":
        progress("regulators")
        model, step = _with_regulators(model, corrected, ends, jobs)
        own = moved(model, model_values(joint.unknowns, joint.values))
        steps.append(step)
    elif not model.is_from_data_sheets:
        progress("valve curve")
        model, curve = _with_curves(model, moving)
        own = moved(model, model_values(joint.unknowns, joint.values))
        steps.append(curve)
    air = fit_air(own, moving, 0.0, jobs=jobs, progress=progress, free=unknown_air, refine=refine)
    if air is not None and not refine:
        air = air_stage.with_air_errors(air, own, moving, jobs, near_joints(model, joint, recordings, ends))
        air = replace(air, lost=joint.lost)
    if air is not None:
        steps.append(_air_step(own, moving, air))
    notes = (*_of_two_rigs(recordings, ends, own, joint, air, jobs), *notes)
    return concluded(recordings, ends, rig, joint, air, jobs, progress, model, options, steps, notes)


def _chosen(rig: Rig, runs: Sequence[Run], options: Options) -> tuple[list[Unknown], list[Unknown], tuple[str, ...]]:
    """The unknowns of the joint and of the air, and what to say of them."""
    named = free_parameters(rig, options.free, options.frozen)
    seen = any(np.isfinite(run.torque).any() or run.moves for run in runs)
    if not rig.is_from_data_sheets:
        kept = [
            item for item in named if seen or joint_stage.is_of_air(item.name) or item.name.startswith(options.free)
        ]
        if not kept:
            raise BadInput(
                "no recording has a measured angle or torque, and pressures alone do not determine the free "
                f"parameters: {', '.join(sorted(item.name for item in named))}"
            )
        notes = () if seen else (
            "No recording has a measured angle or torque: pressures alone determine "
            f"{', '.join(item.name for item in kept)} only; all others stay as configured. To determine the others, "
            "record the angle of a free joint and the torque of a locked one.",
        )  # fmt: skip
        air = [item for item in kept if joint_stage.is_of_air(item.name)]
        return [*joint_stage.of_joint(rig, kept), *_stops(rig, runs, kept, options)], air, notes
    more = [item for item in named if item.name.startswith(options.free)] if options.free else []
    both = []
    joint = [*joint_stage.unknowns(rig, runs), *_stops(rig, runs, more, options)]
    for usual, of_air in ((joint, False), (air_stage.unknowns(rig, runs), True)):
        kept_unknowns = [item for item in usual if not _is_frozen(item, options.frozen)]
        known = {path for item in usual for path in item.paths}
        further = [item for item in more if joint_stage.is_of_air(item.name) == of_air and item.name not in known]
        both.append([*kept_unknowns, *further])
    return both[0], both[1], ()


def _encoder(rig: Rig, runs: Sequence[Run], jobs: int) -> list[Unknown]:
    """Zero and delay of a known rig's encoder, as they are found alone; nothing where they do not explain the most.

    Where all values were as free, forces that are a little different would pass for another zero, and in small motions
    the other way round.
    """
    if not any(run.moves and not run.locked for run in runs):
        return []
    unknown = joint_stage.encoder(joint_stage.BY_EYE)
    found = fit_joint(rig, runs, starts=1, jobs=jobs, free=unknown)
    before, after = (sizes["angle"] for sizes in _joint_errors(rig, runs, found))
    if not after**2 < _ENCODER_LEAVES * before**2:
        return []
    clear = [item for item in unknown if abs(found.values[item.name]) > CLEAR * found.stds[item.name]]
    return [replace(item, start=found.values[item.name], std=found.stds[item.name]) for item in clear]


def _stops(rig: Rig, runs: Sequence[Run], others: Sequence[Unknown], options: Options) -> list[Unknown]:
    """The angle of the stops where recordings show it, unless others have it or it may not move."""
    known = {item.name for item in others}
    return [
        item for item in joint_stage.stops(rig, runs) if item.name not in known and not _is_frozen(item, options.frozen)
    ]


def _is_frozen(item: Unknown, frozen: Sequence[str]) -> bool:
    return any(path == word or path.startswith(word.rstrip(".") + ".") for word in frozen for path in item.paths)


def concluded(
    recordings: Sequence[Given],
    ends: Sequence[float],
    rig: Rig,
    joint: Fit,
    air: Fit | None,
    jobs: int = 1,
    progress: Callable[[str], None] | None = None,
    model: Rig | None = None,
    options: Options = AS_USUAL,
    steps: Sequence[Step] = (),
    earlier: Sequence[str] = (),
) -> FromPressures:
    """Noise and covariance of the filter for values that were found, and its errors on held-out data.

    `ends`: of the fitted part of each [s], see :func:`fitted_until`. `air`: values of chambers and valves, or
    regulators; None without commands.
    """
    progress = progress or (lambda text: None)
    own, corrected = with_joint(model or rig, joint, recordings)
    if air is not None:
        own = moved(own, parameters(air.unknowns, air.values))
    runs = moving_parts(own, corrected, ends)
    covered = _with_filter(own, joint, air, _cut(corrected, ends), runs, jobs, progress)
    progress("held-out data")
    line = linear_map(runs)
    deviating = {item.recording: _own_rig(covered.rig, joint, air, item.recording)
                 for fit in (joint, air) if fit is not None for item in fit.unknowns if item.recording}  # fmt: skip
    held = []
    for number, (given, before, end) in enumerate(zip(corrected, recordings, ends, strict=True)):
        if has_commands(given) and end < given[0].duration_s:
            rigs = {"as_configured": rig, "identified": covered.rig}
            rigs |= {"own": deviating[given[2]]} if given[2] in deviating else {}
            held.append(replace(held_of(given, before, end, rigs, line), number=number))
    used = tuple((name, end) for (_, _, name), end in zip(recordings, ends, strict=True) if end > 0.0)
    final = (joint, air)
    if rig.is_from_data_sheets:
        progress("all of the data")
        final = _from_all(recordings, model or rig, joint, air, jobs)
    result = _delivered(covered.rig, rig, *final)
    if final[0] is not joint and refusal(result):  # no possible rig
        final = (joint, air)
        result = _delivered(covered.rig, rig, *final)
    seen = [f"{name}: {text}." for recording, _, name in recordings
            if (text := seen_in_words(recording, rig.fitted, rig.name))]  # fmt: skip
    start_saw = any(seen_until(one[0], rig.fitted) > end for one, end in zip(recordings, ends, strict=True))
    until = ends if final[0] is joint else [math.inf] * len(ends)
    notes = (*earlier, *seen, *notes_of(runs), *values_in_words(*final))
    own_rigs = tuple(deviating.get(name, covered.rig) for _, _, name in recordings if deviating)
    return FromPressures(
        rig,
        result,
        own_rigs,
        joint,
        air,
        final,
        covered,
        tuple(held),
        used,
        notes,
        errors(own, runs),
        tuple(steps),
        options,
        start_saw,
        {
            recording_hash(one): min(end, one.duration_s)
            for (one, _, _), end in zip(recordings, until, strict=True)
            if end > 0.0
        },
    )


def _delivered(tuned: Rig, start: Rig, joint: Fit, air: Fit | None) -> Rig:
    """The rig file: the tuned rig with values, and with the calibration that belongs to them."""
    values = model_values(joint.unknowns, joint.values)
    values |= {} if air is None else parameters(air.unknowns, air.values)
    out = moved(tuned, values)
    calibration = _calibration(start).followed_by(calibration_of(joint)).calibration()
    return out.replaced(calibration=start.calibration.replaced(**calibration)) if calibration else out


def _from_all(
    recordings: Sequence[Given], model: Rig, joint: Fit, air: Fit | None, jobs: int
) -> tuple[Fit, Fit | None]:
    """The values that all of the data determine; the fits begin at those that were found in a part of them."""
    everything = [math.inf] * len(recordings)
    runs = parts_of(recordings, everything)
    residual = joint_stage.residual_of(model, runs, joint.unknowns, math.inf)
    last = joint_stage.with_joint_errors(_of_more(joint, residual, jobs), model, runs, jobs)
    if air is None:
        return last, None
    own, corrected = with_joint(model, last, recordings)
    runs, near = moving_parts(own, corrected, everything), near_joints(model, last, recordings, everything)
    residual = air_stage.residual_of(own, air_stage.usable(runs), 0.0, air_stage.HORIZONS[-1], air.unknowns)
    found = air_stage.with_air_errors(_of_more(air, residual, jobs), own, runs, jobs, near)
    return last, replace(found, lost=last.lost)


def _of_more(fit: Fit, residual: Residual, jobs: int) -> Fit:
    """A fit of more data: what had met a bound keeps the rig file's value, and nothing else is put back.

    The values that are delivered are then those that held-out data have judged. A value that only all data bring to its
    bound stays there: put back, it took one joint's other values far away, and the error from 0.7 to 1.1 degrees.
    """
    if not fit.kept:
        return fitted(fit.unknowns, residual, fit.amounts, jobs=jobs)
    stay = {item.name for item in fit.unknowns} - set(fit.kept)
    return replace(within_bounds(fit, residual, jobs=jobs, stay=stay), kept=fit.kept)


def _own_rig(rig: Rig, joint: Fit, air: Fit | None, name: str) -> Rig:
    """The rig with the deviations of one recording."""
    own = model_values(joint.unknowns, joint.values, name)
    return moved(rig, own | ({} if air is None else parameters(air.unknowns, air.values, name)))


def _with_filter(
    rig: Rig, joint: Fit, air: Fit | None, parts: Sequence[Given], runs: Sequence[Run], jobs: int,
    progress: Callable[[str], None],
) -> UnknownTorque:  # fmt: skip
    """The rig with noise and covariance of its filter."""
    progress("process noise of the filter")
    free = [given for given in parts if is_free(given)]
    if rig.is_from_data_sheets:
        followed = with_process_noise(rig, free, jobs)
        covered = with_unknown_torque(followed, free, jobs, progress)
        return replace(covered, rig=with_unknown_force(covered.rig, parts, jobs, progress))
    found = {path for fit in (joint, air) if fit is not None for path in parameters(fit.unknowns, fit.values)}
    kept = {path: std for path, std in rig.uncertainty.items() if path not in found}
    quiet = noise.with_noise(rig.replaced(uncertainty=kept), [recording for recording, _, _ in parts])
    followed = with_process_noise(quiet, parts, jobs, guessed=False).replaced(uncertainty=kept)
    best = with_least_error([quiet, followed], parts, jobs)
    best = noise.with_directions(best, joint, runs)
    covered = with_unknown_torque(best, free, jobs, progress) if free else UnknownTorque(best, 0.0, math.nan)
    return replace(covered, rig=with_unknown_force(covered.rig, parts, jobs, progress))


def _joint_step(rig: Rig, runs: Sequence[Run], joint: Fit) -> Step:
    """The step of joint and muscles, for the report."""
    before, after = _joint_errors(rig, runs, joint)
    note = "" if joint.unknowns else "skipped: no parameter of it is free, or shows"
    source = "measured pressures, which drive the joint"
    return Step("joint and muscles", source, _moves(rig, joint), before, after, note)


def _joint_errors(rig: Rig, runs: Sequence[Run], fit: Fit) -> list[dict[str, float]]:
    """Errors of the joint by what is measured, RMS: with the values before a fit, and with those of it."""
    values = [{item.name: item.start for item in fit.unknowns}, fit.values]
    each = joint_stage.errors_of(rig, runs, fit.unknowns, values)
    return [{kind: _rms(left) for kind, left in joint_stage.joined(errors).items()} for errors in each]


def _air_step(rig: Rig, runs: Sequence[Run], air: Fit) -> Step:
    """The step of the air, for the report."""
    start = {item.name: item.start for item in air.unknowns}
    left = air_stage.residual_of(rig, air_stage.usable(runs), 0.0, air_stage.HORIZONS[-1], air.unknowns, raw=True)
    sizes = [{"pressure": _rms(one)} for one in left([start, air.values])]
    return Step("chambers and valves" if rig.drive == "valve" else "chambers and regulators",
                "commands and motion, over a second", _moves(rig, air), sizes[0], sizes[1])  # fmt: skip


def _moves(rig: Rig, fit: Fit) -> dict[str, tuple[float, float]]:
    return {path: (rig.value(path), value) for path, value in model_values(fit.unknowns, fit.values).items()}


def _with_curves(rig: Rig, runs: Sequence[Run]) -> tuple[Rig, Step]:
    """The rig with the curves that steady pressures contradict replaced."""
    changed, notes = identify_curves(rig, runs)
    source = "steady pressures: open rate, voltage, the two combined"
    return changed, Step("valve curve", source, {}, {}, {}, "; ".join(notes))


def _with_regulators(rig: Rig, recordings: Sequence[Given], ends: Sequence[float], jobs: int) -> tuple[Rig, Step]:
    """The rig with range, dead zone and largest rate of its regulators, as far as stretches between rests show them."""
    trials = [
        make_trial(given[0], rig, given[1].condition, given[1].lock_angle, given[2]).part(0.0, end)
        for given, end in zip(recordings, ends, strict=True)
        if has_commands(given)
    ]
    values, note = beside_the_lag(rig, trials, jobs)
    moves = {path: (rig.value(path), value) for path, value in values.items()}
    return moved(rig, values), Step("regulators", "commands and pressures between rests", moves, {}, {}, note)


def _of_two_rigs(
    recordings: Sequence[Given], ends: Sequence[float], rig: Rig, joint: Fit, air: Fit | None, jobs: int
) -> tuple[str, ...]:
    """What to say of recordings whose common fit is worse on held-out data than separate ones.

    `ends`: of the fitted part of each [s].
    """
    if air is None or not any(item.recording for item in air.unknowns):
        return ()
    common, apart, values = 0.0, 0.0, {}
    unknown = [item for item in air.unknowns if not item.recording]
    for given, end in zip(recordings, ends, strict=True):
        mine = moving_parts(rig, [given], [end])
        later = air_stage.usable(parts_of([given], [end], held_out=True, locked=True))
        alone = fit_air(rig, mine, 0.0, jobs=jobs, free=unknown)
        if alone is None or not later:
            return ()
        left = air_stage.residual_of(rig, later, 0.0, air_stage.HORIZONS[-1], unknown, raw=True)
        both = left([air.values, alone.values])
        common, apart = common + float(np.sum(both[0] ** 2)), apart + float(np.sum(both[1] ** 2))
        values[given[2]] = alone.parameters
    areas = [next(iter(item.adds)) for item in air.unknowns if item.recording]
    spans = {path: [one[path] for one in values.values()] for path in areas}
    path = max(spans, key=lambda path: max(spans[path]) / min(spans[path]))
    own = {name: one[path] for name, one in values.items()}
    low, high = min(own, key=own.__getitem__), max(own, key=own.__getitem__)
    share = (own[high] - own[low]) / (0.5 * (own[high] + own[low]))
    if apart >= _SEPARATE * common or share <= _OTHER_RIG:
        return ()
    return (
        f"{high} and {low} do not fit together: {path} would differ by {100 * share:.0f} %, and separate fits "
        f"leave {100 * apart / common:.0f} % of the common fit's squared error on held-out data. They are of two "
        "rigs, or the model lacks an effect: identify them one by one, or see what close_loop finds.",
    )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan


def _calibration(rig: Rig) -> Corrections:
    return Corrections(**dict(rig.calibration))


def _cut(recordings: Sequence[Given], ends: Sequence[float]) -> list[Given]:
    """The fitted parts of the recordings with commands."""
    return [
        (part, state, name)
        for (recording, state, name), end in zip(recordings, ends, strict=True)
        if end > 0.0 and has_commands((part := recording.slice(0.0, end), state, name))
    ]
