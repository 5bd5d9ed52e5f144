"""The first filling of a joint with air: a short experiment at low pressure that checks the wiring.

Both muscles hold a low pressure. Then valve 1 fills its muscle a little, and valve 2 its own. At the end both are
vented. Each fault of the wiring has its own signs: which sensor rises with which valve, how far, and which way the
joint turns. The model says how far a pressure should rise. A new rig file knows a valve to a quarter only, so leaks are
found by comparing both muscles, and the other thresholds are wide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.design.exploration import RISE, Pulse
from pam_antagonist.design.information import STEP, Information
from pam_antagonist.design.optimal import Limits, Plan, resampled
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.trial import ANGLE
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig
from pam_antagonist.rig.physical import steady_voltage

Floats = NDArray[np.float64]

_LOW_SHARE, _HIGH_SHARE, _MOST_SHARE = 0.15, 0.32, 0.5
"""Low and high pressure of the experiment, and the limit, as shares of the supply's gauge pressure."""
_LEAST_RISE = 30e3
"""[Pa] A smaller rise does not show clearly which valve caused it."""
_PHASES_S = (4.0, 2.5, 2.5, 2.5, 2.5, 5.0)
"""Both at rest, valve 1 fills, rest, valve 2 fills, rest, and both are vented."""
_END_S = 0.4
"""[s] Means are taken over this time at the end of each phase."""
_FOLLOWS, _PULSE_FOLLOWS = 0.3, 0.5
"""A pressure follows a valve if it changes by this share of what the model says, or of a pulse's rise, or more."""
_LOSES = 0.8
"""A muscle leaks if its pressure, relative to the model's, is below this share of the other muscle's."""
_WEAK = 0.6
"""The supply is weak if both pressures are below this share of the model's."""
_ZERO = 12e3
"""[Pa] A sensor that differs more from the atmosphere while its muscle is vented has a wrong zero."""
_STILL, _BEFORE_S = 2e3, 0.5
"""A vented pressure that changes less than this [Pa] in this time [s] is at rest."""
TURNS = 4.4e-3
"""[rad] A quarter of a degree: a smaller turn does not show its direction."""
_PLAUSIBLE = 40e3
"""[Pa] No vented muscle has a lower absolute pressure."""
_MISSING_SHARE = 0.1


@dataclass(frozen=True)
class WiringFault:
    """Something that is not wired, or does not work, as the rig file says."""

    name: str
    sentence: str


_CROSSED = "valve 1 fills what pressure sensor 2 shows, and valve 2 what sensor 1 shows"
_SENTENCES = {
    "no_supply": "neither muscle gets air from its valve: the supply is off; check the supply and its shut-off valve",
    "stuck_valves": "both pressures stay as they are whatever the voltages: check the valves' power and signal cables",
    "crossed": f"{_CROSSED}: valves or pressure sensors are exchanged; check which hose goes where",
    "swapped_sensors": f"{_CROSSED}, but the joint turns as it should: the pressure sensors are exchanged",
    "swapped_valves": f"{_CROSSED}, and the joint turns the other way: the valves (or their cables) are exchanged",
    "stuck_valve": "the pressure of muscle {number} stays at {level:.0f} kPa whatever its voltage: valve {number} is "
    "stuck; check its cable, then the valve",
    "stuck_valve without air": "muscle {number} gets no air while the other one does: check valve {number}, its cable "
    "and its hose",
    "dead_sensor": "pressure sensor {number} {seen}: it is dead; check its plug, its supply voltage and its channel",
    "zero": "pressure sensor {number} is {off:+.0f} kPa off while its muscle is vented: its zero is wrong, or gauge "
    "pressures are taken for absolute ones",
    "weak_supply": "both pressures reach {share:.0%} of what the model says: check the supply's pressure and the valve "
    "type in the rig file",
    "leak": "muscle {number} reaches {share:.0%} of what the other one reaches: it leaks; check its fittings and its "
    "hose with soapy water",
    "flipped_encoder": "the encoder counts against the joint: exchange its two tracks, or its sign",
    "still": "the angle hardly changes while a muscle is filled: check the encoder, and that the joint is free",
}


def _fault(name: str, i: int | None = None, **values: object) -> WiringFault:
    """The fault of a name. `i`: of a muscle, 0 or 1, with its valve and its sensor."""
    which = "" if i is None else f"_{i + 1}"
    sentence = _SENTENCES[name].format(number=0 if i is None else i + 1, **values)
    return WiringFault(f"{name.split(maxsplit=1)[0]}{which}", sentence)


