"""Apply close_loop to a real arm's recording, compare it with models without physics, show drift and regulators.

FILE is the CSV of docs/evidence/measured.md, which is not part of this package. Other files with the same columns can
be used as well. Writes DIR/report.html and DIR/report.json, and with --docs what the page shows. It takes some minutes.

examples:
  {run} pamy pamy_joint0.csv --out result
  {run} pamy pamy_joint0.csv --out result --docs shown.md
"""

from __future__ import annotations

import argparse
import hashlib
import re
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from pam_antagonist import identify
from pam_antagonist.api.history import history, log
from pam_antagonist.cli import common
from pam_antagonist.cli.common import JOBS
from pam_antagonist.diagnosis.episodes import EpisodeDiagnosis, Row, diagnose
from pam_antagonist.identification.episode_filter import with_filter
from pam_antagonist.identification.regulators import of_commands, pressures_of
from pam_antagonist.inference.bootstrap import Interval, rmse
from pam_antagonist.inference.episodes import whole_episodes
from pam_antagonist.inference.held_episodes import EpisodeSplit, held_out
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.optional import available
from pam_antagonist.recording.csv_import import read_csv
from pam_antagonist.recording.csv_map import load_map
from pam_antagonist.recording.recording import Recording
from pam_antagonist.report import episodes as report
from pam_antagonist.report import html
from pam_antagonist.report.document import Block, Findings, Section, Statement, Text, note, number, percent
from pam_antagonist.report.history import HistoryResult
from pam_antagonist.report.identify_episodes import interval, regulators_sentences, regulators_table
from pam_antagonist.rig import load_rig
from validation import frame
from validation.at_hand import ARM_SIGNALS
from validation.peers import soft_sensors
from validation.peers.joints import Course, Floats
from validation.peers.soft_sensors import LAGS_S, Sensed, late, least_squares

_SHARE = 1.0 / 3.0
PARTS, _FEWEST = 8, 30
"""Parts of the day, and episodes in each at least."""
_DATE_NS = 1_565_136_000 * 10**9
"""7 August 2019, from which the episodes are counted: the file has no date."""
_RIG = """\
based_on: regulator_joint
name: arm
source: stand-ins
effects:
  friction_by_pressure: {slope_1: 4.0e-7, slope_2: 4.0e-7}
"""


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("pamy", __doc__)
    out.add_argument("file", type=Path, metavar="FILE", help="the CSV file")
    out.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder of the report; a new one")
    frame.add_docs(out, "tables and sentences")
    out.add_argument("--jobs", type=JOBS, default=2, metavar="N", help="threads (default: 2)")
    out.add_argument("--no-figures", action="store_true", help="leave the figure out of report.html")
    out.shared("--json", "--open")
    return out


def _run(arguments: argparse.Namespace) -> int:
    common.check_output(arguments.out)
    recording = read_csv(arguments.file, load_map("pamy_joint0"))
    begin = time.perf_counter()
    joint = PressureDriven.of(recording, load_rig("regulator_joint", regulators=True), ARM_SIGNALS, arguments.jobs)
    held = held_out(len(joint), _SHARE)
    found = diagnose(joint, _SHARE, progress=_progress)
    baselines = without_physics(joint, held)
    regulators = of_commands(joint, held, _progress)
    commanded = by_commands(found, joint, held, pressures_of(regulators, joint))
    started = regulators.on(report.extended(found, joint))
    whole = whole_episodes(recording, joint.rig.signals)
    filtered = with_filter(started, recording, whole, _SHARE, None, arguments.jobs, _progress)
    book = by_parts(recording, arguments.jobs)
    took = time.perf_counter() - begin
    digest = hashlib.sha256(arguments.file.read_bytes()).hexdigest()
    result = report.EpisodesDiagnoseResult(found, joint, (digest,), filtered)
    with common.output_folder(arguments.out) as folder:
        html.write(folder, result.document(not arguments.no_figures), {
            **result.to_json(), "baselines_deg": baselines, "commanded_deg": commanded,
            "regulators": regulators.to_json(), "took_s": took,
        })  # fmt: skip
    rows = (found.rows[0], *baselines, *found.rows[1:])
    recent = found.rows[-1].later
    numbers = len(found.model.theta) + len(found.model.free)
    weak = 0 if found.weak is None else len(found.weak[0].terms)
    slopes = (Section("What torque and friction go with", (report.slopes_table(found, joint.rig),)),)
    blocks = [
        Section("What the model lacks", (Text(report.verdict(found)), _left(report.findings(found, joint)))),
        Section("Errors", (report.errors_table(replace(found, rows=rows)), Text(
            f"The model has {numbers} numbers with a name, and {weak} of weak laws and their drift. Its 95 % interval "
            f"holds {percent(found.coverage[0])} and {percent(found.coverage[1])} of the angles."
        ))),
        Section("Numbers", (report.values_table(found, joint.rig),)),
        *(slopes if found.slopes else ()),
        *([] if book is None else [of_the_day(book)]),
        Section("The regulators", (
            regulators_table(regulators, joint.rig), _left(map(note, regulators_sentences(regulators))),
            Text(f"With these regulators' pressures in the place of the measured ones, the extended model errs by "
                 f"{interval(commanded)}° on later episodes, with the measured ones by "
                 f"{interval(recent)}°: {number(commanded.value - recent.value, 2)}° less."),
        )),
        *([] if filtered is None else [Section("The filter", (Text(
            "From commands and measured pressures alone: each episode starts it anew, with an angle that friction "
            f"leaves unknown. {filtered.sentence}"
        ),))]),
        Text(f"The command took {took:.0f} s."),
    ]  # fmt: skip
    frame.show(blocks, arguments)
    common.announce_report(arguments, arguments.out)
    return common.DONE


