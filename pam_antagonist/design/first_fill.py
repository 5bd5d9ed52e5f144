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
from pam_antagonist.design.optimal import Limits, Plan
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
_SETTLE_S, _HOLD_S, _VENT_S = 4.0, 2.5, 5.0
_END_S = 0.4
"""[s] Means are taken over this time at the end of each phase."""
_FOLLOWS = 0.3
"""A pressure follows a valve if it changes by this share of what the model says, or more."""
_LOSES = 0.8
"""A muscle leaks if its pressure, relative to the model's, is below this share of the other muscle's."""
_WEAK = 0.6
"""The supply is weak if both pressures are below this share of the model's."""
_ZERO = 12e3
"""[Pa] A sensor that differs more from the atmosphere while its muscle is vented has a wrong zero."""
_STILL = 2e3
"""[Pa] A vented pressure that changes less than this in half a second is at rest."""
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
    rest, fill = np.array(steady_voltage(rig, low)), np.array(steady_voltage(rig, high))
    vent = rig.valves.voltage_min
    pairs = [
        (_SETTLE_S, rest), (_HOLD_S, np.array([fill[0], rest[1]])), (_HOLD_S, rest),
        (_HOLD_S, np.array([rest[0], fill[1]])), (_HOLD_S, rest), (_VENT_S, np.array([vent, vent])),
    ]  # fmt: skip
    rows = [np.tile(pair, (round(seconds / rig.sample_period), 1)) for seconds, pair in pairs]
    stop = np.pi / 2.0 if rig.joint.stop is None else rig.joint.stop
    # A vented joint falls to its stop. At this low pressure nothing breaks there.
    limits = Limits((air, most), stop * 1.1, np.inf, (rig.valves.voltage_min, rig.valves.voltage_max))
    first, second = float(rest[0]), float(rest[1])
    return Plan(np.concatenate(rows), rig.sample_period, "free", 0.0, limits, low, (first, second))


def faults(rig: Rig, pressure: Floats, angle: Floats | None, plan: Plan | None = None) -> list[WiringFault]:
    """Faults that a recording of the experiment shows; empty if there are none.

    `pressure`: measured (N, 2) [Pa], one row a sample period from the start of the experiment. `angle`: measured (N,)
    [rad]; None if it was not measured. `plan`: the experiment; default: that of :func:`first_fill` without a limit.
    """
    if found := dead_sensors(pressure):
        return found
    ends = _ends()
    seen = _means(pressure, rig.sample_period, ends)
    course = _course(rig, plan or first_fill(rig))
    expected = _means(course[:, 1:], STEP, ends)
    # Change of each sensor (columns) with each valve (rows), relative to the model's change in the valve's own muscle.
    rise = np.array([seen[1] - 0.5 * (seen[0] + seen[2]), seen[3] - 0.5 * (seen[2] + seen[4])])
    wanted = np.array([expected[1, 0] - expected[0, 0], expected[3, 1] - expected[2, 1]])
    follows = rise / wanted[:, None] > _FOLLOWS
    air = rig.atmosphere.pressure
    gauge, usual = seen[0] - air, expected[0] - air
    turned = None
    if angle is not None:
        turned = _turns(angle, rig.sample_period, ends), _turns(course[:, 0], STEP, ends)
    if found := _of_valves(follows, gauge, usual, seen[:5].mean(axis=0) * 1e-3, turned):
        return found
    zeros = _zeros(pressure, rig, ends)
    full = (np.array([seen[1, 0], seen[3, 1]]) - air) / (np.array([expected[1, 0], expected[3, 1]]) - air)
    lost = [] if zeros else _lost(full)
    # A muscle that leaks may not move the joint at all.
    return [*zeros, *lost, *(fault for fault in _encoder(turned) if not (lost and fault.name == "still"))]


def turns_visibly(rig: Rig, plan: Plan) -> bool:
    """Whether the experiment turns the joint far enough to show the encoder's sign; the lowest pressures do not."""
    return bool(np.all(np.abs(_turns(_course(rig, plan)[:, 0], STEP, _ends())) > 2.0 * TURNS))


def _ends() -> Floats:
    """When each phase ends [s]."""
    return np.cumsum([_SETTLE_S, _HOLD_S, _HOLD_S, _HOLD_S, _HOLD_S, _VENT_S])


def _course(rig: Rig, plan: Plan) -> Floats:
    """Simulated angle [rad] and pressures [Pa] (M, 3), a row an integration step."""
    work = Information(rig, ())
    index = (np.arange(round(plan.duration / STEP)) * STEP / plan.period + 1e-6).astype(np.int64)
    course = work.along(work.start((plan.pressure, plan.pressure), np.array(plan.rest)), plan.voltage[index])
    return np.column_stack([course.shown[:, ANGLE], course.shown[:, 2:]])


