"""Check a recording against the model of its rig.

First come the samples themselves, and what the values alone show. Then the recorded voltages drive the model. The
measurements agree with it, either as they are or after a correction: gauge pressures, another unit, exchanged lines or
valves, an encoder that counts the other way, voltages that are stamped early. Correlations find the correction. Where
the model drifts away from the voltages, short steps from measured pressures replace them (:mod:`wiring`).

A recording is checked as it was recorded. Corrections that the user gave are compared with those that it needs: one
that is missing is to be typed, one that makes it wrong is to be left out.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist.checks import numbers, samples, wiring
from pam_antagonist.checks.numbers import delay_of_voltages
from pam_antagonist.checks.prediction import correlation, from_pressures, in_steps, predicted
from pam_antagonist.checks.samples import SHORTEST
from pam_antagonist.checks.wiring import Finding
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator
from pam_antagonist.model import equilibrium
from pam_antagonist.model import parameters as par
from pam_antagonist.recording import Recording, plausible
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.recording.joint import JointCondition, ends_of, joint_condition, range_of
from pam_antagonist.recording.plausible import UNITS
from pam_antagonist.recording.rows import resets
from pam_antagonist.rig import NO_ENCODER, Rig
from pam_antagonist.shown import Shown, unlike

Floats = NDArray[np.float64]

_STILL_VOLTAGE, _STILL_PRESSURE = 0.05, 2e3
"""[V, Pa] Channels that move less count as constant."""
_LOCKED_MOVES = math.radians(2.0)
"""[rad] A clamp gives way by less: a joint that moves more is not locked."""
_SEALED_S = 0.05
"""[s] Distance of the compared samples of a sealed joint, which moves slowly."""
_LONGEST = 120.0
"""[s] Only this much of a recording is compared with the model; more does not improve the result."""
_NONE = Corrections()


@dataclass(frozen=True, repr=False)
class Checked(Shown):
    """A checked recording.

    Attributes:
        findings: the worst first.
        corrections: all corrections that the recording needs, with those that were given and are right.
        joint: ``free`` or ``locked``.
    """

    findings: tuple[Finding, ...]
    corrections: Corrections
    joint: str

    @override
    def _brief(self) -> str:
        counts = Counter(finding.status for finding in self.findings)
        first = f"; {self.findings[0].text}" if self.findings else ""
        return f"joint {self.joint}, {', '.join(f'{count} {status}' for status, count in counts.items())}{first}"

    @property
    def wrong(self) -> tuple[Finding, ...]:
        """Findings that are certainly wrong."""
        return tuple(finding for finding in self.findings if finding.status == "wrong")


def check_recording(
    recording: Recording, rig: Rig, joint: str = "auto", lock_angle: float | None = None, typed: Corrections = _NONE
) -> Checked:
    """Compare a recording with the model of its rig, driven by the recorded voltages.

    Args:
        recording: read without judging its values (``read_bag(..., judge=False)``), and without corrections.
        rig: the rig.
        joint: ``free``, ``locked`` or ``auto`` (detected).
        lock_angle: of a locked joint [rad], where it is known.
        typed: corrections that were given for it, and those of the rig file.

    Returns:
        The findings, with corrections as command line options.

    Raises:
        BadInput: a recording that is too short, has no finite voltages or pressures, or has another drive than the
            rig.
    """
    name = recording.path.name
    recording.driven_by(rig.drive)
    typed = replace(typed, atmosphere=rig.atmosphere.pressure)
    if recording.duration_s < SHORTEST:
        lasts = unlike(recording.duration_s, SHORTEST, 1)
        raise BadInput(f"{name}: {lasts} s is too short to check; expected {SHORTEST:g} s or more")
    for what, values in (
        ("voltages" if rig.drive == "valve" else "commands", recording.voltage),
        ("pressures", recording.pressure),
    ):
        if not np.isfinite(values).all(axis=1).any():
            raise BadInput(f"{name}: holds no finite {what}")
    recorded = _unwrapped(recording, typed)
    now, of_values = _by_values(recorded, typed)
    recording, about_faults = samples.faulty(recorded, now)
    if any(finding.status == "wrong" for finding in about_faults):
        now = now.replaced(leave_out_faults=True)
    about_samples = [*about_faults, *samples.findings(recorded, recording, rig)]

    def checked(judged: list[Finding], corrections: Corrections, joint: str) -> Checked:
        order = ("wrong", "doubtful", "untested", "good")
        if rig.drive == "regulator":
            judged = [replace(item, text=item.text.replace("voltages", "commands").replace("valve", "regulator"))
                     for item in judged]  # fmt: skip
        every = sorted([*about_samples, *judged], key=lambda finding: order.index(finding.status))
        return Checked(tuple(every), numbers.without_calibration(corrections, rig), joint)

    jumped = resets(samples.in_si(recording, now))
    if jumped is not None:
        # The model does not know resets, so that no channel would agree with it.
        known = joint_condition(recording, joint, lock_angle).condition
        return checked([Finding("wrong", f"{jumped.sentence} (sure)")], typed, known)
    recorded, recording = (one.slice(0.0, _LONGEST) for one in (recorded, recording))
    asked = samples.commands(recording, rig)
    condition, of_joint = _joint(recording, rig, now, typed, joint, lock_angle)
    findings = [*of_values, *asked, *of_joint, *_still(recording, now, rig)]
    if condition is None or any(finding.status == "wrong" for finding in asked):
        # Driven by wrong commands, or locked where it cannot be, the model would agree with no channel.
        return checked(findings, now if of_values else typed, "locked" if condition is None else condition.condition)
    findings += _encoder(recording, rig, condition)
    whole = samples.in_pieces(recorded, recording)
    if whole is None:
        text = f"units, wiring and delays are not tested: no piece without a hole lasts {SHORTEST:g} s"
        return checked([*findings, Finding("untested", text)], now if of_values else typed, condition.condition)
    test = _sealed if rig.valves.sealed else _driven
    with np.errstate(all="ignore"):
        found, needed = test(whole, rig, now, condition.condition, condition.lock_angle, typed)
    if wiring.guessed(rig):
        found, needed = [_uncertain(finding) for finding in found], now if of_values else typed
    return checked([*findings, *found], needed, condition.condition)


def _uncertain(finding: Finding) -> Finding:
    """A finding by the model of a rig that was never identified: doubtful at most."""
    if finding.status != "wrong":
        return finding
    text = finding.text.replace("; sure)", ")").replace(" (sure)", "")
    return replace(finding, status="doubtful", text=f"{text} (not certain: the rig file was never identified)")


def _unwrapped(recording: Recording, typed: Corrections) -> Recording:
    """A recording whose angle has no jumps of an absolute encoder, in the unit in which it was recorded."""
    if recording.angle is None or not typed.unwrap_angle:
        return recording
    steady = replace(typed, flip_angle=False, encoder_zero=0.0).angle(recording.angle)
    return replace(recording, angle=steady / UNITS["angle"][typed.angle_unit])


def _by_values(recording: Recording, typed: Corrections) -> tuple[Corrections, list[Finding]]:
    """Units that are evident from the values alone: no muscle has such a pressure, no joint such an angle."""
    now, out = typed, []
    given = replace(_NONE, pressure_unit=typed.pressure_unit, gauge=typed.gauge).options()
    possible = [plausible.possible("pressure", p) for p in (typed.pressure(recording.pressure), recording.pressure)]
    if given and possible == [False, True]:
        low, high = (np.nanquantile(recording.pressure, q) / 1e3 for q in (0.01, 0.99))
        text = f"the recorded pressures are {low:.4g} to {high:.4g} kPa absolute as they are (sure)"
        out.append(Finding("wrong", text, (), tuple(given)))
        now = replace(now, pressure_unit="Pa", gauge=False)
    if recording.angle is None or not np.isfinite(recording.angle).any():
        return now, out
    largest = float(np.nanquantile(np.abs(recording.angle), 0.99))
    factor = UNITS["angle"][typed.angle_unit]
    if largest * factor > math.pi:
        text = f"the measured angle goes up to {largest:.3g}: these are "
        option = tuple(replace(_NONE, angle_unit=typed.angle_unit).options())
        unit = "rad" if largest <= math.pi else "deg"
        if unit == "rad":
            out.append(Finding("wrong", f"{text}rad, not {typed.angle_unit} (sure)", (), option))
        else:
            out.append(Finding("wrong", f"{text}degrees, not {typed.angle_unit} (sure)", ("--angle-unit deg",)))
        now = replace(now, angle_unit=unit)
    return now, out


def _joint(
    recording: Recording, rig: Rig, now: Corrections, typed: Corrections, joint: str, lock_angle: float | None
) -> tuple[JointCondition | None, list[Finding]]:
    """Whether the joint was free or locked, compared with what was said; None where it is locked beyond its stop."""
    corrected = now.applied(recording)
    condition = joint_condition(corrected, joint, lock_angle if joint == "locked" else None, rig.joint.stop)
    low, high = (math.degrees(end) for end in ends_of(corrected.angle))
    seen = f"the measured angle goes from {low:.1f} to {high:.1f} deg, {high - low:.1f} deg in all"
    if joint == "locked" and high - low > math.degrees(_LOCKED_MOVES):
        text = (
            f"the joint moves, so it was not locked: {seen}; a locked one moves {math.degrees(_LOCKED_MOVES):g} at most"
        )
        return joint_condition(corrected, "free"), [Finding("wrong", text, (), ("--joint locked",))]
    if joint == "free" and joint_condition(corrected, stop=rig.joint.stop).condition == "locked":
        text = f"the joint seems locked, though it was called free: {seen}, while the pressures would move a free joint"
        return condition, [Finding("doubtful", text, ("--joint locked",), ("--joint free",))]
    if condition.source == "stop":
        text = f"the joint rests at its stop all the time, so the angle's sign and unit are not tested: {seen}"
        return condition, [Finding("untested", text)]
    if condition.condition == "free":
        return condition, []
    if joint == "auto" and now.angle_unit != "rad" and _follows(recording, rig, now):
        # In the given unit the motion is so small that the joint seems locked.
        return joint_condition(corrected, "free"), []
    try:
        rig.parameters("locked", condition.lock_angle)
    except BadInput as exc:
        if typed.encoder_zero:
            other, _ = _joint(recording, rig, replace(now, encoder_zero=0.0), _NONE, joint, lock_angle)
            if other is not None:
                found = numbers.finding("encoder_zero", typed, rig, f"with this zero of the encoder, {exc}")
                return other, [found]
        text = f"{exc} of rig {rig.name}: the angle has another unit or zero, or is of another joint"
        return None, [Finding("wrong", text)]
    untested = []
    if recording.angle is not None:
        untested = [Finding("untested", "the joint is locked, so sign, unit and zero of the angle are not tested")]
    measured = joint_condition(corrected, "locked").lock_angle
    if lock_angle is not None and np.isfinite(low) and abs(measured - lock_angle) > _LOCKED_MOVES:
        text = f"the lock angle was given as {math.degrees(lock_angle):.1f} deg, and {seen}"
        return condition, [Finding("doubtful", text, (), ("--lock-angle",)), *untested]
    return condition, untested


def _follows(recording: Recording, rig: Rig, now: Corrections) -> bool:
    """Whether the measured angle, in any unit, follows the voltages or the measured pressures as of a free joint."""
    assert recording.angle is not None
    corrected = now.applied(recording)
    models = (run(corrected, rig, "free", 0.0) for run in (from_pressures, predicted))
    return any(abs(correlation(recording.angle[one.rows], one.angle)) >= wiring.GOES_WITH for one in models)


def _encoder(recording: Recording, rig: Rig, condition: JointCondition) -> list[Finding]:
    """Whether the estimator accepts the recorded encoder."""
    if recording.angle_sensor is None:
        return []
    if rig.encoder is None:
        return [Finding("untested", f"topic angle_sensor: {NO_ENCODER.format(rig=rig.name)}")]
    estimator = Estimator(rig, "default", condition.condition, condition.lock_angle, "encoder")
    estimator.run(recording.stamp_ns, recording.pressure, recording.voltage, recording.angle_sensor)
    complaint = estimator.encoder_complaint
    if complaint:
        return [Finding("wrong", complaint)]
    there = int(np.isfinite(recording.angle_sensor).sum())
    return [Finding("good", f"the estimator uses the encoder: {estimator.counts.angles_used} of {there} angles")]


def _driven(
    recording: Recording, rig: Rig, now: Corrections, joint: str, lock_angle: float, typed: Corrections
) -> tuple[list[Finding], Corrections]:
    """All tests that compare the recording with the model driven by its voltages."""
    by_values = now
    findings, now = numbers.without_delays(recording, rig, joint, lock_angle, now)
    timed = numbers.delays_of(now).arranged(recording)
    model = predicted(timed, rig, joint, lock_angle)
    # The unit of the short steps is the one that was given, or that the values show.
    found = wiring.arrangement(timed, model, rig, joint, lock_angle, by_values)
    findings += found.findings
    if found.exchanged is None:
        return findings, now
    ordered = replace(timed, pressure=timed.pressure[:, ::-1]) if found.exchanged else timed
    if found.by_steps:
        pascal = replace(ordered, pressure=now.pressure(ordered.pressure),
                         angle=None if ordered.angle is None else now.angle(ordered.angle))  # fmt: skip
        model = from_pressures(pascal, rig, joint, lock_angle)
    else:
        tolerance = wiring.unit_tolerance(rig, "pressure")

        def steps(factor: float, added: float) -> float:
            absolute = replace(ordered, pressure=factor * ordered.pressure + added)
            measured, simulated = in_steps(absolute, rig, joint, lock_angle)
            return float(np.sqrt(np.mean((measured - simulated) ** 2))) if len(measured) else math.nan

        units, now = wiring.pressure_unit_of(
            ordered.pressure[model.rows], model, now, by_values, tolerance, bool(found.exchanged), steps
        )
        findings += units
    directions = wiring.directions_of(timed, model, joint)
    for direction in directions:
        tolerance = wiring.unit_tolerance(rig, direction.channel)
        units, unit = wiring.unit_of(direction, now, by_values, tolerance)
        findings += units
        now = now.replaced(**{f"{direction.channel}_unit": unit})
    wired, now = wiring.which_is_exchanged(found, directions, now, typed)
    findings += wired
    zeros, now = numbers.without_zeros(timed, model, rig, joint, now)
    findings += zeros
    constant, now = numbers.constant_error(timed, model, rig, joint, now)
    findings += constant
    if found.by_steps:
        return findings, now
    corrected = now.applied(recording)
    model = predicted(corrected, rig, joint, lock_angle, known_start=True)
    findings += wiring.fits(corrected, model, rig)
    late, now = delay_of_voltages(corrected, rig, model, joint, lock_angle, now)
    return [*findings, *late], now


def _still(recording: Recording, now: Corrections, rig: Rig) -> list[Finding]:
    """Channels that are constant or missing, so that they cannot be tested."""
    out = []
    for muscle in (0, 1):
        still = _STILL_VOLTAGE if rig.drive == "valve" else _STILL_PRESSURE
        if not rig.valves.sealed and range_of(recording.voltage[:, muscle]) < still:
            what = "voltage of valve" if rig.drive == "valve" else "command of regulator"
            out.append(Finding("doubtful", f"the {what} {muscle + 1} never changes: was it recorded?"))
        if np.nanmax(recording.pressure[:, muscle]) == np.nanmin(recording.pressure[:, muscle]):
            text = f"pressure_{muscle + 1} has one value throughout: its sensor is not connected (sure)"
            out.append(Finding("wrong", text))
        elif range_of(recording.pressure[:, muscle]) < _STILL_PRESSURE / UNITS["pressure"][now.pressure_unit]:
            if now.pressure_unit == "Pa" and np.nanmax(np.abs(recording.pressure)) > 10 * _STILL_PRESSURE:
                out.append(Finding("doubtful", f"pressure_{muscle + 1} hardly moves: is the muscle connected?"))
    if recording.angle is None:
        out.append(Finding("untested", "no angle was measured, so its sign, unit and zero are not tested"))
    if recording.torque is None and recording.external_torque is None:
        out.append(Finding("untested", "no torque was measured, so its sign and unit are not tested"))
    return out


def _sealed(
    recording: Recording, rig: Rig, now: Corrections, joint: str, lock_angle: float, typed: Corrections
) -> tuple[list[Finding], Corrections]:
    """Test a sealed joint: its pressures follow the angle, and a known charge also gives their level."""
    if recording.angle is None or range_of(now.angle(recording.angle)) < wiring.STILL_ANGLE:
        return [Finding("untested", "the joint does not move: exchanged lines and signs are not tested")], now
    p = rig.parameters("free", 0.0)
    step = max(1, round(_SEALED_S / recording.sample_period_s))
    corrected = now.applied(recording)
    assert corrected.angle is not None
    angle, pressure = corrected.angle[::step], corrected.pressure[::step]
    known = np.isfinite(angle) & np.isfinite(pressure).all(axis=1)
    angle, pressure = angle[known], pressure[known]
    # Muscle 1 gets shorter and wider as the angle grows: its pressure falls.
    rho = correlation(pressure[:, 1] - pressure[:, 0], angle)
    least = f"expected {wiring.GOES_WITH:g} or more"
    if rho <= -wiring.GOES_WITH:
        text = "the pressures follow the angle the wrong way round (sure)"
        given = replace(_NONE, swap_pressures=now.swap_pressures, flip_angle=now.flip_angle)
        if len(given.options()) == 1:
            return [Finding("wrong", text, (), tuple(given.options()))], replace(
                now, swap_pressures=False, flip_angle=False
            )
        text += (
            ": the pressure lines are exchanged, or the encoder counts in the other direction (this recording cannot "
            "tell which); type --swap-pressures or --flip-angle"
        )
        return [Finding("wrong", text)], now
    if rho < wiring.GOES_WITH:
        return [Finding("doubtful", f"the pressures hardly follow the angle (correlation {rho:.2f}, {least})")], now
    found = [Finding("good", f"the pressures follow the angle as closed chambers do (correlation {rho:.3f}, {least})")]
    if p[par.CHARGE] <= 0.0 or p[par.CHARGE + 1] <= 0.0:
        text = (
            "the rig file does not give the pressures of the sealed muscles at angle 0 (valves.charge_1, charge_2), so "
            "gauge pressures are not tested"
        )
        return [*found, Finding("untested", text)], now
    closed = np.array([[equilibrium.closed_pressure(i, value, p) for i in (0, 1)] for value in angle])
    offset = np.mean(pressure - closed, axis=0)
    atmosphere = now.atmosphere if typed.gauge else -now.atmosphere
    if np.all(np.abs(offset - atmosphere) < wiring.GAUGE_TOLERANCE):
        text = f"both pressures are {abs(offset[0]) / 1e3:.0f} and {abs(offset[1]) / 1e3:.0f} kPa "
        text += f"{'higher' if typed.gauge else 'lower'} than the charge in the rig file: these are "
        text += f"{'absolute' if typed.gauge else 'gauge'} pressures (sure)"
        needed = ((), ("--gauge",)) if typed.gauge else (("--gauge",), ())
        return [Finding("wrong", text, *needed), *found], replace(now, gauge=not typed.gauge)
    text = f"the pressures are {offset[0] / 1e3:+.1f} and {offset[1] / 1e3:+.1f} kPa off the charge in the rig file"
    status: wiring.Status = "good" if np.max(np.abs(offset)) < wiring.NEAR else "doubtful"
    return [*found, Finding(status, f"{text} ({wiring.NEAR / 1e3:.0f} at most)")], now
