"""Errors of an identification on held-out data, and whether the identified rig may be used."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING, Any, Literal

from pam_antagonist.estimation.metrics import ChannelErrors
from pam_antagonist.identification.result import HeldRecording
from pam_antagonist.replays.result import ANGLE, CHANNELS, EstimatedChannel, ReplayReport, covered
from pam_antagonist.rig.physical import is_positive
from pam_antagonist.rig.units import readable
from pam_antagonist.shown import number
from pam_antagonist.strict_json import picked

if TYPE_CHECKING:
    from pam_antagonist.identification.identified import ParameterEntry

COLUMNS = {
    "identified": "UKF, identified rig",
    "as_configured": "UKF, rig file as configured",
    "model_alone": "model alone, from the commands",
    "pressures_alone": "joint driven by the measured pressures",
    "linear": "linear map of the two pressures",
}
"""What gives an angle that is compared on held-out data."""
_TITLES = {"as_configured": "as configured", "identified": "identified", "own": "own values"}
WORSE = 1.2
"""Largest ratio of errors on held-out data; with more, the identified rig is called worse than the rig file."""

_Model = Literal["ukf", "model_alone"]
_MODELS: tuple[_Model, ...] = ("ukf", "model_alone")


def rigs_of(held: HeldRecording) -> list[tuple[str, ReplayReport]]:
    """The compared rigs: title and numbers."""
    return [(title, held.reports[key]) for key, title in _TITLES.items() if key in held.reports]


def errors_of(held: HeldRecording) -> dict[str, float]:
    """Errors of a free joint's angle by what gives it, RMS [deg]; empty without any."""
    return {key: held.error(key) for key in COLUMNS if math.isfinite(held.error(key))}


def known(held: HeldRecording, channel: EstimatedChannel, model: _Model = "ukf") -> list[ChannelErrors]:
    """Errors of a channel with each rig; empty if it was not measured, did not move or the joint was locked."""
    if channel is ANGLE and held.identified.joint.condition == "locked":
        return []
    errors = [channel.of(getattr(numbers, model)) for _, numbers in rigs_of(held)]
    found = [item for item in errors if item is not None and math.isfinite(item.ratio)]
    return found if len(found) == len(errors) else []


def entry(held: HeldRecording) -> dict[str, Any]:
    """The numbers of a held-out part in ``report.json``."""
    keys = ("samples", "duration_s", "ukf", "model_alone", "innovation")
    rigs = {rig: picked(held.reports[rig], *keys) if rig in held.reports else None for rig in _TITLES}
    about = {"name": held.name, "from_s": held.from_s, "joint": held.identified.joint}
    return {**about, **rigs, "errors_deg": errors_of(held)}


def pooled_coverage(every: Iterable[HeldRecording], rig: str = "identified") -> float:
    """Mean coverage of a rig's 95 % interval over recordings and estimated quantities; NaN without measurements."""
    shares = [item.coverage for held in every if rig in held.reports for item in covered(held.reports[rig])]
    return sum(shares) / len(shares) if shares else math.nan


def lacks_an_effect(every: Sequence[HeldRecording]) -> bool:
    """Whether the filter got worse on held-out data, so that the model seems to lack an effect."""
    return any(
        errors[1].rmse > WORSE * errors[0].rmse
        for held in every for channel in CHANNELS if (errors := known(held, channel))
    )  # fmt: skip


def do_not_use(rejected: str, adapts: bool = False) -> str:
    """The first sentence where an identified rig is rejected for a reason. `adapts`: the rig was identified before."""
    return f"Keep the rig file as it is: {rejected}" if adapts else f"Do not use this rig: {rejected}"


def rejection(
    every: Sequence[HeldRecording], refused: str = "", parameters: Sequence[ParameterEntry] = (),
    declared: Collection[str] = (), saw: bool = False,
) -> str:  # fmt: skip
    """Why the identified rig should not be used, in a sentence; empty if it may.

    `saw`: whether the rig file was fitted to what is held out here, so that nothing can be compared with it.
    """
    if lost := [held.name for held in every if _diverged(held)]:
        return f"the model with the identified values diverges on the held-out part of {', '.join(lost)}."
    if refused:
        return f"the values that fit best are impossible ({refused})."
    if not saw and (worse := _became_worse(every)):
        return worse
    met = at_bounds(parameters)
    if any(item.name in declared for item in met) or (met and not _much_better(every)):
        return (
            f"the search ended at a bound of {bounds_met(met)}. The best values lie beyond it, so the model does not "
            "fit. Correct the rig file, or keep a parameter as configured with --freeze NAME."
        )
    return ""


def at_bounds(parameters: Sequence[ParameterEntry]) -> list[ParameterEntry]:
    """Parameters whose search ended at a bound; 0 is none for a friction, which may really be absent."""
    return [
        item for item in parameters if item.bound is not None and not (item.bound == 0.0 and is_positive(item.name))
    ]


def bounds_met(met: Sequence[ParameterEntry]) -> str:
    """Names of parameters with the bounds that they met."""
    units = [readable(item.unit) for item in met]
    return ", ".join(
        f"{item.name} ({number(item.value * unit.scale)} {unit.name})" for item, unit in zip(met, units, strict=True)
    )


def _much_better(every: Sequence[HeldRecording]) -> bool:
    """Whether no channel got worse on held-out data, and their errors at most half as large as before in the mean."""
    both = [_pooled(every, channel, model) for channel in CHANNELS for model in _MODELS]
    ratios = [max(now, 1e-12) / max(before, 1e-12) for before, now in filter(None, both)]
    return bool(ratios) and max(ratios) <= 1.0 and math.prod(ratios) <= 0.5 ** len(ratios)


def _became_worse(every: Sequence[HeldRecording]) -> str:
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


def _pooled(every: Sequence[HeldRecording], channel: EstimatedChannel, model: _Model) -> tuple[float, float] | None:
    """RMS error of a channel over all recordings that have it, as configured and identified."""
    found = [errors for held in every if (errors := known(held, channel, model))]
    if not found:
        return None
    before, now = (math.sqrt(sum(errors[k].rmse ** 2 for errors in found) / len(found)) for k in (0, 1))
    return before, now


def _diverged(held: HeldRecording) -> bool:
    """Whether filter or model have no error that is a number."""
    figures = held.identified
    errors = [item for channel in CHANNELS for part in (figures.ukf, figures.model_alone) if (item := channel.of(part))]
    numbers = (*figures.model_alone.pressure.rmse_pa, figures.innovation.nis_mean, *(item.rmse for item in errors))
    return not all(map(math.isfinite, numbers))
