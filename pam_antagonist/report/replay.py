"""The report of one or several replayed recordings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from typing_extensions import override

from pam_antagonist.replays.live import ENDED, LiveComparison
from pam_antagonist.replays.result import (
    ANGLE,
    CHANNELS,
    LEAST_COVERAGE,
    TORQUE,
    Covered,
    JudgedChannel,
    Replay,
    ReplayReport,
    columns,
    covered,
    joint_text,
    judged,
    numbers,
    write_estimate,
)
from pam_antagonist.report.document import (
    Block,
    Columns,
    Comparison,
    Document,
    Findings,
    Section,
    Statement,
    Table,
    Text,
    Tile,
    Tiles,
    good,
    in_first_lines,
    note,
    page,
    sentence,
    warn,
)
from pam_antagonist.report.figure import Figure
from pam_antagonist.report.replay_figures import filter_figures, replay_figures
from pam_antagonist.report.result import DataFrame, Result, frame_of
from pam_antagonist.rig.units import assumption
from pam_antagonist.shown import MISSING, listed, number, percent


@dataclass(frozen=True, eq=False, repr=False)
class ReplayResult(Replay, Result):
    """A replayed recording.

    Attributes:
        recording: the recording.
        rig: the rig as configured.
        tuning: name of the filter's tuning.
        joint: whether the joint was free or locked.
        run: M estimates; ``run.index`` are their samples in the recording.
        model: the model alone at the same samples.
        report: the numbers of ``report.json``.
        plan: where the filter was started.
    """

    @override
    def to_json(self) -> dict[str, Any]:
        return numbers([self])

    @override
    def document(self, figures: bool = True) -> Document:
        return document([self], figures)

    @override
    def save(self, path: str | Path, figures: bool = True, overwrite: bool = False) -> Path:
        """Write the report or the estimates.

        Args:
            path: of a new folder for ``report.html`` and ``report.json``, or of a new file ``*.csv`` or ``*.mcap`` for
                the estimates.
            figures: False leaves the figures out of the page.
            overwrite: True replaces an earlier result there.

        Returns:
            The path.

        Raises:
            BadInput: the path exists, or cannot be written.
        """
        path = Path(path)
        if path.suffix not in (".csv", ".mcap"):
            return super().save(path, figures, overwrite)
        write_estimate(path, self, overwrite)
        return path

    def to_dataframe(self) -> DataFrame:
        """A row for each estimate, with standard deviations and measurements (needs pandas).

        The columns are those of ``replay --save estimate.csv``; each name contains the unit.
        """
        return frame_of(columns(self))


def document(replays: Sequence[Replay], with_figures: bool = True) -> Document:
    """The page of one or several recordings; without figures it lacks plotly's 2 MB."""
    reports, several = [replay.report for replay in replays], len(replays) > 1
    seconds = sum(report.duration_s for report in reports)
    lede = (
        f"The estimator that runs live was run again on {seconds:.0f} s of recorded muscle pressures and valve "
        "voltages. The report compares its angle and torque with the measured ones."
    )
    shown = [replay_figures(replay) if with_figures else () for replay in replays]
    # The first figure comes before all tables, so that it is on the first screen.
    first, shown[0] = shown[0][:1], shown[0][1:]
    parts: list[Block] = [
        *(replace(one, title=f"{replays[0].name}: {one.title}") if several else one for one in first),
        *in_first_lines(assumption(replays[0].rig, replays[0].tuning)),
        *((overview(reports),) if several else ()),
    ]
    for place, (replay, figures) in enumerate(zip(replays, shown, strict=True), 1):
        own = _recording(replay, figures, with_figures)
        if several:
            above = " Its first figure is at the top of the page." if first and place == 1 else ""
            own = (Section(replay.name, (Text(verdict([replay.report]) + above), *own), 2, f"r{place}"),)
        parts += own
    kicker, title = "Replay of a pneumatic muscle joint", f"{len(reports)} recordings" if several else replays[0].name
    return page(kicker, title, parts, "replay", _provenance(replays), lede, verdict(reports))


def _recording(replay: Replay, figures: Sequence[Figure], with_figures: bool) -> tuple[Block, ...]:
    report, inside = replay.report, filter_figures(replay) if with_figures else ()
    joint, length = report.joint, f"{report.duration_s:.1f} s, {report.samples} samples"
    about = (
        f"{replay.name}: {length}, joint {joint.condition} (source: {joint.source}); rig {replay.rig.name}, tuning "
        f"{replay.tuning}, {report.realtime_factor:.1f} × real time."
    )
    beside = Columns(Findings(findings(report)), errors_table(report, "Errors. The smaller one is bold."))
    folded = Section("Innovations, valve voltages and active equations", inside, folded=True)
    return Tiles(tiles(report)), Text(about), beside, *figures, *((folded,) if inside else ())


