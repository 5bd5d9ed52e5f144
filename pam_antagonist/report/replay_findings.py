"""Findings of a replay in sentences, from its numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pam_antagonist.replays.channels import CHANNELS, Judged, joined, joint_text, judged
from pam_antagonist.replays.live import ENDED, LiveComparison
from pam_antagonist.replays.result import ReplayReport
from pam_antagonist.report.document import Finding, good, note, warn
from pam_antagonist.report.table import number, percent

HONEST_COVERAGE = 0.88
"""Least coverage of a 95 % interval that is called honest."""
MARGIN = 1.05
"""Errors within this ratio of each other are called equal."""
NIS_HIGH, NIS_LOW = 3.0, 1.0
"""Bounds of the mean NIS, 2 is right; here the innovations are 1.2 or 0.7 times as large as expected."""
CERTAIN = 0.01
"""Innovations with a smaller p-value are called not white."""
FAINT = 0.1
"""Smaller autocorrelations of innovations are called small."""
SHORTEST_S = 1.0
"""[s] Shorter recordings have too few independent errors for an assessment."""
_ISSUES = 6


def verdict(reports: Sequence[ReplayReport]) -> str:
    """The result of a recording, or of several: the worst of each channel."""
    first, several, known = reports[0], len(reports) > 1, []
    for channel in CHANNELS:
        errors = [(item.ukf.rmse, one) for one in reports for item in judged(one) if item.channel is channel]
        if errors:
            worst, where = max(errors, key=lambda item: item[0])
            place = f" ({where.recording.name})" if several else ""
            known.append(f"the {channel.name} to within {channel.write(worst)}{place}")
    held = "" if several or first.joint.condition == "free" else f" The joint was {joint_text(first.joint)}."
    if not known:
        which = f"In none of the {len(reports)} recordings was angle or" if several else "Neither angle nor"
        return f"{which} torque measured, so the estimate was compared with nothing.{held}"
    what = f"root mean square errors, the worst of {len(reports)} recordings" if several else "root mean square error"
    return f"From the two pressures alone, the estimator gives {joined(known)} ({what}).{held}"


def findings(report: ReplayReport) -> tuple[Finding, ...]:
    """All findings of one recording."""
    if report.duration_s < SHORTEST_S:
        text = f"{report.duration_s:.3f} s is too short to judge the filter by; expected {SHORTEST_S:g} s or more."
        return (warn(text), *_live(report), *_quality(report))
    known = judged(report)
    against = [_against_model(item) for item in known]
    return (*against, *_honesty(known), *_innovations(report), *_live(report), *_quality(report))


def _against_model(item: Judged) -> Finding:
    channel, ukf, model = item
    text = (
        f"{channel.title}: the filter's error is {channel.write(ukf.rmse)} (RMS) and at most "
        f"{channel.write(ukf.largest)}, {percent(ukf.ratio)} of the measured range. The model alone "
    )
    if math.isinf(model.rmse):
        return warn(f"{text}diverges: this rig file does not describe the joint.")
    text += f"has {channel.write(model.rmse)} (RMS)"
    if model.rmse > ukf.rmse * MARGIN:
        return good(f"{text}, {number(model.rmse / ukf.rmse, 2)} × as much.")
    if ukf.rmse > model.rmse * MARGIN:
        return warn(f"{text}, less than the filter. Here the correction by the pressures does not help.")
    return note(f"{text}. The correction by the pressures changes little.")


def _honesty(known: Sequence[Judged]) -> list[Finding]:
    if not known:
        return []
    shares = [f"{percent(item.coverage)} of the measured {item.channel.name}s" for item in known]
    holds = f"its 95 % interval holds {joined(shares)}"
    if min(item.coverage for item in known) < HONEST_COVERAGE:
        return [warn(f"The filter's covariance is too small: {holds}.")]
    wide = [item for item in known if item.wide]
    if not wide:
        return [good(f"The filter's covariance is honest: {holds}.")]
    times = [f"that of the {item.channel.name} {number((item.ukf.width or 0.0) / 1.96, 2)} times" for item in wide]
    larger = f"The standard deviations are larger than the RMS errors: {joined(times)}."
    return [note(f"The filter's covariance is larger than needed: {holds} and is wide. {larger}")]


def _innovations(report: ReplayReport) -> list[Finding]:
    mean, p, out = report.innovation.nis_mean, report.innovation.whiteness_p, []
    if math.isfinite(mean):
        kind, how = good, "as large as"
        if not NIS_LOW <= mean <= NIS_HIGH:
            kind, how = (warn, "larger than") if mean > NIS_HIGH else (note, "smaller than")
        size = f"(mean NIS {number(mean, 2)}, 2 is right)"
        out.append(kind(f"The innovations are {how} the filter expects {size}."))
    if math.isfinite(p):
        out.append(_whiteness(p, report.innovation.largest_correlation))
    return out


def _whiteness(p: float, correlation: float) -> Finding:
    """Finding about whiteness; the size counts as well, because many samples make any correlation significant."""
    small = "p < 0.001" if p < 1e-3 else f"p = {number(p, 2)}"
    size = f"largest autocorrelation {number(correlation, 2)}"
    if p >= CERTAIN:
        return good(f"The innovations are white noise ({small}): the filter has used all of the pressures.")
    if abs(correlation) < FAINT:
        text = f"The innovations are nearly white: their autocorrelation is significant ({small}) but small ({size})."
        return note(text)
    if correlation > 0.0:
        return note(f"Successive innovations have the same sign ({size}): the model lacks a slow effect.")
    text = f"Successive innovations have opposite signs ({size}): the filter follows the sensors' noise too closely."
    return note(text)


def _live(report: ReplayReport) -> list[Finding]:
    live, out = report.live_equal, []
    if live is None:
        return []
    if report.live_without:
        text = f"The live filter missed part of {report.live_without} samples, which came too late. The replay leaves "
        out.append(warn(text + "them out as well."))
    if live.not_compared:
        out.append(_not_compared(live, report))
        if not live.compared:
            return out
    elif report.estimator.refused:
        out.append(note(f"The filter ran from its start: {report.estimator.refused[0]}."))
    return [*out, _equality(live, live_rig(report))]


def _not_compared(live: LiveComparison, report: ReplayReport) -> Finding:
    """Why part of the live estimate was not compared, and the differences there."""
    why = joined(live.why_not)
    text = f"{live.not_compared} live estimates were not compared bit for bit: {why}."
    if live.apart_deg is not None:
        largest, last = (number(value, 2) for value in live.apart_deg)
        text += f" There the two angles differ by {largest}° at most, and by {last}° at the end."
    if live.why_not == (ENDED,):
        return note(text)
    if report.estimator.refused:
        text += f" A checkpoint was of no use: {report.estimator.refused[0]}."
    elif not report.estimator.resumed_ns:
        text += " The recording holds no checkpoint of the live filter (topic filter_checkpoint) to go on from."
    return note(text)


def live_rig(report: ReplayReport) -> str:
    """Sentence to add if the live filter had another rig than the replay; otherwise empty."""
    rig = report.recording.rigs.get("estimator")
    if rig is None or rig.same:
        return ""
    return f" The live filter had other values: rig {rig.name} ({rig.fingerprint})."


def _equality(live: LiveComparison, rig: str = "") -> Finding:
    if live.compared == 0:
        return warn("The recorded live estimate has no sample in common with the replay.")
    if live.equal == live.compared and not live.only_live and not live.only_replay:
        text = f"The replay equals the estimate published live, bit for bit, in all {live.compared} samples"
        return good(text + (" that were compared." if live.not_compared else "."))
    return warn(
        f"The replay equals the estimate published live in {live.equal} of {live.compared} samples "
        f"(fields that differ: {', '.join(live.differing) or 'none'}; {live.only_live} samples only live, "
        f"{live.only_replay} only here).{rig}"
    )


def _quality(report: ReplayReport) -> list[Finding]:
    counts, issues = report.estimator.counts, report.recording.issues
    out = [warn(f"{issue[:1].upper()}{issue[1:].rstrip('.')}.") for issue in issues[:_ISSUES]]
    if len(issues) > _ISSUES:
        out.append(warn(f"{len(issues) - _ISSUES} more such remarks are in report.json."))
    events = (
        (counts.outliers, "samples with a pressure outside the gate, which it left out"),
        (counts.gaps, "gaps, which it bridged by prediction"),
        (counts.repaired, "covariances that had to be repaired"),
        (counts.restarts, "restarts after a long gap or a lost estimate"),
    )
    if seen := [f"{count} {text}" for count, text in events if count]:
        out.append(note(f"The filter met {joined(seen)}."))
    if report.joint.source == "nothing":
        out.append(note("The recording does not say whether the joint could move. It was taken as free."))
    if report.joint.source == "stop":
        out.append(note("The joint rests at its stop through the whole recording, so it was taken as free."))
    return out
