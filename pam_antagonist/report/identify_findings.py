"""Errors of an identification on held-out data, what follows from them, and all findings in sentences."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING, Any, Literal

from pam_antagonist.estimation.errors import ChannelErrors
from pam_antagonist.identification.result import Held
from pam_antagonist.replays.channels import ANGLE, CHANNELS, HIGH_COVERAGE, Channel, judged
from pam_antagonist.replays.result import ReplayReport
from pam_antagonist.report.document import Finding, good, note, warn
from pam_antagonist.report.table import number, percent
from pam_antagonist.rig.physical import is_positive
from pam_antagonist.rig.units import readable
from pam_antagonist.strict_json import picked

if TYPE_CHECKING:
    from pam_antagonist.report.identify import IdentifyResult, ParameterEntry

COLUMNS = {
    "identified": "UKF, identified rig",
    "as_configured": "UKF, rig file as configured",
    "model_alone": "model alone, from the commands",
    "pressures_alone": "joint driven by the measured pressures",
    "linear": "linear map of the two pressures",
}
"""What gives an angle that is compared on held-out data."""
_TITLES = {"as_configured": "as configured", "identified": "identified", "own": "own values"}
_LOW, _HIGH = 0.92, HIGH_COVERAGE
"""Range of the coverage on held-out data in which a 95 % interval is called honest."""
WORSE = 1.2
"""Largest ratio of errors on held-out data; with more, the identified rig is called worse than the rig file."""
_USUAL_DIFFERENCE = 0.05
"""Relative difference of two recordings of one rig: 2 % is the scale of the spread's prior, so 5 % is rare."""
_LISTED = 4
_LARGE = 0.05
"""Error as a share of the angle's range, from which on it is called large."""

_Model = Literal["ukf", "model_alone"]
_MODELS: tuple[_Model, ...] = ("ukf", "model_alone")


def rigs_of(held: Held) -> list[tuple[str, ReplayReport]]:
    """The compared rigs: title and numbers."""
    return [(title, held.reports[key]) for key, title in _TITLES.items() if key in held.reports]


def errors_of(held: Held) -> dict[str, float]:
    """Errors of a free joint's angle by what gives it, RMS [deg]; empty without any."""
    return {key: held.error(key) for key in COLUMNS if math.isfinite(held.error(key))}


def known(held: Held, channel: Channel, model: _Model = "ukf") -> list[ChannelErrors]:
    """Errors of a channel with each rig; empty if it was not measured, did not move or the joint was locked."""
    if channel is ANGLE and held.identified.joint.condition == "locked":
        return []
    errors = [channel.of(getattr(numbers, model)) for _, numbers in rigs_of(held)]
    found = [item for item in errors if item is not None and math.isfinite(item.ratio)]
    return found if len(found) == len(errors) else []


def entry(held: Held) -> dict[str, Any]:
    """The numbers of a held-out part in ``report.json``."""
    keys = ("samples", "duration_s", "ukf", "model_alone", "innovation")
    rigs = {rig: picked(held.reports[rig], *keys) if rig in held.reports else None for rig in _TITLES}
    about = {"name": held.name, "from_s": held.from_s, "joint": held.identified.joint}
    return {**about, **rigs, "errors_deg": errors_of(held)}


def pooled_coverage(every: Iterable[Held], rig: str = "identified") -> float:
    """Mean coverage of a rig's 95 % interval over recordings and channels; NaN without measurements."""
    shares = [item.coverage for held in every if rig in held.reports for item in judged(held.reports[rig])]
    return sum(shares) / len(shares) if shares else math.nan


def do_not_use(rejected: str) -> str:
    """The first sentence where an identified rig is rejected for a reason."""
    return f"Do not use this rig: {rejected}"


def rejection(
    every: Sequence[Held], refused: str = "", parameters: Sequence[ParameterEntry] = (), declared: Collection[str] = ()
) -> str:
    """Why the identified rig should not be used, in a sentence; empty if it may."""
    if lost := [held.name for held in every if _diverged(held)]:
        return f"the model with the identified values diverges on the held-out part of {', '.join(lost)}."
    if refused:
        return f"the values that fit best are impossible ({refused})."
    if worse := _became_worse(every):
        return worse
    met = at_bounds(parameters)
    if any(item.name in declared for item in met) or (met and not _much_better(every)):
        return (
            f"the search ended at a bound of {_bounds(met)}. The best values lie beyond it, so the model does not fit. "
            "Correct the rig file, or keep a parameter as configured with --freeze NAME."
        )
    return ""


