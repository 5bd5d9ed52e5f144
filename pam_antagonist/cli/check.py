"""Check recordings before anything is computed from them (seconds).

The model of the rig is driven by the recorded voltages and compared with what was measured. This finds gauge
pressures and other units, exchanged pressure lines or valves, an encoder or a torque meter that counts the wrong way
round, voltages that are stamped early, topics with different clocks, channels that never move, and recordings of
another rig. For each finding it says how sure it is and what to type. replay, identify and close_loop make the same
check and refuse a recording that is certainly wrong.

Status: 0 nothing is certainly wrong, 2 something is certainly wrong, or bad input.

examples:
  {run} check my_bag --rig my_rig.yaml
  {run} check free_bag locked_bag --rig my_rig.yaml --json -
  {run} replay my_bag --rig my_rig.yaml --out result --gauge --swap-pressures
"""

from __future__ import annotations

import argparse

from pam_antagonist.cli import common
from pam_antagonist.cli.recordings import next_on_bags, note_down
from pam_antagonist.recording.corrections import Corrections, add_options, from_options
from pam_antagonist.strict_json import dumps


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("check", __doc__)
    out.shared("bags", "--rig", "--joint of a recording", "--lock-angle", "--topic", "--namespace")
    out.shared("--joint-name", help="joint in measured/joint_states (default: the first)")
    out.shared("--recover")
    out.option("--json", "write the findings there as well; - for standard output alone", metavar="FILE")
    out.shared("--no-log")
    add_options(out)
    return out


def _main(arguments: argparse.Namespace) -> int:
    from pam_antagonist.api.given import calibration
    from pam_antagonist.api.replay import check
    from pam_antagonist.recording import read_bag
    from pam_antagonist.report import terminal
    from pam_antagonist.report.document import in_first_lines
    from pam_antagonist.rig import load_rig

    rig = load_rig(arguments.rig, regulators=True)
    lock_angle = common.lock_angle(arguments)
    given = from_options(arguments, calibration(rig))
    results, measured = {}, False
    for bag in arguments.bags:
        recording = read_bag(
            bag, topics=common.topics(arguments), namespace=arguments.namespace, joint_name=arguments.joint_name,
            recover=arguments.recover, corrections=Corrections(align_clocks=given.align_clocks), judge=False,
        )  # fmt: skip
        measured = measured or recording.angle is not None
        results[str(bag)] = checked = check(recording, rig, arguments.joint, lock_angle, given)
        note_down(arguments, "check", [recording], rig, checked)
        if arguments.json != "-":
            print(f"\n{bag.name}: {recording.duration_s:.1f} s, joint {checked.joint}, against rig {rig.name}")
            print(checked.summary())
    if arguments.json != "-" and (rests_on := next(iter(results.values())).assumption) is not None:
        print(f"\n{terminal.render(in_first_lines(rests_on))}")
    wrong = [finding for checked in results.values() for finding in checked.wrong]
    needed = [checked.corrections for checked in results.values()] if wrong else [from_options(arguments)]
    # Where options make all bags right, the next command has them.
    if arguments.json != "-" and all(finding.todo for finding in wrong) and needed.count(needed[0]) == len(needed):
        # A rig that was never identified is identified first: until then a replay tells little.
        command = "identify" if measured and not rig.identified else "replay"
        print(f"\n{next_on_bags(arguments, command, arguments.bags, arguments.rig, needed[0])}")
    if arguments.json:
        content = {bag: checked.to_json() for bag, checked in results.items()}
        common.give_json(arguments.json, dumps(content) + "\n")
    return common.BAD_INPUT if any(checked.wrong for checked in results.values()) else common.DONE


main = common.command(parser, _main)
