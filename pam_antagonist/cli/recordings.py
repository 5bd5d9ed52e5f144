"""What the commands share that learn from recordings: their arguments, and reading the bags."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pam_antagonist.cli import common
from pam_antagonist.errors import BadInput
from pam_antagonist.program import typed
from pam_antagonist.recording import corrections

if TYPE_CHECKING:
    from pam_antagonist.recording import Recording
    from pam_antagonist.report.result import Result
    from pam_antagonist.rig import Rig


def add_bags(parser: common.Parser) -> None:
    """Bags, rig, new folder, and whether the joint could move."""
    common.add_bags(parser)
    common.add_rig(parser)
    common.add_out(parser)
    common.add_joint(parser, of_recording=True)


def add_names_and_report(parser: common.Parser) -> None:
    """Names of topics and joint, damaged bags, and what the report holds."""
    common.add_topics(parser)
    parser.option("--namespace", "namespace of the rig, where a bag holds several", metavar="/NS")
    parser.option("--joint-name", "joint in measured/joint_states, where it holds several", metavar="NAME")
    common.add_recover(parser)
    add_corrections(parser)
    common.add_json(parser)
    common.add_page(parser)


def add_corrections(parser: common.Parser) -> None:
    """The options that correct a recording, and ``--no-check``."""
    corrections.add_options(parser)
    parser.flag("--no-check", "use a recording although the check says that it is wrong")


def read_one(bag: Path, rig: Rig, arguments: argparse.Namespace, **how: Any) -> Recording:
    """A bag, read as by ``read_bag``, corrected as asked and checked; ``--no-check`` goes on although it is wrong."""
    from pam_antagonist.checks import SHORTEST, check_recording
    from pam_antagonist.recording import read_bag

    known = dict(rig.calibration)
    given = corrections.from_options(arguments, known)
    own = corrections.from_options(arguments).options()
    try:
        recording = read_bag(bag, corrections=given, **how)
    except BadInput as exc:
        if own and _can_be_read(bag, corrections.Corrections(**known), how):
            raise BadInput(f"{exc}; it can be read without {' '.join(own)}: leave that out") from None
        raise
    if arguments.no_check or recording.duration_s < SHORTEST or recording.drive != rig.drive:
        return recording
    checked = check_recording(recording, rig, arguments.joint, arguments.lock_angle)
    if checked.wrong:
        if own:
            # As it was recorded, it tells which of the given corrections are wrong.
            raw = corrections.Corrections(align_clocks=given.align_clocks)
            recorded = read_bag(bag, corrections=raw, **how, judge=False)
            checked = check_recording(recorded, rig, arguments.joint, arguments.lock_angle, given)
        first = (*checked.wrong, *checked.findings)[0]
        raise BadInput(
            f"{bag}: {first.text}; {first.todo or 'correct that'}, or type --no-check to go on as it is "
            f"(see {typed('check --help')})"
        )
    return recording


def _can_be_read(bag: Path, known: corrections.Corrections, how: Mapping[str, Any]) -> bool:
    from pam_antagonist.recording import read_bag

    try:
        read_bag(bag, corrections=known, **how)
    except BadInput:
        return False
    return True


def read(arguments: argparse.Namespace, rig: Rig, further: Sequence[Path] = ()) -> list[Recording]:
    """The bags of :func:`add_bags`, and others behind them, corrected as asked and checked against the rig."""
    from pam_antagonist.recording import bag_hash

    how = {name: getattr(arguments, name) for name in ("namespace", "joint_name", "recover")}
    bags, also = [*arguments.bags, *further], getattr(arguments, "also", ())
    recordings = [read_one(bag, rig, arguments, topics=common.topics(arguments), also=also, **how) for bag in bags]
    hashes = [bag_hash(recording.path) for recording in recordings]
    for k, value in enumerate(hashes):
        if value in hashes[:k]:
            raise BadInput(f"{bags[k]}: the same recording as {bags[hashes.index(value)]}")
    return recordings


def damage(arguments: argparse.Namespace, recordings: Sequence[Recording]) -> list[str]:
    """With ``--recover``: what there is to say of each recording, since something is missing from it."""
    return [issue for recording in recordings for issue in recording.issues] if arguments.recover else []


def add_no_log(parser: common.Parser) -> None:
    """``--no-log``."""
    parser.flag("--no-log", "write nothing into the log book of the rig (see history)")


def note_down(
    arguments: argparse.Namespace, command: str, recordings: Sequence[Recording], rig: Rig, found: object,
    written: Path | None = None,
) -> None:  # fmt: skip
    """Write a result into the rig's log book; where that fails a line says so, and the result is not lost."""
    if arguments.no_log:
        return
    from pam_antagonist.api.history import log

    try:
        log(command, arguments.rig, recordings, rig, found, written)
    except BadInput as error:
        print(f"warning: {error}", file=sys.stderr)


def announce(arguments: argparse.Namespace, found: Result, rig: str | None, apart: bool = False) -> None:
    """Save a result, and say what it is and where rig and report are; without a rig, `apart` is an empty line."""
    found.save(arguments.out, figures=not arguments.no_figures)
    print(found.summary())
    if rig is not None or apart:
        print("" if rig is None else f"\nrig: {arguments.out / rig}")
    common.announce_report(arguments, arguments.out)