def at_bounds(parameters: Sequence[ParameterEntry]) -> list[ParameterEntry]:
    """Parameters whose search ended at a bound; 0 is none for a friction, which may really be absent."""
    return [
        item for item in parameters if item.bound is not None and not (item.bound == 0.0 and is_positive(item.name))
    ]


def _bounds(met: Sequence[ParameterEntry]) -> str:
    """Names of parameters with the bounds that they met."""
    units = [readable(item.unit) for item in met]
    return ", ".join(
        f"{item.name} ({number(item.value * unit.scale)} {unit.name})" for item, unit in zip(met, units, strict=True)
    )


def _much_better(every: Sequence[Held]) -> bool:
    """Whether no channel got worse on held-out data, and their errors at most half as large as before in the mean."""
    both = [_pooled(every, channel, model) for channel in CHANNELS for model in _MODELS]
    ratios = [max(now, 1e-12) / max(before, 1e-12) for before, now in filter(None, both)]
    return bool(ratios) and max(ratios) <= 1.0 and math.prod(ratios) <= 0.5 ** len(ratios)


def _became_worse(every: Sequence[Held]) -> str:
    """Whether the filter got worse on all held-out parts together, in a sentence; empty if not.

    The filter's error counts twice as much as that of the model alone. A worse torque counts if the angle did not
    become better by as much.
    """
    overall, judged = 1.0, False
    for channel in CHANNELS:
        filters, models = (_pooled(every, channel, model) for model in _MODELS)
        if filters is None or models is None:
            continue
        judged = True
        ratio, of_model = (max(now, 1e-12) / max(before, 1e-12) for before, now in (filters, models))
        score = ratio**2 * of_model
        overall *= score
        worse = ratio > 1.0 and max(ratio, of_model) > WORSE and score > 1.0
        if worse and (channel is ANGLE or overall > 1.0):
            return (
                f"on held-out data the filter's {channel.name} error is {channel.write(filters[1])}, with the rig file "
                f"as given {channel.write(filters[0])} (model alone: {channel.write(models[1])} and "
                f"{channel.write(models[0])}). The model may lack an effect, which no values replace: close_loop looks "
                "for it."
            )
    if judged:
        return ""
    before, now = (
        math.hypot(*(value for held in every for value in held.reports[rig].model_alone.pressure.rmse_pa))
        for rig in ("as_configured", "identified")
    )
    if now > WORSE * before:
        return (
            f"on held-out data the model's pressures are off by {number(now * 1e-3)} kPa, with the rig file as given "
            f"by {number(before * 1e-3)} kPa."
        )
    return ""


def _pooled(every: Sequence[Held], channel: Channel, model: _Model) -> tuple[float, float] | None:
    """RMS error of a channel over all recordings that have it, as configured and identified."""
    found = [errors for held in every if (errors := known(held, channel, model))]
    if not found:
        return None
    before, now = (math.sqrt(sum(errors[k].rmse ** 2 for errors in found) / len(found)) for k in (0, 1))
    return before, now


def _diverged(held: Held) -> bool:
    """Whether filter or model have no error that is a number."""
    figures = held.identified
    errors = [item for channel in CHANNELS for part in (figures.ukf, figures.model_alone) if (item := channel.of(part))]
    numbers = (*figures.model_alone.pressure.rmse_pa, figures.innovation.nis_mean, *(item.rmse for item in errors))
    return not all(map(math.isfinite, numbers))


def verdict(found: IdentifyResult) -> str:
    """The errors on held-out data before and after, of each channel in the recording where they are largest."""
    if found.rejected:
        return do_not_use(found.rejected)
    parts = []
    for channel in CHANNELS:
        if every := [errors for held in found.held if (errors := known(held, channel))]:
            before, now, *_ = max(every, key=lambda errors: errors[1].rmse)
            parts.append(f"{channel.name} {channel.write(now.rmse)} (rig as configured: {channel.write(before.rmse)})")
    if not parts:
        return "No angle or torque was measured. Only the pressures could be judged."
    return f"Errors of the filter with the identified rig on held-out data (RMS): {', '.join(parts)}."


