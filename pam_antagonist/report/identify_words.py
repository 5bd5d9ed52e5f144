"""What the numbers of an identification say, in sentences. They take the content of ``report.json``."""

from __future__ import annotations

import math

from pam_antagonist.report.channels import CHANNELS
from pam_antagonist.report.document import Finding
from pam_antagonist.report.identify_tables import Document
from pam_antagonist.report.table import number, percent

_LOW, _HIGH = 0.92, 0.98
"""Shares of measured values between which a 95 % interval is called honest on data that were held out."""
_LISTED = 4


def _measured(entry: Document, model: str, name: str) -> bool:
    if name == "angle" and entry["joint"]["condition"] == "locked":
        return False
    figures = entry["identified"][model][name]
    return figures is not None and figures["q"] is not None and math.isfinite(figures["q"])


def verdict(document: Document) -> str:
    """One sentence: what identification bought on data that it did not see."""
    parts = []
    for channel in CHANNELS:
        entries = [entry for entry in document["held_out"] if _measured(entry, "ukf", channel.name)]
        if not entries:
            continue
        key = f"rmse_{channel.key}"
        worst = max(entries, key=lambda entry: float(entry["identified"]["ukf"][channel.name][key]))
        before, now = (worst[rig]["ukf"][channel.name][key] for rig in ("as_configured", "identified"))
        parts.append(
            f"the {channel.name} to {channel.write(now)} where the rig as configured errs by {channel.write(before)}"
        )
    if not parts:
        return "No angle or torque was measured: the identified rig explains the pressures, nothing else was judged."
    return f"On data that were not fitted, the filter with the identified rig tells {' and '.join(parts)} (RMS)."


def findings(document: Document) -> tuple[Finding, ...]:
    """What a reader should take from the numbers."""
    out = [Finding("warn", text) for text in document["warnings"]]
    for entry in document["held_out"]:
        out += _held_out(entry)
    out += _coverage(document)
    out += _between(document)
    out += _undetermined(document)
    out += _pairs(document)
    return tuple(out)


def _held_out(entry: Document) -> list[Finding]:
    out = []
    name = entry["name"]
    kpa = [
        " and ".join(number(value * 1e-3, 2) for value in entry[rig]["model_alone"]["pressure"]["rmse_pa"])
        for rig in ("as_configured", "identified")
    ]
    own = ""
    if entry["own"] is not None:
        values = " and ".join(number(value * 1e-3, 2) for value in entry["own"]["model_alone"]["pressure"]["rmse_pa"])
        own = f", {values} kPa with its own values"
    parts = [f"pressures {kpa[1]} kPa ({kpa[0]} as configured{own})"]
    for channel in CHANNELS:
        if _measured(entry, "model_alone", channel.name):
            before, now = (
                entry[rig]["model_alone"][channel.name][f"rmse_{channel.key}"]
                for rig in ("as_configured", "identified")
            )
            parts.append(f"{channel.name} {channel.write(now)} ({channel.write(before)})")
    out.append(Finding("note", f"{name}, held-out part, model alone, RMS error: {'; '.join(parts)}."))
    for channel in CHANNELS:
        if not _measured(entry, "ukf", channel.name):
            continue
        share = entry["identified"]["ukf"][channel.name]["coverage95"]
        text = f"{name}, held-out part: {percent(share)} of the measured {channel.name}s lie in the 95 % interval"
        if _LOW <= share <= _HIGH:
            out.append(Finding("good", f"{text}: the filter knows how wrong it is."))
        elif share > _HIGH:
            out.append(Finding("note", f"{text}: it is wider than it needs to be."))
        else:
            out.append(Finding("warn", f"{text}: the filter is too sure of itself."))
    return out


def _coverage(document: Document) -> list[Finding]:
    share = document["coverage95"]
    if not math.isfinite(share):
        return []
    own = document["coverage95_own"]
    beside = f"; with each recording's own values {percent(own)}" if math.isfinite(own) else ""
    text = f"All held-out parts and channels together: {percent(share)} lie in the 95 % interval{beside}."
    return [Finding("good" if _LOW <= share <= _HIGH else "note", text)]


def _between(document: Document) -> list[Finding]:
    between = document["between"]
    if between is None:
        one = "One recording cannot tell how much the rig changes from one to the next; give several for that."
        return [Finding("note", one)]
    certain = [item for item in between["differences"] if item["certain"]]
    if not certain:
        return [Finding("good", "The recordings agree in all parameters to within what they can tell.")]
    named = ", ".join(f"{item['name']} by {100 * item['largest']:.1f} %" for item in certain[:_LISTED])
    more = f" and {len(certain) - _LISTED} more" if len(certain) > _LISTED else ""
    text = (
        f"The recordings disagree a little, as those of one rig may: {named}{more}. The common values lie between, "
        "and the disagreement is part of the filter's covariance."
    )
    return [Finding("note", text)]


def _undetermined(document: Document) -> list[Finding]:
    left = [item for item in document["parameters"] if not item["determined"]]
    if not left:
        return [Finding("good", "Every free parameter was learnt from the recordings.")]
    advice: dict[str, list[str]] = {}
    for item in left:
        advice.setdefault(item["record"], []).append(item["name"])
    return [
        Finding("note", f"Not determined, stays near its prior: {', '.join(names)}. To determine it, record {text}.")
        for text, names in advice.items()
    ]


def _pairs(document: Document) -> list[Finding]:
    pairs = document["correlations"]
    if not pairs:
        return []
    named = "; ".join(f"{p['first']} with {p['second']} ({p['correlation']:+.2f})" for p in pairs[:2])
    return [Finding("note", f"{len(pairs)} pairs of parameters are hardly told apart, the strongest: {named}.")]


DEFINITIONS = (
    (
        "Held out",
        "The end of each recording that no fit and no tuning saw. The model runs from the recording's start with "
        "the recorded voltages, the filter with the recorded pressures; errors are counted in this part only.",
    ),
    ("As configured", "The rig file that the identification began with."),
    (
        "Own values",
        "The common values with one recording's own small deviations, estimated from its fitted part: what this "
        "recording would need, where the common values are what another recording of the rig will get.",
    ),
    ("Model alone", "The model from the recording's start, driven by the valve voltages only, never corrected."),
    ("UKF", "The unscented Kalman filter: the model, corrected in every sample by the two measured pressures."),
    (
        "RMSE 𝕀, ratio ℚ",
        "Root mean square of estimate minus measurement; ℚ is the largest error over the measured range.",
    ),
    (
        "Standard error",
        "How far the identified value may be from the true one, one standard deviation. Residuals that depend "
        "on their neighbours count as fewer.",
    ),
    ("Determined", "The recordings narrowed the parameter to less than half of its prior."),
    (
        "Profile",
        "How much less likely the best fit becomes while one parameter is held at another value. 1.92 marks the 95 % "
        "interval; a flat profile means that the recordings do not tell.",
    ),
    (
        "Direction (mode)",
        "Parameters that are uncertain together. The filter carries the few that move its angle and torque "
        "most in its covariance.",
    ),
)
"""Words of an identification's report and what they mean."""
