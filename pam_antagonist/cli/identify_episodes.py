"""``identify`` for a joint with pressure regulators: many episodes in the place of one long recording."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from pam_antagonist.cli import common
from pam_antagonist.cli import recordings as given
from pam_antagonist.errors import BadInput
from pam_antagonist.identification.episodes import identify
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.recording import Recording, bag_hash, bag_name
from pam_antagonist.report import html, terminal
from pam_antagonist.report import identify_episodes as report
from pam_antagonist.rig import Rig
from pam_antagonist.rig.write import write_rig


def run(arguments: argparse.Namespace, rig: Rig, recordings: Sequence[Recording]) -> int:
    """Identify, write the report and the rig.

    Args:
        arguments: of the command.
        rig: whose pressures regulators hold.
        recordings: one, of many episodes.

    Raises:
        BadInput: recordings from which nothing can be learned, or an option that episodes do not take.
    """
    if len(recordings) > 1:
        raise BadInput("a recording of many episodes: expected it alone, as it is a series by itself")
    if arguments.dask is not None:
        raise BadInput("--dask: episodes are fitted on this machine; leave it out")
    for name in ("free", "freeze"):
        if getattr(arguments, name):
            raise BadInput(f"--{name}: what episodes tell of a joint is fixed; leave it out")
    recording = recordings[0]
    joint = PressureDriven.of(recording, rig, jobs=arguments.jobs)
    found = identify(
        joint, arguments.holdout, lambda text: print(f"identify: {text}", file=sys.stderr, flush=True)
    )  # fmt: skip
    sha256 = bag_hash(recording.path)
    with common.output_folder(arguments.out) as folder:
        html.write(folder, report.document(found, joint, sha256), report.numbers(found, sha256))
        source = f"identified from {bag_name(recording.path)}; started from: {rig.source.strip()}"
        identified = found.rig.replaced(name=f"{rig.name}_identified", source=" ".join(source.split()))
        write_rig(
            identified, folder / "rig.yaml",
            [f"By pam_antagonist identify, from rig {rig.name} and {found.counts[0]} episodes of {joint.name}."],
        )  # fmt: skip
    print(terminal.render(report.summary(found, joint)))
    given.announce_output(arguments)
    print(common.next_command("close_loop", arguments.bags, f"--rig {arguments.out / 'rig.yaml'} --out DIR"))
    return common.DONE
