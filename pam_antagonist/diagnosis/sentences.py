"""The result of a diagnosis in sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pam_antagonist.diagnosis.errors import Errors, ModelErrors
from pam_antagonist.diagnosis.law_findings import LawFindings
from pam_antagonist.diagnosis.result import Diagnosis, FoundEffect
from pam_antagonist.diagnosis.search import about
from pam_antagonist.inference.measured_motion import MeasuredMotion
from pam_antagonist.shown import DIVERGES

_NAMED = 3
"""Residuals that the sentence names; all of them are in a section of their own."""


def in_words(effect: FoundEffect, sealed: bool = False) -> str:
    """An effect in words."""
    if effect.law is not None:
        return f"{effect.law.in_words()} (a learned law)"
    values = {name: value for name, (value, _, _) in effect.parameters.items()}
    words = about(effect.name).sentence(effect.name, effect.muscle, values, sealed)
    begin, end = (
        None if time is None else f"{time:.1f} ± {max(std or 0.0, 0.1):.1f} s"
        for time, std in ((effect.onset_s, effect.onset_std_s), (effect.end_s, effect.end_std_s))
    )
    if begin is None:
        return words if end is None else f"{words}, until {end}"
    return f"{words}, from {begin} on" if end is None else f"{words}, from {begin} to {end}"


def of_catalogue(found: Diagnosis, effects: Sequence[str], firmness: str) -> str:
    """The verdict without learned laws, with the found effects and what the splits say of them in words."""
    errors, share, mean_pressure = found.errors, found.share, found.driven
    each = [_errors(own, mean_pressure) for own in errors.all]
    configured, recalibrated, extended = map(_listed, each)
    beside, doubts = _calibrated(found), _doubts(found)
    if found.verdict == "none":
        return (
            f"The model lacks nothing that these recordings show.{beside} After {'calibration and ' if beside else ''}"
            f"recalibration its errors on held-out data are {recalibrated}, as small as the sensors' noise allows; as "
            f"configured they are {configured}.{doubts}"
        )
    if found.verdict == "effect":
        what = " ".join(f"{words[0].upper()}{words[1:]}." for words in effects)
        these = "these effects" if len(effects) > 1 else "this effect"
        gone = ""
        if share is not None:
            gone = f"Of the excess over the sensors' noise after recalibration, {100 * share:.0f} % is explained"
        if any(isinstance(experiment, MeasuredMotion) for experiment in found.experiments):
            gone = "" if share is None else f": {gone[0].lower()}{gone[1:]} on held-out data"
            text = (
                f"{what} The joint sticks, so the balance of its torques along the measured motion decides{gone}. The "
                "errors there of the model that gets the commands only are "
                f"{configured} as configured, {recalibrated} after recalibration and {extended} with {these}."
            )
        else:
            text = f"{what} The model's errors on held-out data {course_in_words(errors, these, mean_pressure)}."
            text += f" {gone}." if gone else ""
        text += beside + (f" {firmness}." if firmness else "")
        if found.reference is not None:
            straight = found.reference["angle_and_pressures"]
            text += f" A straight-line map of angle and pressures has an error of {straight:.2g} N m."
        return text + doubts
    tried = [(item.shares[0], item.effect) for item in found.ranking if item.shares is not None and item.round == 1]
    closest = ""
    if tried:
        best, name = max(tried, key=lambda item: item[0])
        gone = f"{100 * max(best, 0.0):.0f} %"
        closest = f" The effect that comes closest, {name}, explains {gone} of the excess, which is not enough."
    return (
        "The model lacks something, and no effect of the catalogue explains it. Its errors on held-out data are "
        f"{configured} as configured and {recalibrated} after recalibration.{_above_noise(found)}{closest}{beside}"
    )


def _above_noise(found: Diagnosis) -> str:
    """Where, when and by how much residuals are above their noise, the clearest first."""
    items = sorted(found.remaining, key=lambda item: (not item.is_of_sensor, -item.times_noise))
    more = f"; {len(items) - _NAMED} more in section What is left" if len(items) > _NAMED else ""
    block_s = found.experiments[0].trial.block_s
    named = "; ".join(item.in_short() for item in items[:_NAMED])
    return f" Above the sensors' noise, in means over {1e3 * block_s:.0f} ms: {named}{more}."


def course_in_words(errors: ModelErrors, these: str, mean_pressure: bool = False) -> str:
    """What recalibration takes off the errors, and what effects take off after it. `these`: the effects, in words."""
    first = change_in_words(errors.as_configured, errors.recalibrated, " as configured", mean_pressure)
    before, after = (_errors(own, mean_pressure) for own in (errors.recalibrated, errors.extended))
    then = "to" if _falls(before, after) else "are"
    return f"{first} by recalibration, and {then} {_listed(after)} with {these}"


def _falls(before: Sequence[tuple[float, str]], after: Sequence[tuple[float, str]]) -> bool:
    """Whether an error falls and none grows, as they are written."""
    written = [(float(f"{old[0]:.2g}"), float(f"{new[0]:.2g}")) for old, new in zip(before, after, strict=True)]
    return all(new <= old for old, new in written) and any(new < old for old, new in written)


def change_in_words(before: Errors, after: Errors, whose: str = "", mean_pressure: bool = False) -> str:
    """How errors change from those of one model, and whose these are, to those of another one."""
    old, new = (_errors(own, mean_pressure) for own in (before, after))
    return f"{'fall' if _falls(old, new) else 'change'} from {_listed(old)}{whose} to {_listed(new)}"


def _errors(own: Errors, mean_pressure: bool) -> list[tuple[float, str]]:
    """Each error with its unit."""
    out = [(item.rmse, unit) for item, unit in ((own.angle, "°"), (own.torque, " N m")) if item]
    if mean_pressure and own.mean_rmse_pa is not None:
        return [*out, (own.mean_rmse_pa / 1e3, " kPa (mean pressure)")]
    first, second = own.rmse_pa
    return [*out, (first / 1e3, " kPa (pressure 1)"), (second / 1e3, " kPa (pressure 2)")]


def _listed(errors: Sequence[tuple[float, str]]) -> str:
    if any(math.isinf(value) for value, _ in errors):
        return DIVERGES.replace("that", "those", 1)
    text = ", ".join(f"{value:.2g}{unit}" for value, unit in errors)
    return text.replace(" kPa (pressure 1), ", " and ").replace(" kPa (pressure 2)", " kPa")


def of_laws(found: Diagnosis, laws: LawFindings, beside: Sequence[str], firmness: str) -> str:
    """The verdict by learned laws. `beside`: effects that were found beside them, and `firmness` of these, in words."""
    change = change_in_words(found.errors.recalibrated, found.errors.extended, " after recalibration")
    first, *second = (one.law for one in laws.effects if one.law is not None)
    kind = " and ".join(one.name.replace("_", " ") for one in laws.named)
    kind = f": {kind}, in another form than the catalogue's law" if kind else ""
    if second:
        text = f"Two effects are missing. One sits in {first.where} and depends on {first.on}, "
        text += f"the other in {second[0].where} and depends on {second[0].on}{kind}. Their laws were measured as "
        ranges = [law.range_in_words.removeprefix(",") for law in (first, *second)]
        text += f"tables, the first{ranges[0]}, the other{ranges[1]}. "
    else:
        text = f"The missing effect sits in {first.where} and depends on {first.on}{kind}. "
        text += f"Its law was measured as a table{first.range_in_words}. "
    with_it = ("them" if second else "it") + (" and what was found beside" if beside else "")
    text += f"With {with_it} the model's errors on held-out data {change}."
    names = {one.name for one in laws.named}
    like_them = dict.fromkeys(name for one in laws.effects for name in one.like if name not in names)
    others = [name.replace("_", " ") for name in like_them]
    text += f" Effects of the catalogue that act there, but explain less: {', '.join(others)}." if others else ""
    wrong, than = " and ".join(laws.wrong).replace("_", " "), "tables" if second else "table"
    text += f" Of the catalogue alone, {wrong} explained most, and less than the {than}." if wrong else ""
    alternatives = "; ".join(dict.fromkeys(words for one in laws.effects for words in one.alternatives))
    text += f" As good in a simulation: {alternatives}." if alternatives else ""
    if any(law.is_of_readings for law in (first, *second)):
        text += " No rig file holds an error of readings: correct the recordings by it."
    text += f" Beside {'them' if second else 'it'}: {'; '.join(beside)}." if beside else ""
    return text + _calibrated(found) + (f" {firmness}." if firmness else "") + _doubts(found)


def _calibrated(found: Diagnosis) -> str:
    calibrated = "; ".join(item.in_words() for item in found.shared)
    return f" The recordings need a calibration: {calibrated}." if calibrated else ""


def _doubts(found: Diagnosis) -> str:
    others = "; ".join(about(name).instead(name) for name in found.ambiguous_with)
    return f" The recordings do not exclude another explanation: {others}." if others else ""
