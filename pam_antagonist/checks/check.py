"""Check a recording against the model of its rig.

The recorded voltages drive the model. The measurements then agree with the model, either directly or after a
correction: gauge pressures, another unit, exchanged lines or valves, an encoder that counts the other way, voltages
that are stamped early. Correlations find the correction. They hardly depend on the rig's parameters, so the check works
before any identification.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist.checks import regulators, wiring
from pam_antagonist.checks.delay import delay_of_voltages
from pam_antagonist.checks.prediction import correlation, predicted, range_of
from pam_antagonist.checks.wiring import Finding
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator
from pam_antagonist.model import equilibrium
from pam_antagonist.model import parameters as par
from pam_antagonist.recording import Recording
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.recording.joint import JointCondition, joint_condition
from pam_antagonist.recording.resets import resets
from pam_antagonist.recording.units import UNITS
from pam_antagonist.recording.wrong_unit import STANDARD_ATMOSPHERE
from pam_antagonist.rig import NO_ENCODER, Rig
from pam_antagonist.shown import Shown

Floats = NDArray[np.float64]

_STILL_VOLTAGE, _STILL_PRESSURE = 0.05, 2e3
"""[V, Pa] Channels that move less count as constant."""
_CLOCKS_APART = 0.1
"""[s] Topics whose delays against the recorder's clock differ by more are stamped by different clocks."""
_OTHER_RATE = 1.05
"""Sample periods that differ by more than this factor are reported."""
SHORTEST = 5.0
"""[s] A shorter recording shows too little for these tests."""
_SEALED_S = 0.05
"""[s] Distance of the compared samples of a sealed joint, which moves slowly."""
_LONGEST = 120.0
"""[s] Only this much of a recording is tested; more does not improve the result."""


@dataclass(frozen=True, repr=False)
class Checked(Shown):
    """A checked recording.

    Attributes:
        findings: the worst first.
        corrections: all corrections that were found.
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


def check_recording(recording: Recording, rig: Rig, joint: str = "auto", lock_angle: float | None = None) -> Checked:
    """Compare a recording with the model of its rig, driven by the recorded voltages.

    Args:
        recording: read without judging its values (``read_bag(..., judge=False)``), and without corrections.
        rig: the rig.
        joint: ``free``, ``locked`` or ``auto`` (detected).
        lock_angle: of a locked joint [rad], where it is known.

    Returns:
        The findings, with corrections as command line options.

    Raises:
        BadInput: a recording that is too short, has no finite voltages or pressures, or has another drive than the
            rig.
    """
    name = recording.path.name
    recording.driven_by(rig.drive)
    if recording.duration_s < SHORTEST:
        raise BadInput(f"{name}: {recording.duration_s:.1f} s is too short to check; expected {SHORTEST:g} s or more")
    for what, values in (
        ("voltages" if rig.drive == "valve" else "commands", recording.voltage),
        ("pressures", recording.pressure),
    ):
        if not np.isfinite(values).all(axis=1).any():
            raise BadInput(f"{name}: holds no finite {what}")
    jumped = resets(recording)
    if jumped is not None:
        # The model does not know resets, so that no channel would agree with it.
        joint = joint_condition(recording, joint, lock_angle).condition
        return Checked((Finding("wrong", f"{jumped.sentence} (sure)"),), Corrections(), joint)
    recording = recording.slice(0.0, _LONGEST)
    asked = regulators.commands(recording, rig)
    if any(finding.status == "wrong" for finding in asked):
        # Driven by wrong commands, the model would agree with no channel.
        return Checked(tuple(asked), Corrections(), joint_condition(recording, joint, lock_angle).condition)
    now, unit_findings = _units_by_size(recording)
    condition = joint_condition(now.applied(recording), joint, lock_angle if joint == "locked" else None)
    findings = [*asked, *unit_findings, *_clocks(recording), *_rate(recording, rig), *_still(recording, now, rig)]
    findings += _encoder(recording, rig, condition)
    if rig.valves.sealed:
        found, now = _sealed(recording, rig, now)
    else:
        found, now = _driven(recording, rig, now, condition.condition, condition.lock_angle)
    order = ("wrong", "doubtful", "untested", "good")
    every = sorted([*findings, *found], key=lambda f: order.index(f.status))
    if rig.drive == "regulator":
        every = [replace(item, text=item.text.replace("voltages", "commands").replace("valve", "regulator"))
                 for item in every]  # fmt: skip
    return Checked(tuple(every), now, condition.condition)


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
    return [Finding("good", f"the estimator uses the encoder: {estimator.counts.angles_used} angles")]


def _driven(
    recording: Recording, rig: Rig, now: Corrections, joint: str, lock_angle: float
) -> tuple[list[Finding], Corrections]:
    """All tests that compare the recording with the model driven by its voltages."""
    model = predicted(recording, rig, joint, lock_angle)
    findings, exchanged = wiring.arrangement(recording, model)
    if exchanged is None:
        return findings, now
    pressures = recording.pressure[model.rows][:, ::-1] if exchanged else recording.pressure[model.rows]
    found, now = wiring.pressure_unit_of(pressures, model, now)
    findings += found
    directions = wiring.directions_of(recording, model, now, joint)
    found, now = wiring.which_is_exchanged(exchanged, directions, now)
    findings += found
    corrected = now.applied(recording)
    model = predicted(corrected, rig, joint, lock_angle, known_start=True)
    findings += wiring.fits(corrected, model)
    found, now = delay_of_voltages(corrected, rig, model, joint, lock_angle, now)
    return [*findings, *found], now


def _units_by_size(recording: Recording) -> tuple[Corrections, list[Finding]]:
    """Units that are evident from the values alone: an angle beyond half a turn is not in rad."""
    if recording.angle is None or not np.isfinite(recording.angle).any():
        return Corrections(), []
    largest = float(np.nanquantile(np.abs(recording.angle), 0.99))
    if largest <= math.pi:
        return Corrections(), []
    corrections = Corrections(angle_unit="deg")
    text = f"the measured angle goes up to {largest:.3g}: these are degrees, not rad (sure)"
    return corrections, [Finding("wrong", text, tuple(corrections.options()))]


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


def _clocks(recording: Recording) -> list[Finding]:
    """Whether one clock stamps all topics, by their delays against the recorder's clock."""
    delays = {
        name: float(np.median(arrival.log_ns - arrival.stamp_ns)) * 1e-9
        for name, arrival in recording.received_ns.items()
        if len(arrival.stamp_ns) > 1 and name in ("pressure_1", "pressure_2", "valve_state", "measured_joint_states")
    }
    if len(delays) < 2:
        return [Finding("untested", "clocks: the bag does not tell when its messages were received")]
    first, last = min(delays, key=lambda name: delays[name]), max(delays, key=lambda name: delays[name])
    apart = delays[last] - delays[first]
    if apart <= _CLOCKS_APART:
        return [Finding("good", f"all topics are stamped by one clock (within {1e3 * apart:.0f} ms)")]
    text = (
        f"{last} is stamped {apart:.3g} s earlier than {first} for messages that came at the same time: the two are "
        "stamped by different clocks"
    )
    return [Finding("doubtful", text)]


