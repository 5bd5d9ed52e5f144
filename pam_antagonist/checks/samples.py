"""What is known of the samples themselves, without a model: issues of reading, holes, held rows, clocks and rate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.checks.wiring import Finding, Status
from pam_antagonist.estimation.possible import bounds
from pam_antagonist.recording import Recording
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.recording.faults import faults_of, in_words, masked
from pam_antagonist.recording.plausible import MIN_PRESSURE, UNITS
from pam_antagonist.recording.rows import slow, slow_sentence
from pam_antagonist.recording.stamps import CLOCKS_APART, shortest_hole
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

SHORTEST = 5.0
"""[s] A shorter recording, or piece of one, shows too little for the tests against the model."""
_MISSING = 0.005
"""Larger shares of samples that are missing outside of holes, or miss a value, are doubtful."""
_LISTED = 3
"""Holes, and stretches of held rows, that are listed one by one: the longest."""
_HELD_S, _HELD_ROWS = 0.1, 10
"""All measured values repeat over a stretch of at least both: nothing was measured there."""
_OTHER_RATE = 1.05
"""Sample periods that differ by more than this factor are reported."""
_UNEVEN = 1.5
"""Nine in ten samples are apart by the period within this factor."""


def findings(recorded: Recording, recording: Recording, rig: Rig) -> list[Finding]:
    """Findings about the samples, those that change results most first.

    `recorded`: with the readings that are no measurement.
    """
    drive = "valve_state" if recording.drive == "valve" else "pressure_state"
    missing = _missing(recorded, drive)
    out = []
    for issue in recording.issues:
        # Holes and missing samples are counted below, and a field without values is reported as not tested.
        if issue.kind not in ("hole", "missing") and " holds no " not in issue:
            out.append(Finding("untested" if issue.kind in ("remark", "resampled") else "doubtful", str(issue)))
    slower = [Finding("untested", slow_sentence(name, again)) for name, again in slow(recording).items()]
    return [*out, *missing, *_held(recording), *slower, *_clocks(recording, drive), *_rate(recording, rig)]


def holes(recording: Recording) -> list[tuple[int, int]]:
    """Rows before and after each hole: places where pressures or voltages are missing, but no episode begins."""
    whole = np.flatnonzero(np.isfinite(np.column_stack([recording.voltage, recording.pressure])).all(axis=1))
    apart = np.diff(recording.stamp_ns[whole]) * 1e-9
    if not len(apart):
        return []
    at = np.flatnonzero(apart > shortest_hole(float(np.median(apart))))
    pairs = [(int(whole[k]), int(whole[k + 1])) for k in at]
    begins = {one.start for one in recording.episodes}
    return [(before, after) for before, after in pairs if not begins & set(range(before + 1, after + 1))]


_FEW = 0.001
"""So small a share of faults is kept, since the estimator gates it."""


def in_si(recording: Recording, now: Corrections) -> Recording:
    """A recording in SI units, otherwise as it was recorded."""
    units = {name: getattr(now, name) for name in ("pressure_unit", "gauge", "angle_unit", "torque_unit", "atmosphere")}
    return Corrections(**units).applied(recording)


def faulty(recording: Recording, now: Corrections) -> tuple[Recording, list[Finding]]:
    """A recording without the readings that are no measurement, and what to do about them.

    `now`: gives the units in which it was recorded.
    """
    found = faults_of(in_si(recording, now))
    if not found:
        return recording, []
    options = () if now.leave_out_faults else tuple(Corrections(leave_out_faults=True).options())
    out = []
    for kind, text in in_words(found, recording.time_s):
        shares = [float(one.fault.rows.mean()) for one in found if one.fault.kind == kind]
        sure = kind != "held" and max(shares) > _FEW and not text.startswith("measured angle reads")
        status: Status = "untested" if not options else "wrong" if sure else "doubtful"
        out.append(Finding(status, text if options else f"{text}: left out", options))
    return masked(recording, found), out


def in_pieces(recorded: Recording, recording: Recording) -> Recording | None:
    """A recording as episodes that no hole interrupts, for the tests against the model.

    `recorded`: it with the readings that are no measurement; they are no holes.
    """
    cuts = holes(recorded)
    if not cuts:
        return recording
    bounds = sorted({0, len(recording), *(one.start for one in recording.episodes), *(after for _, after in cuts)})
    last_before = {after: before for before, after in cuts}
    rows = [(begin, last_before.get(end, end - 1) + 1) for begin, end in zip(bounds, bounds[1:], strict=False)]
    if recording.episode_ns is None:
        rows = [(a, b) for a, b in rows if (recording.stamp_ns[b - 1] - recording.stamp_ns[a]) * 1e-9 >= SHORTEST]
    rows = [(a, b) for a, b in rows if b > a]
    if not rows:
        return None
    kept = recording.take(np.concatenate([np.arange(a, b) for a, b in rows]))
    begins = recording.stamp_ns[[a for a, _ in rows]]
    return replace(kept, signals={}, estimate=None, reference=None, episode_ns=begins)


def _missing(recording: Recording, drive: str) -> list[Finding]:
    """Holes, and the share of single missing samples and values."""
    time = recording.time_s
    cuts = holes(recording)
    longest = sorted(sorted(cuts, key=lambda cut: time[cut[0]] - time[cut[1]])[:_LISTED])
    out = []
    for before, after in longest:
        inside = slice(before + 1, after)
        lacks = [
            name
            for name, values in (("pressure_1", recording.pressure[:, 0]), ("pressure_2", recording.pressure[:, 1]),
                                 (drive, recording.voltage[:, 0]))
            if not np.isfinite(values[inside]).any()
        ]  # fmt: skip
        what = "no samples" if after == before + 1 else f"no {' and no '.join(lacks)}" if lacks else "no whole sample"
        text = f"a hole: {what} for {time[after] - time[before]:.3f} s, from {time[before]:.3f} s on"
        out.append(Finding("doubtful", f"{text} (of {recording.duration_s:.1f} s)"))
    if len(cuts) > _LISTED:
        total = sum(time[after] - time[before] for before, after in cuts)
        out.append(
            Finding("doubtful", f"{len(cuts) - _LISTED} more holes; all {len(cuts)} last {total:.3g} s together")
        )
    apart = np.diff(recording.stamp_ns) * 1e-9
    period = recording.sample_period_s
    single = apart[(apart > _UNEVEN * period) & (apart <= shortest_hole(period))]
    missing = int(np.rint(single / period - 1.0).sum())
    lacking = ~np.asarray(np.isfinite(np.column_stack([recording.voltage, recording.pressure])).all(axis=1))
    for before, after in cuts:
        lacking[before + 1 : after] = False
    share = (missing + int(lacking.sum())) / (len(recording) + missing)
    text = (
        f"{missing} samples are missing one by one and {int(lacking.sum())} lack a pressure or the {drive}, "
        f"{100.0 * share:.2g} % of all"
    )
    if share > _MISSING:
        out.append(Finding("doubtful", f"{text}, expected {100.0 * _MISSING:g} % at most"))
    elif not cuts:
        text = "no sample is missing" if share == 0.0 else text
        text += f" ({100.0 * _MISSING:g} % at most), and no hole is longer than {1e3 * shortest_hole(period):.3g} ms"
        out.append(Finding("good", text))
    return out


def _held(recording: Recording) -> list[Finding]:
    """Stretches over which every measured value repeats, as a logger writes them that holds the last values."""
    columns = [recording.pressure, *(v[:, None] for v in (recording.angle, recording.torque) if v is not None)]
    measured = np.column_stack(columns)
    same = np.concatenate([[False], (measured[1:] == measured[:-1]).all(axis=1), [False]])
    edges = np.flatnonzero(np.diff(same.astype(np.int8)))
    time = np.append(recording.time_s, recording.duration_s)
    least = max(_HELD_S, _HELD_ROWS * recording.sample_period_s)
    runs = [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if time[b] - time[a] >= least]
    if not runs or same.mean() > 0.5:
        return []
    longest = sorted(sorted(runs, key=lambda run: time[run[0]] - time[run[1]])[:_LISTED])
    where = ", ".join(f"for {time[b] - time[a]:.3f} s from {time[a]:.3f} s on" for a, b in longest)
    more = f" and at {len(runs) - _LISTED} more places" if len(runs) > _LISTED else ""
    text = f"all measured values stay exactly the same {where}{more}: held values, as nothing was measured there"
    return [Finding("doubtful", text)]


def _clocks(recording: Recording, drive: str) -> list[Finding]:
    """Whether one clock stamps all topics, by their delays against the recorder's clock."""
    if any(issue.kind == "clock" for issue in recording.issues):
        return []
    delays = {
        name: float(np.median(arrival.log_ns - arrival.stamp_ns)) * 1e-9
        for name, arrival in recording.received_ns.items()
        if len(arrival.stamp_ns) > 1 and name in ("pressure_1", "pressure_2", drive, "measured_joint_states")
    }
    if len(delays) < 2:
        return [Finding("untested", "clocks: the bag does not tell when its messages were received")]
    first, last = min(delays, key=lambda name: delays[name]), max(delays, key=lambda name: delays[name])
    apart = delays[last] - delays[first]
    if apart <= CLOCKS_APART:
        text = f"all topics are stamped by one clock (within {1e3 * apart:.0f} ms, {1e3 * CLOCKS_APART:.0f} at most)"
        return [Finding("good", text)]
    text = f"{last} is stamped {apart:.3g} s earlier than {first} for messages that came at the same time"
    return [Finding("doubtful", f"{text}: the two are stamped by different clocks")]


