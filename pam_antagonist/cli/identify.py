"""Identify a rig from its recordings: parameters with error bars, sensor noise, filter tuning.

Give recordings of a joint that moves (free) and of one that is held (locked), with angle and torque measured
where you can. The end of each is not fitted but kept to judge the result by. A rig with pressure regulators (drive:
regulator) takes many short episodes in one recording as well (import_csv), of which whole ones are held out.

A rig whose muscles have the force of a data sheet (new_rig, or model.force: braided) is identified from its measured
pressures: first joint and muscles, then valves or regulators, then the filter's noise. It needs a free joint with its
angle, a few minutes or a dozen trials of 5 to 20 s. Of four trials or more, every third is kept whole to judge the
result by.

Writes DIR/rig.yaml, which every command and node takes, DIR/report.html and DIR/report.json; of several
recordings also DIR/rig_1.yaml, rig_2.yaml ..., each with one recording's own values. A rig that should not be used (the
model diverges with it, the search ended at a bound, or it is worse on held-out data than the rig file) is written as
DIR/rig_rejected.yaml alone; the first sentence says why.
Status: 0 done, 1 the rig was rejected, 2 bad input (one line says what and where).

examples:
  {run} identify free_bag locked_bag --rig shin2022 --out identified
  {run} identify my_bag --rig my_rig.yaml --out identified --freeze muscle_1.force --freeze muscle_2.force
  {run} identify my_bag --rig my_rig.yaml --out identified --free joint.stiffness --starts 4 --seed 7
  {run} identify sealed_bag --rig sealed_joint --out identified     (valves.sealed: true in the rig file)
  {run} identify trial_* --rig my_rig.yaml --out identified     (a rig file of new_rig)
  {run} replay another_bag --rig identified/rig.yaml --out check
"""

from __future__ import annotations

import argparse

from pam_antagonist.cli import common
from pam_antagonist.cli import recordings as given
from pam_antagonist.cli.common import real, whole
from pam_antagonist.cli.progress import phases


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("identify", __doc__)
    given.add_bags(out)
    out.repeated(
        "--free", "fit this parameter as well: its name, such as supply.pressure, or the beginning of its name; may be "
        "repeated", "NAME",
    )  # fmt: skip
    freeze = "keep this parameter as configured: its name, or the beginning of its name; may be repeated"
    out.repeated("--freeze", freeze, "NAME")
    share = "share at the end of each recording that is held out to judge the result (default: a third)"
    out.option("--holdout", share, real(0.05, 0.8, "a share"), 1.0 / 3.0, "SHARE")
    out.option("--starts", "starts of the search (default: 1)", whole(1, 64), 1, "N")
    out.shared("--seed", help="seed of the further starts (default: 0)")
    out.shared("--jobs", "--dask")
    given.add_names_and_report(out)
    out.shared("--no-log")
    return out


def _run(arguments: argparse.Namespace) -> int:
    from pam_antagonist.api.diagnose import IdentifyResult, identify
    from pam_antagonist.api.ways import EPISODES, way
    from pam_antagonist.cli.first_start import FITS
    from pam_antagonist.report import terminal
    from pam_antagonist.report.document import Findings, warn

    rig = given.begun(arguments, FITS)
    recordings = given.read(arguments, rig)
    kind = way(recordings, rig)
    kind.refuse("identify", {
        name: getattr(arguments, name) for name in ("joint", "lock_angle", "free", "freeze", "starts", "seed", "dask")
    }, "--")  # fmt: skip
    if kind is not EPISODES and (damage := given.damage(arguments, recordings)):
        print(terminal.render([Findings(tuple(map(warn, damage)))]))
    with given.connected(arguments.dask), phases("identify") as progress:
        found = identify(
            recordings, rig, joint=arguments.joint, lock_angle=arguments.lock_angle, free=arguments.free,
            freeze=arguments.freeze, holdout=arguments.holdout, starts=arguments.starts, seed=arguments.seed,
            jobs=arguments.jobs, progress=progress,
        )  # fmt: skip
    given.announce(arguments, found, None if found.rejected else "rig.yaml", apart=True)
    identified = arguments.out / "rig.yaml"
    given.note_down(arguments, "identify", recordings, rig, found, None if found.rejected else identified)
    if found.rejected or (isinstance(found, IdentifyResult) and found.lacks_an_effect):
        # The next command takes the rig that was given.
        print(given.next_on_bags(arguments, "close_loop", arguments.bags, arguments.rig))
    elif isinstance(found, IdentifyResult):
        print(given.next_on_bags(arguments, "replay", None, identified))
    else:
        print(given.next_on_bags(arguments, "close_loop", arguments.bags, identified))
    return common.FAILED if found.rejected else common.DONE


main = common.command(parser, _run)