def _provenance(replays: Sequence[Replay]) -> list[tuple[str, str]]:
    rig, name = replays[0].rig, replays[0].tuning
    tuning = rig.tuning(name)
    rows = [
        ("Rig", rig.name),
        ("Source of its values", rig.source.strip()),
        ("Filter tuning", f"{name}: κ {tuning.kappa:g}, gate {tuning.gate:g} standard deviations"),
        ("Process noise Q, a step", ", ".join(f"{value:g}" for value in tuning.process) + " [rad², rad²/s², Pa², Pa²]"),
        ("Measurement noise R", ", ".join(f"{value:g}" for value in tuning.measurement) + " [Pa²]"),
    ]
    if tuning.consider and rig.uncertainty:
        known = ", ".join(f"{name} ± {std:g}" for name, std in rig.uncertainty.items())
        rows.append(("Parameters carried as uncertain", known))
    for report in (replay.report for replay in replays):
        about = f"{joint_text(report.joint)}; source: {report.joint.source}"
        rows += [
            (f"Recording {report.recording.name}", f"SHA-256 {report.recording.sha256}"),
            ("Its joint and length", f"{about}; {report.samples} samples, {report.duration_s:.3f} s"),
        ]
    return rows


def tiles(report: ReplayReport) -> tuple[Tile, ...]:
    """The most important numbers of one recording."""
    known, right = judged(report), "should be about 95 % or more"
    errors = (
        Tile(f"{channel.title} error (RMS)", channel.write(ukf.rmse), f"model alone {channel.write(model.rmse)}")
        for channel, ukf, model in known
    )
    inside = (Tile(f"{one.channel.title} in the 95 % interval", percent(one.coverage), right) for one in known)
    return *errors, *inside


def errors_table(report: ReplayReport, caption: str = "") -> Table:
    """Errors of the filter and of the model alone, for one recording."""
    out = Comparison("", "UKF", "model alone")
    known = {item.channel: item for item in judged(report)}
    for channel in CHANNELS:
        if channel.of(report.ukf) is None:
            out.heading(f"{channel.title}: not measured")
        elif channel not in known:
            out.heading(f"{channel.title}: {joint_text(report.joint)}")
        else:
            ukf, model = known[channel].ukf, known[channel].model
            out.heading(channel.title)
            out.values(f"  RMSE [{channel.unit}]", (ukf.rmse, model.rmse))
            out.values(f"  largest error [{channel.unit}]", (ukf.largest, model.largest))
            out.values("  largest error over measured range", (ukf.ratio, model.ratio), percent)
            out.text("  in the 95 % interval", percent(ukf.coverage95), MISSING)
            nees = getattr(report.innovation, f"nees_{channel.name}")
            out.text("  mean NEES (1 is right)", number(nees, 2), MISSING)
    if external := report.ukf.external_torque:
        late = external.delay_s
        out.heading("External torque")
        out.text("  RMSE [N m]", number(external.rmse), "given")
        out.text("  in the 95 % interval", percent(external.coverage95), MISSING)
        out.text("  delay [ms]", MISSING if late is None or math.isnan(late) else f"{1e3 * late:.0f}", MISSING)
    out.heading("Pressure")
    for muscle in (0, 1):
        errors = [model.pressure.rmse_pa[muscle] for model in (report.ukf, report.model_alone)]
        out.pressures(f"  RMSE, muscle {muscle + 1}", errors)
    return out.table(caption)


def overview(reports: Sequence[ReplayReport]) -> Table:
    """Errors of all recordings, one row for each."""
    header = ["Recording", "joint"]
    for channel in CHANNELS:
        header += [f"{channel.name} RMSE [{channel.unit}]", "model alone", "in 95 %"]
    rows = []
    for report in reports:
        row, known = [report.recording.name, joint_text(report.joint)], {item.channel: item for item in judged(report)}
        for channel in CHANNELS:
            one = known.get(channel)
            errors = (None, None) if one is None else (one.ukf.rmse, one.model.rmse)
            row += [*map(number, errors), percent(None if one is None else one.coverage)]
        rows.append(tuple(row))
    about = "Errors of the filter and of the model alone; share of measured values in the filter's 95 % interval"
    return Table(tuple(header), tuple(rows), about)