def first_fill(rig: Rig, highest: float = np.inf) -> Plan:
    """Plan of the experiment. `highest`: upper limit of the pressures [Pa], absolute, if lower than the usual one."""
    air, supply = rig.atmosphere.pressure, rig.supply.pressure
    low, high, most = (air + share * (supply - air) for share in (_LOW_SHARE, _HIGH_SHARE, _MOST_SHARE))
    if highest < low + 2.0 * _LEAST_RISE:
        raise BadInput(
            f"pressures up to {highest / 1e3:.0f} kPa: too low for the first air; expected at least "
            f"{(low + 2.0 * _LEAST_RISE) / 1e3:.0f} kPa"
        )
    most = min(most, highest)
    high = min(high, 0.5 * (low + most))
    rest, fill, vent = steady_voltage(rig, low), steady_voltage(rig, high), rig.valves.voltage_min
    pairs = (rest, (fill[0], rest[1]), rest, (rest[0], fill[1]), rest, (vent, vent))
    counts = [round(seconds / rig.sample_period) for seconds in _PHASES_S]
    stop = np.pi / 2.0 if rig.joint.stop is None else rig.joint.stop
    # A vented joint falls to its stop. At this low pressure nothing breaks there.
    limits = Limits((air, most), stop * 1.1, np.inf, (vent, rig.valves.voltage_max))
    return Plan(np.repeat(pairs, counts, axis=0), rig.sample_period, "free", 0.0, limits, low, rest)


def faults(rig: Rig, pressure: Floats, angle: Floats | None, plan: Plan | None = None) -> list[WiringFault]:
    """Faults that a recording of the experiment shows; empty if there are none.

    `pressure`: measured (N, 2) [Pa], one row a sample period from the start of the experiment. `angle`: measured (N,)
    [rad]; None if it was not measured. `plan`: the experiment; default: that of :func:`first_fill` without a limit.
    """
    if found := dead_sensors(pressure):
        return found
    air = rig.atmosphere.pressure
    seen = _pulses(pressure, np.zeros(len(pressure)) if angle is None else angle, rig.sample_period)
    usual = _usual(rig, plan or first_fill(rig))
    if found := _of_valves(seen, usual, _FOLLOWS, air):
        return found
    zeros = _zeros(pressure, rig)
    full = [(one.level[i] + one.rise[i] - air) / (model.level[i] + model.rise[i] - air)
            for i, (one, model) in enumerate(zip(seen, usual, strict=True))]  # fmt: skip
    lost = [] if zeros else _lost(np.array(full))
    encoder = [] if angle is None else _encoder(seen, usual)
    # A muscle that leaks may not move the joint at all.
    return [*zeros, *lost, *(fault for fault in encoder if not (lost and fault.name == "still"))]


def pulse_faults(rig: Rig, recording: Recording, pulses: Sequence[Pulse]) -> list[WiringFault]:
    """Faults that the recording of :class:`FirstAir` shows, of a guessed rig file; empty if there are none."""
    if found := dead_sensors(recording.pressure):
        return found
    usual = [Pulse(np.full(2, RISE), turned, np.full(2, np.inf)) for turned in (1.0, -1.0)]
    found = _of_valves(pulses, usual, _PULSE_FOLLOWS, rig.atmosphere.pressure)
    if not any(pulse.rise[i] > _PULSE_FOLLOWS * RISE for i, pulse in enumerate(pulses)):
        return found
    flipped = [_fault("flipped_encoder")] if _sign(pulses, usual) < 0.0 else []
    return [*found, *_zeros(recording.pressure, rig), *flipped]


def turns_visibly(rig: Rig, plan: Plan) -> bool:
    """Whether the experiment turns the joint far enough to show the encoder's sign; the lowest pressures do not."""
    return all(abs(pulse.turned) > 2.0 * TURNS for pulse in _usual(rig, plan))


def _usual(rig: Rig, plan: Plan) -> list[Pulse]:
    """What the model's joint shows of each valve."""
    work = Information(rig, ())
    voltage = resampled(plan.voltage, plan.period, STEP, plan.duration)
    shown = work.along(work.start((plan.pressure, plan.pressure), np.array(plan.rest)), voltage).shown
    return _pulses(shown[:, 2:], shown[:, ANGLE], STEP)


