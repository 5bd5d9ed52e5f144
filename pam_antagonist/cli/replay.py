"""Run recordings through the estimator again and report its errors.

The unscented Kalman filter gets the recorded pressures and valve voltages, and with --angle-sensor encoder the
encoder's angle, by the code that runs live; the model alone gets the voltages. Both are compared with the measured
angle and torque, where the bag has them. Where it has the estimate that was published live, the two are compared bit
by bit. If a bag holds several joints, each is replayed, all with the same rig; --namespace selects one.

Writes DIR/report.json and DIR/report.html. Status: 0 done, 2 bad input (one line says what and where).

examples:
  {run} replay my_bag --rig shin2022 --out result
  {run} replay free_bag locked_bag --rig my_rig.yaml --out result --tuning published
  {run} replay my_bag --rig shin2022 --out result --save estimate.mcap
  {run} replay my_bag --rig shin2022 --out result --from 3540
  {run} replay my_bag --rig shin2022 --out result --topic pressure_1=/arm/p1 --topic pressure_2=/arm/p2
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from pam_antagonist.cli import common
from pam_antagonist.cli import recordings as given
from pam_antagonist.cli.progress import counted
from pam_antagonist.errors import BadInput
from pam_antagonist.recording.corrections import add_options

if TYPE_CHECKING:
    from pam_antagonist.api.replay import ReplayResult
    from pam_antagonist.rig import Rig

_LEAST_S = 20.0
"""[s] Shorter recordings are not worth a search for an effect."""


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("replay", __doc__)
    out.shared("bags", "--rig")
    tuning = "the rig's filter tuning: default, published, ... (default: default)"
    out.option("--tuning", tuning, None, "default", "NAME")
    out.shared("--out", help="folder for the report; a new one")
    out.option(
        "--save", "write the estimate with its covariance and innovations as well: a new .csv, or .mcap for "
        "PlotJuggler and Foxglove; for one recording only", Path, metavar="FILE",
    )  # fmt: skip
    out.shared("--joint of a recording", "--lock-angle")
    out.option(
        "--from", "estimate from this time of the recording on; if the bag has a checkpoint of the live filter, the "
        "filter continues from it, and the estimates equal those of a full replay (default: the whole recording)",
        float, metavar="SECONDS", dest="begin",
    )  # fmt: skip
    out.option(
        "--angle-sensor", "encoder: topic angle_sensor is an input of the filter as well; auto: the same as in the "
        "live filter if the recording shows that, else none (default: auto)",
        default="auto", choices=("auto", "none", "encoder"),
    )  # fmt: skip
    out.shared("--topic", "--joint-name")
    out.shared("--namespace", help="namespace of the joint, where the bag holds several")
    out.option(
        "--restarts", "if the clock was set back while recording: refuse the bag, or read the part after the last time "
        "(default: refuse)", default="refuse", choices=("refuse", "last"),
    )  # fmt: skip
    out.shared("--recover")
    add_options(out)
    out.shared("--no-check", "--json", "--no-figures", "--open")
    return out


def _run(arguments: argparse.Namespace) -> int:
    from pam_antagonist.cli.first_start import REPLAY
    from pam_antagonist.replays.result import check_estimate, numbers
    from pam_antagonist.report import html
    from pam_antagonist.report.replay import document

    if arguments.save is not None:
        if len(arguments.bags) > 1:
            raise BadInput(f"--save: expected one recording, got {len(arguments.bags)}")
        check_estimate(arguments.save)
    rig = given.begun(arguments, REPLAY)
    rig.tuning(arguments.tuning)
    replays: list[ReplayResult] = []
    for bag in arguments.bags:
        replays += _replays(bag, rig, arguments)
    with common.output_folder(arguments.out) as folder:
        html.write(folder, document(replays, not arguments.no_figures), numbers(replays))
    for done in replays:
        print(f"\n{done.summary()}")
    print()
    if arguments.save is not None:
        replays[0].save(arguments.save)
        print(f"estimate: {arguments.save}")
    common.announce_report(arguments, arguments.out)
    if not rig.identified and sum(done.report.duration_s for done in replays) >= _LEAST_S:
        # An identified rig is not fitted again to what it is judged by.
        print(given.next_on_bags(arguments, "close_loop", arguments.bags, arguments.rig))
    return common.DONE


def _replays(bag: Path, rig: Rig, arguments: argparse.Namespace) -> Iterator[ReplayResult]:
    """The one joint of a bag, or each of its joints."""
    from pam_antagonist.recording import SeveralJoints

    try:
        yield _replay(bag, arguments.namespace, rig, arguments)
    except SeveralJoints as found:
        if arguments.topic or arguments.save is not None:
            raise
        for namespace in found.namespaces:
            yield _replay(bag, namespace, rig, arguments)


def _replay(bag: Path, namespace: str | None, rig: Rig, arguments: argparse.Namespace) -> ReplayResult:
    from pam_antagonist.api.replay import replay

    begin = time.perf_counter()
    how = {name: getattr(arguments, name) for name in ("joint_name", "restarts", "recover")}
    recording = given.read_one(bag, rig, arguments, topics=common.topics(arguments), namespace=namespace, **how)
    read_seconds = time.perf_counter() - begin
    with counted(len(recording.stamp_ns), f"replay {bag.name}") as done:
        return replay(
            recording, rig, arguments.tuning, arguments.joint, arguments.lock_angle, done, read_seconds,
            arguments.begin, arguments.angle_sensor,
        )  # fmt: skip


main = common.command(parser, _run)
