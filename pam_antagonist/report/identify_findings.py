"""Findings of an identification in sentences, from its numbers."""

from __future__ import annotations

import math

from pam_antagonist.report.channels import CHANNELS, HIGH_COVERAGE
from pam_antagonist.report.document import Finding
from pam_antagonist.report.held_out import HeldOut
from pam_antagonist.report.identify_entries import IdentifyReport
from pam_antagonist.report.table import number, percent

_LOW, _HIGH = 0.92, HIGH_COVERAGE
"""Range of the coverage on held-out data in which a 95 % interval is called honest."""
_WORSE = 1.2
"""Largest ratio of errors on held-out data; with more, the identified rig is called worse than the rig file."""
_LISTED = 4

DEFINITIONS = (
    (
        "Held out",
        "The end of each recording, which no fit and no tuning used. The model starts at the recording's start and "
        "gets the recorded voltages; the filter gets the recorded pressures as well. Errors count in this part only.",
    ),
    ("As configured", "The rig file that the identification began with."),
    (
        "Own values",
        "The common values plus one recording's own small deviations, estimated from its fitted part. They show how "
        "good the model could be for this recording. Another recording of the rig gets the common values.",
    ),
    (
        "Model alone",
        "The model without correction. It starts at the recording's start and gets the valve voltages only.",
    ),
    ("UKF", "The unscented Kalman filter: the model, corrected in every sample by the two measured pressures."),
    (
        "RMSE 𝕀, ratio ℚ",
        "Root mean square of estimate minus measurement; ℚ is the largest error over the measured range.",
    ),
    (
        "Standard error",
        "One standard deviation of the identified value. Residuals that are correlated in time count as fewer "
        "independent ones.",
    ),
    ("Determined", "The recordings narrowed the parameter to less than half of its prior's standard deviation."),
    (
        "Profile",
        "How much the log-likelihood falls while one parameter is held at another value and the others are fitted "
        "again. A fall of 1.92 marks the 95 % interval. A flat profile: the recordings do not determine the parameter.",
    ),
    (
        "Direction",
        "A combination of parameters that is uncertain. The filter's covariance includes the few directions that "
        "change its angle and torque most.",
    ),
)


def verdict(report: IdentifyReport) -> str:
    """The errors on held-out data before and after, of each channel in the recording where they are largest."""
    parts = []
    for channel in CHANNELS:
        known = [errors for entry in report.held_out if (errors := entry.known(channel))]
        if known:
            before, now, *_ = max(known, key=lambda errors: errors[1].rmse)
            parts.append(f"{channel.name} {channel.write(now.rmse)} (rig as configured: {channel.write(before.rmse)})")
    if not parts:
        return "No angle or torque was measured. Only the pressures could be judged."
    return f"Errors of the filter with the identified rig on held-out data (RMS): {', '.join(parts)}."


def findings(report: IdentifyReport) -> tuple[Finding, ...]:
    """All findings."""
    out = [Finding("warn", text) for text in report.warnings]
    for entry in report.held_out:
        out += [*_worse(entry), *_of_recording(entry)]
    return (*out, *_coverage(report), _differences(report), *_undetermined(report), *_pairs(report))


def lacks_an_effect(report: IdentifyReport) -> bool:
    """Whether the filter got worse on held-out data, so that the model seems to lack an effect."""
    return any(_worse(entry) for entry in report.held_out)


def _worse(entry: HeldOut) -> list[Finding]:
    """Channels in which the filter got worse: the fit compensated an effect that the model lacks."""
    out = []
    for channel in CHANNELS:
        before, now, *_ = entry.known(channel) or (None, None)
        if before is not None and now is not None and now.rmse > _WORSE * before.rmse:
            errors = f"{channel.write(now.rmse)}, as configured {channel.write(before.rmse)}"
            text = (
                f"{entry.name}, held-out part: the filter's {channel.name} is worse with the identified rig "
                f"({errors}). "
                "The model may lack an effect, which the parameters cannot replace: close_loop looks for it."
            )
            out.append(Finding("warn", text))
    return out


def _of_recording(entry: HeldOut) -> list[Finding]:
    before, now, *own = (
        " and ".join(number(value * 1e-3, 2) for value in figures.model_alone.pressure.rmse_pa)
        for _, figures in entry.rigs
    )
    parts = [f"pressures {now} kPa ({before} as configured{''.join(f', {text} with its own values' for text in own)})"]
    for channel in CHANNELS:
        known = entry.known(channel, "model_alone")
        if known:
            parts.append(f"{channel.name} {channel.write(known[1].rmse)} ({channel.write(known[0].rmse)})")
    out = [Finding("note", f"{entry.name}, held-out part, model alone, RMS error: {'; '.join(parts)}.")]
    for channel in CHANNELS:
        for errors in entry.known(channel)[1:2]:
            share = errors.coverage95 or 0.0
            text = f"{entry.name}, held-out part: {percent(share)} of the measured {channel.name}s lie in the 95 % "
            if _LOW <= share <= _HIGH:
                out.append(Finding("good", text + "interval. The filter's covariance is honest."))
            elif share > _HIGH:
                out.append(Finding("note", text + "interval. The filter's covariance is larger than needed."))
            else:
                out.append(Finding("warn", text + "interval. The filter's covariance is too small."))
    return out


def _coverage(report: IdentifyReport) -> list[Finding]:
    share, own = report.coverage95, report.coverage95_own
    if not math.isfinite(share):
        return []
    beside = f"; with each recording's own values {percent(own)}" if math.isfinite(own) else ""
    text = f"All held-out parts and channels together: {percent(share)} lie in the 95 % interval{beside}."
    return [Finding("good" if _LOW <= share <= _HIGH else "note", text)]


def _differences(report: IdentifyReport) -> Finding:
    if report.between is None:
        text = "One recording does not show how much the rig changes between recordings. Give several for that."
        return Finding("note", text)
    certain = [item for item in report.between.differences if item.certain]
    if not certain:
        return Finding("good", "The recordings agree in all parameters within their error bars.")
    named = ", ".join(f"{item.name} by {100 * item.largest:.1f} %" for item in certain[:_LISTED])
    more = f" and {len(certain) - _LISTED} more" if len(certain) > _LISTED else ""
    return Finding(
        "note",
        f"The recordings differ a little, as those of one rig may: {named}{more}. The common values lie between them, "
        "and the filter's covariance includes the differences.",
    )


def undetermined(report: IdentifyReport) -> dict[str, list[str]]:
    """Recording that would help -> parameters that are not determined without it."""
    records: dict[str, list[str]] = {}
    for item in report.parameters:
        if item.record is not None:
            records.setdefault(item.record, []).append(item.name)
    return records


def _undetermined(report: IdentifyReport) -> list[Finding]:
    records = undetermined(report)
    if not records:
        return [Finding("good", "The recordings determine every free parameter.")]
    return [
        Finding("note", f"Not determined, stays near its prior: {', '.join(names)}. To determine it, record {text}.")
        for text, names in records.items()
    ]


def _pairs(report: IdentifyReport) -> list[Finding]:
    pairs = report.correlations
    if not pairs:
        return []
    named = "; ".join(f"{pair.first} with {pair.second} ({pair.correlation:+.2f})" for pair in pairs[:2])
    text = f"{len(pairs)} pairs of parameters are strongly correlated. The strongest: {named}."
    return [Finding("note", text)]