def _progress(text: str) -> None:
    print(f"pamy: {text}", file=sys.stderr, flush=True)


def _left(found: Iterable[Statement]) -> Findings:
    """What was found; what was tried and left is in ``report.html``, numbers that change are in the table."""
    others = re.compile("is not needed|is left as configured|^These numbers change")
    return Findings(tuple(item for item in found if not others.search(item.text)))


def course(joint: PressureDriven, others: bool) -> Course:
    """Episodes as soft sensors take them. `others`: with the further signals."""
    begin = np.repeat(joint.first[:-1], np.diff(joint.first))
    inputs = np.column_stack([joint.pressure, joint.signals] if others else [joint.pressure]) / 1e5
    return Course(inputs, joint.angle, np.ones(len(begin), bool), begin, float(np.median(np.diff(joint.time[:100]))))


def _trees(fit: Sequence[Course], held: Sequence[Course]) -> Sensed:
    """Boosted trees of scikit-learn, as they come."""
    from sklearn.ensemble import HistGradientBoostingRegressor  # type: ignore[import-not-found,import-untyped,unused-ignore]

    fitted = HistGradientBoostingRegressor(random_state=0).fit(late(fit[0], LAGS_S), fit[0].angle)
    return Sensed([np.asarray(fitted.predict(late(one, LAGS_S))) for one in held], None, 0)


def by_commands(found: EpisodeDiagnosis, joint: PressureDriven, held: EpisodeSplit, pressure: Floats) -> Interval:
    """Error on later episodes with what regulators make of their commands in the place of measured pressures (N, 2)."""
    if found.weak is None:
        later = replace(joint, pressure=pressure, longest_step=found.longest_step).take(held.later)
        return rmse(*later.squares(later.residual(found.model)))
    fit, model = found.weak
    return rmse(*replace(fit, joint=replace(fit.joint, pressure=pressure)).squares(held.later, model, joint.jobs))


def without_physics(joint: PressureDriven, held: EpisodeSplit) -> tuple[Row, ...]:
    """Errors of models without physics, fitted and judged on the episodes on which the joint's model is."""
    kinds: list[tuple[str, soft_sensors.Sensor, bool]] = [
        ("static map of the two pressures", soft_sensors.linear, False),
        ("half a second of the pressures, linear", least_squares(LAGS_S), False),
        ("the same with the other joint's", least_squares(LAGS_S), True),
    ]
    if available("sklearn"):
        kinds.append(("half a second, boosted trees, with the other joint's", _trees, True))
    if available("torch"):
        kinds.append(("recurrent network, GRU, 2 × 64", soft_sensors.recurrent, True))
    else:
        _progress("the recurrent network is left out: torch is not installed")
    later, between = joint.take(held.later), joint.take(held.interleaved)
    pool = joint.take(held.pool)
    rows = []
    for name, sensor, others in kinds:

        def errors(
            fit: PressureDriven, *asked: PressureDriven, sensor: soft_sensors.Sensor = sensor, others: bool = others
        ) -> list[Interval]:
            said: list[Floats] = sensor([course(fit, others)], [course(one, others) for one in asked]).angle
            return [rmse(*one.squares((one.angle - angle)[:, None])) for one, angle in zip(asked, said, strict=True)]

        rows.append(Row(name, *errors(pool, later, between)))
    return tuple(rows)


def by_parts(recording: Recording, jobs: int) -> HistoryResult | None:
    """The log book after ``identify`` of each part of a recording; None: there are too few episodes."""
    begins = recording.episode_ns
    if begins is None or len(begins) < PARTS * _FEWEST:
        return None
    bounds = [*(part[0] for part in np.array_split(begins, PARTS)), np.iinfo(np.int64).max]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "arm.yaml"
        file.write_text(_RIG, encoding="utf-8")
        rig = load_rig(file, regulators=True)
        later = _DATE_NS - int(recording.stamp_ns[0])
        for k, (low, high) in enumerate(pairwise(bounds), 1):
            _progress(f"part {k} of {PARTS}")
            part = recording.take(np.flatnonzero((recording.stamp_ns >= low) & (recording.stamp_ns < high)))
            part = replace(
                part, path=Path(f"part_{k}"), stamp_ns=part.stamp_ns + later,
                episode_ns=begins[(begins >= low) & (begins < high)] + later,
            )  # fmt: skip
            log("identify", file, [part], rig, identify(part, rig, jobs=jobs))
        return history(file)


def of_the_day(book: HistoryResult) -> Block:
    """What the log book says."""
    return Section("The day in eight parts", (book.values_table(), Findings(tuple(book.findings()))))


main = common.command(parser, _run)