def _means(values: Floats, period: float, ends: Floats) -> Floats:
    """Means at the ends of the phases, (P, C)."""
    last = [slice(round((end - _END_S) / period), round(end / period)) for end in ends]
    return np.array([np.nanmean(values[part], axis=0) for part in last])


def _turns(angle: Floats, period: float, ends: Floats) -> Floats:
    """How far the joint turns while valve 1 fills its muscle, and while valve 2 does (2,) [rad]."""
    there = _means(angle[:, None], period, ends)[:, 0]
    return np.array([there[1] - there[0], there[3] - there[2]])


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


def pulse_faults(rig: Rig, recording: Recording, pulses: Sequence[Pulse]) -> list[WiringFault]:
    """Faults that the recording of :class:`FirstAir` shows, of a guessed rig file; empty if there are none."""
    if found := dead_sensors(recording.pressure):
        return found
    rise = np.array([pulse.rise for pulse in pulses])
    follows = rise > 0.5 * RISE
    turned = np.array([pulse.turned for pulse in pulses])
    shown = turned, np.array([1.0, -1.0])
    found = _of_valves(follows, np.zeros(2), np.ones(2), pulses[0].level * 1e-3, shown)
    if not follows.diagonal().any():
        return found
    for i in (0, 1):
        off = float(np.median(recording.pressure[-max(round(_END_S / rig.sample_period), 1) :, i]))
        off -= rig.command_limits[0] if rig.drive == "regulator" else rig.atmosphere.pressure
        if abs(off) > _ZERO:
            found.append(_fault("zero", i, off=off / 1e3))
    return [*found, *(_encoder(shown) if np.all(np.abs(turned) > TURNS) else [])]


def _of_valves(
    follows: NDArray[np.bool_], gauge: Floats, usual: Floats, level: Floats, turned: tuple[Floats, Floats] | None
) -> list[WiringFault]:
    """Faults that show in which sensor (columns) follows which valve (rows).

    `gauge`: pressures before (2,) [Pa], and what is usual; `level`: absolute ones (2,) [kPa]. `turned`: how far the
    joint turned with each valve, and the model's joint; None where the angle was not measured.
    """
    if not follows.any():
        return [_fault("no_supply" if np.all(gauge < 0.5 * usual) else "stuck_valves")]
    if follows[0, 1] and follows[1, 0] and not follows[0, 0] and not follows[1, 1]:
        if turned is None or not _shows(turned):
            return [_fault("crossed")]
        return [_fault("swapped_sensors" if _sign(turned) > 0 else "swapped_valves")]
    found = []
    for i in (0, 1):
        if not follows[i, i]:
            airless = gauge[i] < 0.5 * usual[i]
            found.append(_fault("stuck_valve without air" if airless else "stuck_valve", i, level=level[i]))
    return found


def _zeros(pressure: Floats, rig: Rig, ends: Floats) -> list[WiringFault]:
    """Sensors with a wrong zero, judged once both muscles are vented and at rest."""
    vented, before = _means(pressure, rig.sample_period, np.array([ends[-1], ends[-1] - 0.5]))
    off, still = vented - rig.atmosphere.pressure, np.abs(vented - before) < _STILL
    return [_fault("zero", i, off=off[i] / 1e3) for i in (0, 1) if still[i] and abs(off[i]) > _ZERO]


def _lost(full: Floats) -> list[WiringFault]:
    weaker = int(np.argmin(full))
    if np.all(full < _WEAK):
        return [_fault("weak_supply", share=np.max(full))]
    share = full[weaker] / full[1 - weaker]
    return [_fault("leak", weaker, share=share)] if share < _LOSES else []


def _shows(turned: tuple[Floats, Floats]) -> bool:
    seen, model = turned
    return bool(np.all(np.abs(seen) > TURNS) and np.all(np.abs(model) > TURNS) and np.isfinite(seen).all())


def _sign(turned: tuple[Floats, Floats]) -> float:
    seen, model = turned
    return float(np.sign(np.sum(seen * model)))


def _encoder(turned: tuple[Floats, Floats] | None) -> list[WiringFault]:
    if turned is None:
        return []
    if _shows(turned):
        return [_fault("flipped_encoder")] if _sign(turned) < 0 else []
    still = np.all(np.abs(turned[1]) > 2.0 * TURNS) and not np.any(np.abs(turned[0]) > TURNS)
    return [_fault("still")] if still else []
