"""What an identification found, as numbers: the content of its ``report.json``.

Keys::

    held_out     [{name, from_s, joint, as_configured, identified, own | null}]: each recording's figures of a replay
                 (:mod:`pam_antagonist.report.replay`: ukf, model_alone, innovation) of the part that was not fitted,
                 by the rig as configured, by the identified rig, and, of several recordings, with the recording's own
                 values in place of the common ones
    coverage95   share of all measured angles and torques of the held-out parts, one mean over channels and recordings,
                 in the identified rig's 95 % interval; null where nothing was measured
    coverage95_own  the same with each recording's own values; null of a single recording
    parameters   [{name, start, value, std, relative_change, prior_std, determined, record, own: [...], own_std: [...]}]
    stages       [{name, source, values, before, after, note}], residuals by channel [rad, N m, Pa, Pa]
    correlations [{first, second, correlation}], the strong ones
    profiles     [{name, value: [...], loss: [...], low95, high95}]
    between      null, or {spread, evidence_gain, differences}: how the recordings disagree
    noise        sensors' standard deviations, declared and found
    tuning       Q, R, directions, their scale, likelihood
    starts       of the joint refinement, with their cost
    recordings   [{name, sha256, condition, told_from, samples, duration_s, fitted_until_s, topics, issues}]
    warnings     sentences
    settings     what was asked, with the seed
    software     versions
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from pam_antagonist.identification.advice import advice
from pam_antagonist.identification.directions import Direction
from pam_antagonist.identification.session import Identified, relative
from pam_antagonist.inference.trial import CHANNELS
from pam_antagonist.recording import Recording
from pam_antagonist.recording.joint import JointCondition
from pam_antagonist.report import channels
from pam_antagonist.report.replay import Replay, after, replay
from pam_antagonist.rig import Rig
from pam_antagonist.software import versions

STRONG = 0.9
"""Correlation from which on two parameters are named as a pair."""
_PAIRS = 12


@dataclass(frozen=True, eq=False)
class Judged:
    """One recording by three rigs, whole and the part that was held out.

    Attributes:
        name: of the recording.
        from_s: where the held-out part begins [s].
        whole: replays of the whole recording by name of the rig: ``as_configured``, ``identified`` and, where there are
            several recordings, ``own``.
        held: the same, judged on the held-out part alone.
    """

    name: str
    from_s: float
    whole: dict[str, Replay]
    held: dict[str, Replay]


def judge(
    recordings: Sequence[tuple[Recording, JointCondition, str]],
    found: Identified,
    progress: Callable[[str], None] | None = None,
) -> list[Judged]:
    """Run every recording from its start through the model alone and the filter, and judge what was held out.

    Args:
        recordings: as they were identified.
        found: the identification.
        progress: told which recording is being run.
    """
    out = []
    for index, (recording, state, name) in enumerate(recordings):
        if progress:
            progress(f"held-out part of {name}")
        rigs: dict[str, Rig] = {"as_configured": found.start, "identified": found.tuned.rig}
        if len(recordings) > 1:
            rigs["own"] = found.own[index]
        angle = state.lock_angle if state.condition == "locked" else None
        whole = {key: replay(recording, rig, "default", state.condition, angle) for key, rig in rigs.items()}
        begin = found.held_from[index]
        out.append(Judged(name, begin, whole, {key: after(item, begin) for key, item in whole.items()}))
    return out


def document(
    recordings: Sequence[tuple[Recording, JointCondition, str]], found: Identified, judged: Sequence[Judged]
) -> dict[str, Any]:
    """What goes into ``report.json``.

    Args:
        recordings: as they were identified.
        found: the identification.
        judged: of :func:`judge`.
    """
    options = found.options
    return {
        "held_out": [
            {
                "name": item.name,
                "from_s": item.from_s,
                "joint": item.held["identified"].report["joint"],
                **{key: _figures(item.held.get(key)) for key in ("as_configured", "identified", "own")},
            }
            for item in judged
        ],
        "coverage95": pooled_coverage(judged),
        "coverage95_own": pooled_coverage(judged, "own"),
        "parameters": parameters(found),
        "stages": [
            {
                "name": stage.name,
                "source": stage.source,
                "values": {name: {"before": old, "after": new} for name, (old, new) in stage.values.items()},
                "before": dict(zip(CHANNELS, stage.before, strict=True)),
                "after": dict(zip(CHANNELS, stage.after, strict=True)),
                "balance_nm": None
                if stage.balance is None
                else {"before": stage.balance.rms("before"), "after": stage.balance.rms("after")},
                "note": stage.note,
            }
            for stage in found.stages
        ],
        "correlations": correlations(found),
        "profiles": [
            {"name": p.name, "value": p.value, "loss": p.loss, "low95": p.low, "high95": p.high} for p in found.profiles
        ],
        "between": _between(found),
        "noise": {"declared": _sensors(found.start), "found": _sensors(found.tuned.rig)},
        "tuning": _tuning(found),
        "starts": [{"name": item.name, "cost": item.cost, "best": item.best} for item in found.starts],
        "recordings": [
            {
                **{key: item.whole["identified"].report["recording"][key] for key in ("sha256", "topics", "issues")},
                "name": item.name,
                "condition": state.condition,
                "lock_angle_rad": state.lock_angle if state.condition == "locked" else None,
                "told_from": state.told_from,
                "samples": len(recording.stamp_ns),
                "duration_s": item.whole["identified"].report["duration_s"],
                "fitted_until_s": item.from_s,
            }
            for item, (recording, state, _) in zip(judged, recordings, strict=True)
        ],
        "warnings": list(found.warnings),
        "settings": {
            "rig": found.start.name,
            "free": list(options.free),
            "frozen": list(options.frozen),
            "holdout": options.holdout,
            "starts": options.starts,
            "seed": options.seed,
        },
        "software": versions(),
    }


def _figures(item: Replay | None) -> dict[str, Any] | None:
    if item is None:
        return None
    return {key: item.report[key] for key in ("samples", "duration_s", "ukf", "model_alone", "innovation")}


def pooled_coverage(judged: Sequence[Judged], rig: str = "identified") -> float:
    """Mean over recordings and channels of the coverage of a rig's 95 % interval; NaN where there is none.

    Args:
        judged: of :func:`judge`.
        rig: ``identified``, or ``own`` for each recording's own values.
    """
    reports = [item.held[rig].report for item in judged if rig in item.held]
    shares = [channel.coverage(report) for report in reports for channel in channels.judged(report)]
    return sum(shares) / len(shares) if shares else math.nan


def parameters(found: Identified) -> list[dict[str, Any]]:
    """What became of each free parameter."""
    fit = found.fit
    values, stds, determined = fit.values, fit.std, fit.determined
    several = len(found.trials) > 1
    owns = [fit.own_values(k) for k in range(len(found.trials))] if several else []
    own_stds = [fit.own_std(k) for k in range(len(found.trials))] if several else []
    return [
        {
            "name": item.name,
            "start": item.start,
            "value": values[item.name],
            "std": stds[item.name],
            "relative_change": relative(values[item.name], item.start),
            "prior_std": item.prior_std,
            "determined": determined[item.name],
            "record": None if determined[item.name] else advice(item.name),
            "own": [own[item.name] for own in owns],
            "own_std": [own[item.name] for own in own_stds],
        }
        for item in found.free
    ]


def correlations(found: Identified) -> list[dict[str, Any]]:
    """The pairs of parameters that the data hardly tell apart, the strongest first."""
    names, matrix = [item.name for item in found.free], found.fit.correlation
    pairs = [(float(matrix[i, j]), i, j) for i in range(len(names)) for j in range(i)]
    strong = sorted((pair for pair in pairs if abs(pair[0]) >= STRONG), key=lambda pair: -abs(pair[0]))
    return [{"first": names[j], "second": names[i], "correlation": value} for value, i, j in strong[:_PAIRS]]


def _between(found: Identified) -> dict[str, Any] | None:
    if found.fit.spread is None:
        return None
    spread = {way.group: float(value) for way, value in zip(found.ways, found.fit.spread, strict=True)}
    return {
        "spread": spread,
        "evidence_gain": found.fit.evidence_gain,
        "differences": [
            {
                "name": item.name,
                "deviations": list(item.deviations),
                "largest": item.largest,
                "std": item.std,
                "certain": item.certain,
            }
            for item in found.differences
        ],
    }


def _sensors(rig: Rig) -> dict[str, float]:
    sensors = rig.sensors
    names = ("pressure_std", "angle_std", "angle_step", "torque_std", "torque_step")
    return {name: float(getattr(sensors, name)) for name in names}


def _tuning(found: Identified) -> dict[str, Any]:
    tuned = found.tuned
    now, before = tuned.rig.tuning("default"), found.start.tuning("default")
    return {
        "process": list(now.process),
        "process_before": list(before.process),
        "measurement": list(now.measurement),
        "measurement_before": list(before.measurement),
        "log_likelihood_a_sample": {"before": tuned.likelihood[0], "after": tuned.likelihood[1]},
        "evaluations": tuned.evaluations,
        "scale": tuned.scale,
        "scale_from_reference": tuned.calibrated,
        "directions": [
            {
                "name": item.name,
                "angle_deg": math.degrees(item.angle) * tuned.scale,
                "torque_nm": item.torque * tuned.scale,
                "share": item.share,
                "largest": _largest(found, item),
            }
            for item in tuned.directions
        ],
    }  # fmt: skip


def _largest(found: Identified, direction: Direction) -> list[dict[str, Any]]:
    """The parameters that a direction moves most, relative to their values."""
    moves = [
        (name, found.tuned.scale * relative(found.fitted.value(name) + step, found.fitted.value(name)))
        for name, step in direction.changes.items()
    ]
    moves.sort(key=lambda item: -abs(item[1]))
    return [{"name": name, "relative": value} for name, value in moves[:5]]