def _rate(recording: Recording, rig: Rig) -> list[Finding]:
    """The sample rate, compared with the rig file's."""
    period = recording.sample_period_s
    spread = np.quantile(np.diff(recording.stamp_ns) * 1e-9, [0.05, 0.95]) if len(recording) > 2 else (period, period)
    text = f"{1.0 / period:.4g} samples a second"
    if spread[1] > 1.5 * period or spread[0] < 0.5 * period:
        text += f", unevenly: nine in ten are {1e3 * spread[0]:.3g} to {1e3 * spread[1]:.3g} ms apart"
    ratio = period / rig.sample_period
    if 1.0 / _OTHER_RATE <= ratio <= _OTHER_RATE:
        return [Finding("good", text)]
    return [Finding("good", f"{text}; the rig file has {1.0 / rig.sample_period:.4g} (sample_period)")]


def _sealed(recording: Recording, rig: Rig, now: Corrections) -> tuple[list[Finding], Corrections]:
    """Test a sealed joint: its pressures follow the angle, and a known charge also gives their level."""
    if recording.angle is None or range_of(now.angle(recording.angle)) < wiring.STILL_ANGLE:
        return [Finding("untested", "the joint does not move: exchanged lines and signs are not tested")], now
    p = rig.parameters("free", 0.0)
    step = max(1, round(_SEALED_S / recording.sample_period_s))
    angle, pressure = now.angle(recording.angle)[::step], recording.pressure[::step]
    known = np.isfinite(angle) & np.isfinite(pressure).all(axis=1)
    angle, pressure = angle[known], pressure[known]
    # Muscle 1 gets shorter and wider as the angle grows: its pressure falls.
    rho = correlation(pressure[:, 1] - pressure[:, 0], angle)
    if rho <= -wiring.GOES_WITH:
        text = (
            "the pressures follow the angle the wrong way round (sure): the pressure lines are exchanged, or the "
            "encoder counts in the other direction (this recording cannot tell which); type --swap-pressures or "
            "--flip-angle"
        )
        return [Finding("wrong", text)], now
    if rho < wiring.GOES_WITH:
        return [Finding("doubtful", f"the pressures hardly follow the angle (correlation {rho:.2f})")], now
    found = [Finding("good", f"the pressures follow the angle as closed chambers do (correlation {rho:.3f})")]
    if p[par.CHARGE] <= 0.0 or p[par.CHARGE + 1] <= 0.0:
        return [
            *found,
            Finding(
                "untested",
                "the rig file does not give the pressures of the sealed muscles at angle 0 (valves.charge_1, "
                "charge_2), so gauge pressures are not tested",
            ),
        ], now
    closed = np.array([[equilibrium.closed_pressure(i, value, p) for i in (0, 1)] for value in angle])
    offset = np.mean(pressure - closed, axis=0)
    if np.all(np.abs(offset + STANDARD_ATMOSPHERE) < wiring.GAUGE_TOLERANCE):
        text = (
            f"both pressures are {-offset[0] / 1e3:.0f} and {-offset[1] / 1e3:.0f} kPa lower than the charge in the "
            "rig file: these are gauge pressures (sure)"
        )
        return [Finding("wrong", text, ("--gauge",)), *found], replace(now, gauge=True)
    text = f"the pressures are {offset[0] / 1e3:+.1f} and {offset[1] / 1e3:+.1f} kPa off the charge in the rig file"
    return [*found, Finding("good" if np.max(np.abs(offset)) < wiring.FAR_OFF else "doubtful", text)], now
