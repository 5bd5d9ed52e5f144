"""Update an identified rig by one more recording.

Friction and leaks change from day to day, forces a little, geometry not at all. So each number of the rig file may walk
from its value, by as much as such numbers do. What the recording does not determine stays. Half a minute of a free
joint with its angle is enough; identify would need several minutes.

The last third of the recording is not fitted. The rig file as it was is kept unless the filter's error falls by a
tenth, there and on the whole recording: DIR then has no rig.yaml, and the status is 1. A recording of another rig, and
one in which nothing moves, is refused.

Writes DIR/rig.yaml, DIR/report.html and DIR/report.json, as identify does.
Status: 0 done, 1 the rig as it was is kept, 2 bad input (one line says what and where).

examples:
  {run} adapt todays_bag --rig identified/rig.yaml --out monday
  {run} adapt todays_bag --rig monday/rig.yaml --out tuesday
"""

from __future__ import annotations

import argparse

from pam_antagonist.cli import common
from pam_antagonist.cli import recordings as given
from pam_antagonist.cli.progress import phases


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("adapt", __doc__)
    given.add_bags(out)
    out.shared("--jobs")
    given.add_names_and_report(out)
    out.shared("--no-log")
    return out


def _run(arguments: argparse.Namespace) -> int:
    from pam_antagonist.api.adapt import adapt
    from pam_antagonist.cli.first_start import FITS

    rig = given.begun(arguments, FITS)
    recordings = given.read(arguments, rig)
    with phases("adapt") as progress:
        found = adapt(
            recordings, rig, joint=arguments.joint, lock_angle=arguments.lock_angle, jobs=arguments.jobs,
            progress=progress,
        )  # fmt: skip
    given.announce(arguments, found, None if found.rejected else "rig.yaml", apart=True)
    adapted = arguments.out / "rig.yaml"
    given.note_down(arguments, "adapt", recordings, rig, found, None if found.rejected else adapted)
    if found.rejected:
        print(f"rig: {arguments.rig}, as it was")
        return common.FAILED
    print(given.next_on_bags(arguments, "replay", None, adapted))
    return common.DONE


main = common.command(parser, _run)