def findings(found: IdentifyResult) -> tuple[Finding, ...]:
    """All findings."""
    out = [warn(text) for text in found.found.notes]
    if (met := at_bounds(found.parameters)) and not found.rejected:
        out.append(warn(
            f"The search ended at a bound of {_bounds(met)}: the best values lie beyond it, and these may be wrong. "
            "Held-out data are still predicted much better than with the rig file as given. To find what the model "
            "lacks, run close_loop with the same recordings; to keep the value of the rig file, type --freeze NAME."
        ))  # fmt: skip
    for held in found.held:
        out += of_recording(held)
    return (*out, *_coverage(found), *_differences(found), *_undetermined(found), *_pairs(found))


def lacks_an_effect(every: Sequence[Held]) -> bool:
    """Whether the filter got worse on held-out data, so that the model seems to lack an effect."""
    return any(
        errors[1].rmse > WORSE * errors[0].rmse
        for held in every for channel in CHANNELS if (errors := known(held, channel))
    )  # fmt: skip


def of_recording(held: Held) -> list[Finding]:
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


def _coverage(found: IdentifyResult) -> list[Finding]:
    """How many of the held-out readings lie in their 95 % intervals, and where too few or too many do."""
    share, own = found.coverage95
    each = [
        (errors[1].coverage95 or 0.0, f"{channel.name} of {held.name}")
        for held in found.held for channel in CHANNELS if (errors := known(held, channel))
    ]  # fmt: skip
    if not each or not math.isfinite(share):
        return []
    kind, how, where = good, "honest", [item for item in each if item[0] < _LOW]
    if where:
        kind, how = warn, "too small"
    elif where := [item for item in each if item[0] > _HIGH]:
        kind, how = note, "larger than needed"
    listed = f" ({', '.join(f'{name} {percent(value)}' for value, name in where)})" if where else ""
    beside = f"; with each recording's own values {percent(own)}" if math.isfinite(own) else ""
    inside = f"{percent(share)} of the held-out readings lie in their 95 % intervals{beside}"
    return [kind(f"{inside}. The filter's covariance is {how}{listed}.")]


def _differences(found: IdentifyResult) -> list[Finding]:
    if not found.between:
        one = "One recording does not show how much the rig changes between recordings. Give several for that."
        return [note(one)] if len(found.recordings) == 1 else []
    certain = [item for item in found.between if item.certain]
    if not certain:
        return [good("The recordings agree in all parameters within their error bars.")]
    named = ", ".join(f"{item.name} by {100 * item.largest:.1f} %" for item in certain[:_LISTED])
    more = f" and {len(certain) - _LISTED} more" if len(certain) > _LISTED else ""
    if max(abs(item.largest) for item in certain) > _USUAL_DIFFERENCE:
        return [warn(
            f"The recordings differ by more than {percent(_USUAL_DIFFERENCE)}, as those of one rig hardly do: "
            f"{named}{more}. Either the rig changed, or the model lacks an effect. The common values suit neither."
        )]  # fmt: skip
    return [note(
        f"The recordings differ a little, as those of one rig may: {named}{more}. The common values lie between them, "
        "and the filter's covariance includes the differences."
    )]  # fmt: skip


def _undetermined(found: IdentifyResult) -> list[Finding]:
    """Parameters that are not determined, by the recording that would help."""
    records: dict[str, list[str]] = {}
    for item in found.parameters:
        if item.record is not None:
            records.setdefault(item.record, []).append(f"{item.name} ({item.reason})")
    return [
        note(f"Not determined: {', '.join(names)}. To determine it, record {text}.") for text, names in records.items()
    ] or [good("The recordings determine every free parameter.")]


def _pairs(found: IdentifyResult) -> list[Finding]:
    pairs = found.correlations
    if not pairs:
        return []
    named = "; ".join(f"{first} with {second} ({value:+.2f})" for first, second, value in pairs[:_LISTED])
    return [note(f"{len(pairs)} pairs of parameters are strongly correlated. The strongest: {named}.")]
