"""Findings of an identification in sentences, from its numbers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pam_antagonist.identification.held_out import WORSE, at_bounds, bounds_met, do_not_use, known
from pam_antagonist.identification.result import HeldRecording
from pam_antagonist.replays.result import ANGLE, CHANNELS, covered
from pam_antagonist.report.document import Statement, good, note, warn
from pam_antagonist.rig.units import readable
from pam_antagonist.shown import few, number, percent

if TYPE_CHECKING:
    from pam_antagonist.identification.identified import Identified, ParameterEntry

_USUAL_DIFFERENCE = 0.05
"""Relative difference of two recordings of one rig: 2 % is the scale of the spread's prior, so 5 % is rare."""
_LISTED = 4
_SURE, _NORMAL = 2.0, 1.96
"""Standard errors from which on a change is said, and of a 95 % interval."""
_DOUBTS = (
    ("too small", warn, "is too small"),
    ("not told", note, "cannot be judged, since there are too few independent errors"),
    ("larger than needed", note, "is larger than needed"),
)
"""What may be said of the covariance, the worst first."""
_LARGE = 0.05
"""Error as a share of the angle's range, from which on it is called large."""


def verdict(result: Identified) -> str:
    """The errors on held-out data before and after, of each channel in the recording where they are largest."""
    if result.rejected:
        return do_not_use(result.rejected, result.adapts)
    parts = []
    for channel in CHANNELS:
        if every := [errors for held in result.held if (errors := known(held, channel))]:
            before, now, *_ = max(every, key=lambda errors: errors[1].rmse)
            parts.append(f"{channel.name} {channel.write(now.rmse)} (rig as configured: {channel.write(before.rmse)})")
    if not parts:
        return "No angle or torque was measured. Only the pressures could be judged."
    return f"Errors of the filter with the identified rig on held-out data (RMS): {', '.join(parts)}."


def findings(result: Identified) -> tuple[Statement, ...]:
    """All findings."""
    out = [warn(text) for text in result.found.notes]
    if (met := at_bounds(result.parameters)) and not result.rejected:
        out.append(warn(
            f"The search ended at a bound of {bounds_met(met)}: the best values lie beyond it, and these may be wrong. "
            "Held-out data are still predicted much better than with the rig file as given. To find what the model "
            "lacks, run close_loop with the same recordings; to keep the value of the rig file, type --freeze NAME."
        ))  # fmt: skip
    for held in result.held:
        out += of_recording(held)
    if result.adapts:
        return (*_changes(result), *out, *_coverage(result))
    return (*out, *_coverage(result), *_differences(result), *_undetermined(result), *_pairs(result))


def _changes(result: Identified) -> list[Statement]:
    """What has changed since the rig file was written."""
    sure = [item for item in result.parameters if abs(item.value - item.start) > _SURE * item.std]
    each = [f"{item.name} {_change(item)}" for item in sorted(sure, key=lambda item: -abs(item.relative_change))]
    if not each:
        return [good("No number of the rig has changed by more than twice its standard error.")]
    return [note(f"Changed since: {', '.join(each)} (± 95 %). All other numbers stay within their errors.")]


def _change(item: ParameterEntry) -> str:
    if not item.start:
        unit = readable(item.unit)
        return f"0 to {number(item.value * unit.scale, 2)} {unit.name}".strip()
    return f"{100.0 * item.relative_change:+.1f} ± {100.0 * _NORMAL * item.std / abs(item.start):.1f} %"


def of_recording(held: HeldRecording) -> list[Statement]:
    """Channels in which the filter got worse, is worse than the model alone, or errs much for the angle's range."""
    out = []
    for channel in CHANNELS:
        errors, alone = known(held, channel), known(held, channel, "model_alone")
        if not errors:
            continue
        before, now, *_ = errors
        if now.rmse > WORSE * before.rmse:
            # The fit compensated an effect that the model lacks.
            out.append(
                f"the filter's {channel.name} is worse with the identified rig ({channel.write(now.rmse)}, as "
                f"configured {channel.write(before.rmse)}). The model may lack an effect, which the parameters cannot "
                "replace: close_loop looks for it."
            )
        # The model alone is given the external torque, which the filter has to estimate.
        told = held.identified.ukf.external_torque is not None
        if alone and not told and now.rmse > WORSE * alone[1].rmse:
            out.append(
                f"the filter's {channel.name} ({channel.write(now.rmse)}) is worse than that of the model alone "
                f"({channel.write(alone[1].rmse)}). The measured pressures contradict the model, and correcting it by "
                "them does harm."
            )
        share = now.ratio * now.rmse / now.largest if now.largest else 0.0
        if channel is ANGLE and share > _LARGE:
            out.append(
                f"the error is {percent(share)} of the angle's range: the joint is no plain pair of muscles, or the "
                "model lacks something. Run close_loop."
            )
    return [warn(f"{held.name}, held-out part: {text}") for text in out]


def _coverage(result: Identified) -> list[Statement]:
    """How many of the held-out readings lie in their 95 % intervals, and where too few or too many do."""
    share, own = result.coverage95
    each = [(item, f"{item.what} of {held.name}") for held in result.held for item in covered(held.identified)]
    if not each or not math.isfinite(share):
        return []
    kind, how, where = good, "is honest", list[str]()
    for doubt, worse, words in _DOUBTS:
        if not where:
            where = [f"{name} {percent(item.coverage)}" for item, name in each if item.honesty == doubt]
            kind, how = (worse, words) if where else (kind, how)
    listed = f" ({', '.join(where)})" if where else ""
    beside = f"; with each recording's own values {percent(own)}" if math.isfinite(own) else ""
    inside = f"{percent(share)} of the held-out readings lie in their 95 % intervals{beside}"
    return [kind(f"{inside}. The filter's covariance {how}{listed}.")]


def _differences(result: Identified) -> list[Statement]:
    if not result.between:
        one = "One recording does not show how much the rig changes between recordings. Give several for that."
        return [note(one)] if len(result.recordings) == 1 else []
    certain = [item for item in result.between if item.certain]
    if not certain:
        return [good("The recordings agree in all parameters within their error bars.")]
    named = few([f"{item.name} by {100 * item.largest:.1f} %" for item in certain], _LISTED)
    if max(abs(item.largest) for item in certain) > _USUAL_DIFFERENCE:
        return [warn(
            f"The recordings differ by more than {percent(_USUAL_DIFFERENCE)}, as those of one rig hardly do: "
            f"{named}. Either the rig changed, or the model lacks an effect. The common values suit neither."
        )]  # fmt: skip
    return [note(
        f"The recordings differ a little, as those of one rig may: {named}. The common values lie between them, "
        "and the filter's covariance includes the differences."
    )]  # fmt: skip


def _undetermined(result: Identified) -> list[Statement]:
    """Parameters that are not determined, by the recording that would help."""
    records: dict[str, list[str]] = {}
    for item in result.parameters:
        if item.record is not None:
            records.setdefault(item.record, []).append(f"{item.name} ({item.reason})")
    return [
        note(f"Not determined: {', '.join(names)}. To determine it, record {text}.") for text, names in records.items()
    ] or [good("The recordings determine every free parameter.")]


def _pairs(result: Identified) -> list[Statement]:
    pairs = result.correlations
    if not pairs:
        return []
    named = "; ".join(f"{first} with {second} ({value:+.2f})" for first, second, value in pairs[:_LISTED])
    return [note(f"{len(pairs)} pairs of parameters are strongly correlated. The strongest: {named}.")]
