"""What the numbers of a replay say, in sentences. Takes entries of ``report.json``, no arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from pam_antagonist.report.channels import CHANNELS, Channel, Report, judged, lock_angle, moves, worst
from pam_antagonist.report.document import Finding
from pam_antagonist.report.table import number, percent

HONEST_COVERAGE = 0.88
"""Least share of measured values in the 95 % interval for which the interval is called honest."""
MARGIN = 1.05
"""Errors within this ratio of each other are called equal."""
NIS_HIGH, NIS_LOW = 3.0, 1.0
"""A mean NIS of 2 is right; at these the innovations are 1.2 or 0.7 times as large as the filter expects."""
CERTAIN = 0.01
"""p-value below which innovations are called not white."""
FAINT = 0.1
"""Autocorrelation of innovations below which their memory is called faint."""
_ISSUES = 6


def _joined(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _known(parts: Sequence[tuple[str, str]]) -> str:
    """'the angle is known to 0.3° and the torque to 0.01 N m'."""
    first, *others = parts
    return _joined([f"the {first[0]} is known to {first[1]}", *(f"the {name} to {value}" for name, value in others)])


def verdict(report: Report) -> str:
    """One sentence on one recording."""
    held = "" if moves(report) else f" The joint was locked at {lock_angle(report)}."
    known = [(channel.name, channel.write(channel.value(report))) for channel in judged(report)]
    if not known:
        return "The estimate stands alone: no angle or torque was measured that it could be compared with." + held
    return f"From the two pressures alone, {_known(known)} (root mean square error).{held}"


def overall_verdict(reports: Sequence[Report]) -> str:
    """One sentence on several recordings: the worst of each channel."""
    if len(reports) == 1:
        return verdict(reports[0])
    known = []
    for channel in CHANNELS:
        report = worst(channel, reports)
        if report is not None:
            where = report["recording"]["name"]
            known.append((channel.name, f"{channel.write(channel.value(report))} ({where})"))
    if not known:
        return f"None of the {len(reports)} recordings has a measured angle or torque to compare the estimate with."
    worst_of = f"root mean square errors, the worst of {len(reports)} recordings"
    return f"From the two pressures alone, {_known(known)}: {worst_of}."


def findings(report: Report) -> tuple[Finding, ...]:
    """What a reader should take from the numbers of one recording."""
    out = [_against_model(report, channel) for channel in judged(report)]
    return (*out, *_honesty(report), *_innovations(report), *_live(report), *_quality(report))


def _against_model(report: Report, channel: Channel) -> Finding:
    ukf, model = channel.value(report), channel.value(report, "model_alone")
    largest, ratio = channel.value(report, what="max"), channel.ratio(report)
    text = (
        f"{channel.title}: the filter errs by {channel.write(ukf)} (RMS) and {channel.write(largest)} at worst, "
        f"{percent(ratio)} of the measured range; the model alone errs by {channel.write(model)}"
    )
    if model > ukf * MARGIN:
        return Finding("good", f"{text}, {number(model / ukf, 2)} × as much.")
    if ukf > model * MARGIN:
        return Finding("warn", f"{text}, less than the filter: here the feedback of the pressures does not help.")
    return Finding("note", f"{text}: the feedback of the pressures changes little.")


def _honesty(report: Report) -> list[Finding]:
    shares = {channel.name: channel.coverage(report) for channel in judged(report)}
    if not shares:
        return []
    text = _joined([f"{percent(share)} of the measured {name}s" for name, share in shares.items()])
    if min(shares.values()) >= HONEST_COVERAGE:
        return [Finding("good", f"The filter knows how wrong it is: its 95 % interval holds {text}.")]
    return [Finding("warn", f"The filter is too sure of itself: its 95 % interval holds {text}.")]


def _innovations(report: Report) -> list[Finding]:
    mean, p = report["innovation"]["nis_mean"], report["innovation"]["whiteness_p"]
    out = []
    if math.isfinite(mean):
        status, much = ("good", "as much as")
        if mean > NIS_HIGH:
            status, much = "warn", "more than"
        elif mean < NIS_LOW:
            status, much = "note", "less than"
        text = f"The pressures surprise the filter {much} it expects (mean NIS {number(mean, 2)}, 2 is right)."
        out.append(Finding(status, text))  # type: ignore[arg-type]
    if math.isfinite(p):
        out.append(_whiteness(p, report["innovation"]["largest_correlation"]))
    return out


def _whiteness(p: float, correlation: float) -> Finding:
    """Certain and large are two things: thousands of samples make any memory certain."""
    what = "What the filter did not foresee in the pressures"
    small = "p < 0.001" if p < 1e-3 else f"p = {number(p, 2)}"
    size = f"largest correlation {number(correlation, 2)}"
    if p >= CERTAIN:
        return Finding("good", f"{what} is white noise ({small}): nothing is left in it.")
    if abs(correlation) < FAINT:
        return Finding("note", f"{what} is nearly white: its memory is certain ({small}) but faint ({size}).")
    if correlation > 0.0:
        return Finding("note", f"{what} keeps its sign for a while ({size}): the model lacks something slow.")
    return Finding("note", f"{what} swings back at once ({size}): the filter follows the sensors too eagerly.")


def _live(report: Report) -> list[Finding]:
    live = report["live_equal"]
    if live is None:
        return []
    without = report["live_without"]
    late = f"The live filter went without part of {without} samples, which came too late; so does the replay."
    return [*([Finding("warn", late)] if without else []), *_equality(live, _live_rig(report))]


def _live_rig(report: Report) -> str:
    """What to add where the live filter had other values than the replay's."""
    told = report["recording"].get("rigs", {}).get("estimator")
    if told is None or told["same"]:
        return ""
    return f" It was published with other values: rig {told['name']} ({told['fingerprint']})."