def _pulses(pressure: Floats, angle: Floats, period: float) -> list[Pulse]:
    """What each valve does in the experiment, by the means at the end of each phase."""
    ends = np.cumsum(_PHASES_S)
    parts = [slice(round((end - _END_S) / period), round(end / period)) for end in ends]
    pressures, angles = ([np.nanmean(values[part], axis=0) for part in parts] for values in (pressure, angle))
    return [
        Pulse(pressures[k] - 0.5 * (pressures[k - 1] + pressures[k + 1]), angles[k] - angles[k - 1], pressures[0])
        for k in (1, 3)
    ]


def dead_sensors(pressure: Floats) -> list[WiringFault]:
    """Faults of sensors whose pressures (N, 2) [Pa] are missing, impossible or constant; empty if there are none."""
    return [fault for i in (0, 1) for fault in _dead(i, pressure[:, i])]


def _dead(i: int, values: Floats) -> list[WiringFault]:
    missing = float(np.mean(~np.isfinite(values)))
    if missing > _MISSING_SHARE:
        return [_fault("dead_sensor", i, seen=f"shows nothing in {missing:.0%} of the samples")]
    middle = float(np.nanmedian(values)) / 1e3
    if middle < _PLAUSIBLE / 1e3:
        return [_fault("dead_sensor", i, seen=f"shows {middle:.0f} kPa absolute, which no muscle has")]
    if np.ptp(values[np.isfinite(values)][len(values) // 4 :]) == 0.0:
        return [_fault("dead_sensor", i, seen=f"shows {middle:.1f} kPa all the time, without noise")]
    return []


def _of_valves(seen: Sequence[Pulse], usual: Sequence[Pulse], share: float, air: float) -> list[WiringFault]:
    """Faults that show in which sensor follows which valve.

    `usual`: what the model's joint shows. A sensor follows a valve if it changes by this share of what is usual, or
    more. `air`: pressure of the surroundings [Pa].
    """
    # A row for each valve, a column for each sensor.
    follows = np.array(
        [one.rise > share * model.rise[i] for i, (one, model) in enumerate(zip(seen, usual, strict=True))]
    )
    level = seen[0].level
    airless = level - air < 0.5 * (usual[0].level - air)
    if not follows.any():
        return [_fault("no_supply" if np.all(airless) else "stuck_valves")]
    if np.array_equal(follows, [[False, True], [True, False]]):
        sign = _sign(seen, usual)
        return [_fault("crossed" if not sign else "swapped_sensors" if sign > 0.0 else "swapped_valves")]
    return [
        _fault("stuck_valve without air" if airless[i] else "stuck_valve", i, level=level[i] * 1e-3)
        for i in (0, 1)
        if not follows[i, i]
    ]


def _zeros(pressure: Floats, rig: Rig) -> list[WiringFault]:
    """Sensors with a wrong zero, judged at the end, once both muscles are vented and at rest."""
    size, before = (max(round(seconds / rig.sample_period), 1) for seconds in (_END_S, _BEFORE_S))
    vented = np.nanmean(pressure[-size:], axis=0)
    still = np.abs(vented - np.nanmean(pressure[-size - before : -before], axis=0)) < _STILL
    off = vented - (rig.command_limits[0] if rig.drive == "regulator" else rig.atmosphere.pressure)
    return [_fault("zero", i, off=off[i] / 1e3) for i in (0, 1) if still[i] and abs(off[i]) > _ZERO]


def _lost(full: Floats) -> list[WiringFault]:
    """Faults of the supply and of fittings, by the pressures that were reached (2,), as shares of the model's."""
    weaker = int(np.argmin(full))
    if np.all(full < _WEAK):
        return [_fault("weak_supply", share=np.max(full))]
    share = full[weaker] / full[1 - weaker]
    return [_fault("leak", weaker, share=share)] if share < _LOSES else []


def _sign(seen: Sequence[Pulse], usual: Sequence[Pulse]) -> float:
    """Whether the joint turns as usual: 1, the other way: −1, or too little to say: 0."""
    turned, model = (np.array([pulse.turned for pulse in pulses]) for pulses in (seen, usual))
    if not (np.all(np.abs(turned) > TURNS) and np.all(np.abs(model) > TURNS)):
        return 0.0
    return float(np.sign(np.sum(turned * model)))


def _encoder(seen: Sequence[Pulse], usual: Sequence[Pulse]) -> list[WiringFault]:
    if sign := _sign(seen, usual):
        return [_fault("flipped_encoder")] if sign < 0.0 else []
    moves = all(abs(pulse.turned) > 2.0 * TURNS for pulse in usual)
    return [_fault("still")] if moves and not any(abs(pulse.turned) > TURNS for pulse in seen) else []
