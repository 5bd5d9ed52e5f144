"""Tell what has changed in a rig over weeks, and when a limit will be reached, from its log book.

identify, close_loop, check and commission append what they found to the log book, a file NAME.log.jsonl beside
the rig file NAME.yaml, unless --no-log is given. The rig file that such a command writes gets the log book too, so that
it goes on whichever of the two files is used next.

For each value there is a line over time. Recordings of one joint differ by more than the errors of their values say;
this spread is estimated beside the line, so that it is not taken for a change. A trend needs four entries.

Status: 0 done, 2 bad input (one line says what and where).

examples:
  {run} history my_rig.yaml
  {run} history my_rig.yaml --out life --limit "force of muscle 2=80%"
  {run} history my_rig.yaml --log older/my_rig.log.jsonl --limit "leak: area, muscle 1=4e-8"
"""

from __future__ import annotations

import argparse

from pam_antagonist.cli import common
from pam_antagonist.cli.recordings import announce, check_page
from pam_antagonist.report.history import Limit


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("history", __doc__)
    out.option("rig", "the rig file whose log book is read", metavar="RIG")
    out.repeated("--log", "another log book, or a rig file with one beside it; may be given several times", "FILE")
    out.repeated(
        "--limit", "at which value something has to be done, in the value's unit or as a share of its first one "
        "(default: 80%% of a muscle's force); may be given several times", "NAME=VALUE", _limit,
    )  # fmt: skip
    out.shared("--out", help="folder of report.html and report.json; a new one", required=False)
    out.shared("--no-figures", "--open")
    return out


def _limit(text: str) -> tuple[str, Limit]:
    name, equals, value = text.rpartition("=")
    relative = value.strip().endswith("%")
    try:
        number = float(value.strip().rstrip("%"))
    except ValueError:
        equals = ""
    if not (name and equals):
        raise argparse.ArgumentTypeError(f"{text!r}: expected NAME=VALUE, such as 'force of muscle 2=80%'")
    return name.strip(), Limit(number / 100.0 if relative else number, relative)


def _main(arguments: argparse.Namespace) -> int:
    from pam_antagonist.api.history import history

    check_page(arguments)
    found = history(arguments.rig, arguments.log, dict(arguments.limit))
    announce(arguments, found, None)
    return common.DONE


main = common.command(parser, _main)