CONSTANT = 0.95
"""Share of the RMS error from which on a mean error is called the same at each sample: the rest is a third of it."""
_ZEROS = {
    ANGLE.name: (ANGLE, "encoder", "--encoder-zero"),
    TORQUE.name: (TORQUE, "torque meter", "--torque-zero"),
}
"""The sensor of a channel, and the option that moves its zero."""
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
    return f"From the two pressures alone, the estimator gives {listed(known)} ({what}).{held}"


def findings(report: ReplayReport) -> tuple[Statement, ...]:
    """All findings of one recording."""
    if report.duration_s < SHORTEST_S:
        text = f"{report.duration_s:.3f} s is too short to judge the filter by; expected {SHORTEST_S:g} s or more."
        return (warn(text), *_live(report), *_quality(report))
    known = judged(report)
    against = [_against_model(item) for item in known]
    return (*against, *_honesty(covered(report)), *_innovations(report), *_live(report), *_quality(report))


def _against_model(item: JudgedChannel) -> Statement:
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


def _constant(item: Covered) -> bool:
    """Whether too few values lie in the interval since nearly the whole error is the same at each sample."""
    mean = item.errors.mean
    known = item.what in _ZEROS and mean is not None and item.coverage < LEAST_COVERAGE
    return known and abs(mean or 0.0) >= CONSTANT * item.errors.rmse


def _zero(item: Covered) -> Statement:
    """A zero that is missing."""
    channel, sensor, option = _ZEROS[item.what]
    by = -(item.errors.mean or 0.0)
    return warn(
        f"{channel.title}: the error is nearly the same at each sample. The {sensor} seems to read "
        f"{channel.write(abs(by))} too {'high' if by > 0.0 else 'low'}. To correct that, type {option} {by:.4g}."
    )


def _honesty(known: Sequence[Covered]) -> list[Statement]:
    if constant := [item for item in known if _constant(item)]:
        return [*map(_zero, constant), *_honesty([item for item in known if not _constant(item)])]
    if not known:
        return []
    shares = [f"{percent(item.coverage)} of the measured {item.what}s" for item in known]
    holds = f"its 95 % interval holds {listed(shares)}"
    how = [item.honesty for item in known]
    if "too small" in how:
        which = listed([item.what for item in known if item.honesty == "too small"])
        return [warn(f"The filter's covariance is too small for the {which}: {holds}.")]
    if "not told" in how:
        return [note(f"Too few independent errors to judge the filter's covariance: {holds}.")]
    wide = [item for item in known if item.honesty == "larger than needed"]
    if not wide:
        return [good(f"The filter's covariance is honest: {holds}.")]
    times = [f"that of the {item.what} {number((item.errors.width or 0.0) / 1.96, 2)} times" for item in wide]
    larger = f"The standard deviations are larger than the RMS errors: {listed(times)}."
    return [note(f"The filter's covariance is larger than needed: {holds} and is wide. {larger}")]


def _innovations(report: ReplayReport) -> list[Statement]:
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


def _whiteness(p: float, correlation: float) -> Statement:
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


def _live(report: ReplayReport) -> list[Statement]:
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


def _not_compared(live: LiveComparison, report: ReplayReport) -> Statement:
    """Why part of the live estimate was not compared, and the differences there."""
    why = listed(live.why_not)
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


def _equality(live: LiveComparison, rig: str = "") -> Statement:
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


def _quality(report: ReplayReport) -> list[Statement]:
    counts, issues = report.estimator.counts, report.recording.issues
    out = [warn(sentence(issue)) for issue in issues[:_ISSUES]]
    if len(issues) > _ISSUES:
        out.append(warn(f"{len(issues) - _ISSUES} more such remarks are in report.json."))
    events = (
        (counts.outliers, "samples with a pressure outside the gate, which it left out"),
        (counts.gaps, "gaps, which it bridged by prediction"),
        (counts.repaired, "covariances that had to be repaired"),
        (counts.restarts, "restarts after a long gap or a lost estimate"),
    )
    if seen := [f"{count} {text}" for count, text in events if count]:
        out.append(note(f"The filter met {listed(seen)}."))
    if report.joint.source == "nothing":
        out.append(note("The recording does not say whether the joint could move. It was taken as free."))
    if report.joint.source == "stop":
        out.append(note("The joint rests at its stop through the whole recording, so it was taken as free."))
    return out