def _equality(live: dict[str, Any], rig: str = "") -> list[Finding]:
    if live["compared"] == 0:
        return [Finding("warn", "The estimate that was recorded live has no sample in common with the replay.")]
    if live["equal"] == live["compared"] and not live["only_live"] and not live["only_replay"]:
        text = f"The replay equals the estimate published live, bit for bit, in all {live['compared']} samples."
        return [Finding("good", text)]
    fields = ", ".join(live["differing"]) or "none"
    text = (
        f"The replay equals the estimate published live in {live['equal']} of {live['compared']} samples "
        f"(fields that differ: {fields}; {live['only_live']} samples only live, {live['only_replay']} only here).{rig}"
    )
    return [Finding("warn", text)]


def _quality(report: Report) -> list[Finding]:
    counts, issues = report["estimator"]["counts"], report["recording"]["issues"]
    out = [Finding("warn", f"{issue[:1].upper()}{issue[1:].rstrip('.')}.") for issue in issues[:_ISSUES]]
    if len(issues) > _ISSUES:
        out.append(Finding("warn", f"And {len(issues) - _ISSUES} more such remarks in report.json."))
    met = {
        "outliers": "samples with a pressure beyond the gate, which was left out",
        "gaps": "gaps predicted over",
        "repaired": "covariances repaired",
        "restarts": "restarts after a long gap or a lost estimate",
    }
    seen = [f"{counts[key]} {text}" for key, text in met.items() if counts[key]]
    if seen:
        out.append(Finding("note", f"The filter met {_joined(seen)}."))
    if report["joint"]["told_from"] == "nothing":
        out.append(Finding("note", "Nothing in the recording tells whether the joint could move: taken for free."))
    return out


DEFINITIONS = (
    (
        "UKF",
        "The unscented Kalman filter: the model, corrected in every sample by the two measured pressures. It never "
        "sees the angle or the torque.",
    ),
    ("Model alone", "The same model from the first pressures on, driven by the valve voltages only, never corrected."),
    (
        "RMSE 𝕀, largest error 𝕄, ratio ℚ",
        "Root mean square and maximum of estimate minus measurement; ℚ is 𝕄 over the range of the measured signal.",
    ),
    (
        "95 % interval",
        "Where the filter expects the measured value in 95 % of the samples: ±1.96 standard deviations of its own "
        "covariance, with the reference sensor's noise and the step of its converter counted in.",
    ),
    ("Innovation", "Measured minus predicted pressure: what the pressures told that the model did not know."),
    (
        "NIS",
        "Normalised innovation squared: the innovation in units of what the filter expected of it. With two "
        "pressures a consistent filter averages 2 and stays between 0.05 and 7.4 in 95 % of the samples.",
    ),
    (
        "Whiteness",
        "A right model leaves innovations without memory. The p-value is the chance of as much memory in white noise; "
        "with many samples even a faint memory gives 0, so the largest correlation stands beside it.",
    ),
    (
        "Subsystem σ",
        "Which of the model's 18 sets of equations is active: three flow regimes for each muscle, joint sliding or "
        "sticking.",
    ),
)
"""Words of a replay's report and what they mean."""