def _rate(recording: Recording, rig: Rig) -> list[Finding]:
    """The sample rate, compared with the rig file's, and whether it is even."""
    period = recording.sample_period_s
    text = f"{1.0 / period:.4g} samples a second"
    usual = f"the rig file has {1.0 / rig.sample_period:.4g}"
    if max(period / rig.sample_period, rig.sample_period / period) <= _OTHER_RATE:
        out = [Finding("good", f"{text} ({usual}; within {100.0 * (_OTHER_RATE - 1.0):.0f} %)")]
    else:
        out = [Finding("untested", f"{text}; {usual} (sample_period): the recording's own rate is used")]
    low, high = np.quantile(np.diff(recording.stamp_ns) * 1e-9, [0.05, 0.95]) / period if len(recording) > 2 else (1, 1)
    if low < 1.0 / _UNEVEN or high > _UNEVEN:
        ends = f"{low * period * 1e3:.3g} to {high * period * 1e3:.3g} ms apart"
        text = f"the samples are uneven: nine in ten are {ends}, expected {1e3 * period / _UNEVEN:.3g} to "
        out.append(Finding("doubtful", f"{text}{1e3 * period * _UNEVEN:.3g}"))
    return out


_SATURATED = 0.02
"""Larger shares of samples beyond the range are reported: the regulators' output for them is not known."""
_SLACK = 1.0
"""[Pa] Rounding of a command at the end of the range."""


