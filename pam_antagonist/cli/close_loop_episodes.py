"""``close_loop`` for a joint with pressure regulators: many episodes in the place of one long recording."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from pam_antagonist.cli import common
from pam_antagonist.cli import recordings as given
from pam_antagonist.diagnosis.episodes import EpisodeDiagnosis, diagnose
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.recording import Recording, bag_hash
from pam_antagonist.report import episodes as report
from pam_antagonist.report import html, terminal
from pam_antagonist.rig import Rig
from pam_antagonist.rig.write import write_rig


def run(arguments: argparse.Namespace, rig: Rig, share: float, recordings: Sequence[Recording]) -> int:
    """Diagnose, write the report and the extended rig.

    Args:
        arguments: of the command.
        rig: whose pressures regulators hold.
        share: of the episodes that is held out at the end.
        recordings: with the one that is held out as a whole behind, where there is one.

    Raises:
        BadInput: recordings from which nothing can be learned.
    """
    if arguments.dask is not None:
        raise BadInput("--dask: episodes are fitted on this machine; leave it out")
    if len(arguments.bags) > 1 or len(recordings) > 2:
        raise BadInput(f"rig {rig.name} has pressure regulators: expected one recording, and one to hold out at most")
    first = PressureDriven.of(recordings[0], rig, arguments.also, arguments.jobs)
    later = PressureDriven.of(recordings[1], first.rig, jobs=arguments.jobs) if recordings[1:] else None
    found = diagnose(first, share, later, lambda text: print(f"close_loop: {text}", file=sys.stderr, flush=True))
    hashes = tuple(bag_hash(recording.path) for recording in recordings)
    with common.output_folder(arguments.out) as folder:
        content = report.document(found, first, hashes, not arguments.no_figures)
        html.write(folder, content, report.numbers(found, first, hashes))
        _write_rig(folder, first, found)
    print(terminal.render(report.summary(found, first)))
    given.announce_output(arguments, "rig_extended.yaml")
    return common.DONE


def _write_rig(folder: Path, joint: PressureDriven, found: EpisodeDiagnosis) -> None:
    """The extended rig, with the further signals that it needs."""
    values = joint.values(found.model)
    rig = moved(joint.rig, values)
    needed = [path for path in values if "_by_signal." in path]
    last = max((int(path[-1]) for path in needed), default=0)
    signals = dict(list(joint.rig.signals.items())[:last])
    source = f"extended by close_loop from {joint.name}; started from: {joint.rig.source}"
    write_rig(
        rig.replaced(name=f"{joint.rig.name}_extended", source=source, signals=signals), folder / "rig_extended.yaml",
        [f"By pam_antagonist close_loop, from rig {joint.rig.name}. {report.verdict(found)}"],
    )  # fmt: skip
