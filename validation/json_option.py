"""``--json`` of the laboratory's commands: their figures in a new file, or on standard output."""

from __future__ import annotations

import argparse
from pathlib import Path

from pam_antagonist.cli.common import Parser, give_json, json_alone
from pam_antagonist.strict_json import dumps


def add_new_json(parser: Parser, what: str) -> None:
    """``--json``, of a command that overwrites nothing."""
    text = f"write {what} to FILE as well, a new file; - for standard output, and the tables on standard error"
    parser.option("--json", text, _new_file, metavar="FILE")


def _new_file(text: str) -> str:
    if text != "-" and Path(text).exists():
        raise argparse.ArgumentTypeError(f"{text}: exists; expected a new file, nothing is overwritten")
    return text


def show(text: str, content: object, where: str | None) -> None:
    """Print the result of a command, if there is a text, and give it as JSON where ``--json`` says."""
    if text:
        with json_alone(where):
            print(text)
    if where is not None:
        give_json(where, dumps(content) + "\n")