def commands(recording: Recording, rig: Rig) -> list[Finding]:
    """Unit, range and origin of the commands."""
    if rig.drive == "valve":
        return _voltages(recording, rig)
    unit = _unit(recording)
    if unit:
        return [Finding("wrong", f"the commanded pressures are in {unit}, expected absolute pressures in Pa (sure)")]
    out = []
    for muscle in recording.logged_commands:
        number = muscle + 1
        text = (
            f"pressure_{number} is what regulator {number} was asked for, sample by sample: the command was logged in "
            "the place of the measured pressure (sure)"
        )
        out.append(Finding("wrong", text))
    low, high = rig.command_limits
    beyond = (recording.voltage < low - _SLACK) | (recording.voltage > high + _SLACK)
    share = float(np.mean(beyond.any(axis=1)))
    if share > _SATURATED:
        text = (
            f"commands lie beyond the regulators' range, {low / 1e3:.0f} to {high / 1e3:.0f} kPa absolute, in "
            f"{100 * share:.0f} % of the samples: are these gauge pressures, or is regulator_limits wrong?"
        )
        out.append(Finding("doubtful", text))
    text = (
        f"the commanded pressures lie within the regulators' range, {low / 1e3:.0f} to {high / 1e3:.0f} kPa absolute "
        f"(beyond it: {100.0 * share:.2g} % of the samples, {100.0 * _SATURATED:g} at most)"
    )
    return out or [Finding("good", text)]


def _voltages(recording: Recording, rig: Rig) -> list[Finding]:
    """What is said of voltages that the rig's valves do not get; nothing of others."""
    low, high = bounds(rig)[2:].T
    share = float(np.mean(((recording.voltage < low) | (recording.voltage > high)).any(axis=1)))
    if share <= _SATURATED:
        return []
    least, most = (float(np.nanquantile(recording.voltage, q)) for q in (0.01, 0.99))
    own = f"{rig.valves.voltage_min:g} to {rig.valves.voltage_max:g} V"
    bipolar = least < -0.5 and rig.valves.voltage_min >= 0.0
    hint = ": with a bipolar amplifier, make the rig file with new_rig --voltage=-5:5" if bipolar else ""
    text = (
        f"the voltages go from {least:.3g} to {most:.3g} V and lie beyond those of the rig's valves, {own}, in "
        f"{100.0 * share:.0f} % of the samples{hint}"
    )
    return [Finding("doubtful", text)]


def _unit(recording: Recording) -> str:
    """The apparent unit of the commands; empty for Pa."""
    top = float(np.nanquantile(np.abs(recording.voltage), 0.99))
    measured = float(np.nanquantile(np.abs(recording.pressure), 0.99))
    if top >= MIN_PRESSURE or not top > 0.0:
        return ""
    # The unit in which commands and measured pressures agree best.
    return min(UNITS["pressure"], key=lambda unit: abs(np.log(top * UNITS["pressure"][unit] / max(measured, 1.0))))
