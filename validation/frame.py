"""What the laboratory's commands share: outcomes that are kept, and results on a terminal, as Markdown and as JSON."""

from __future__ import annotations

import argparse
import json
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from pam_antagonist.cli import common
from pam_antagonist.errors import BadInput
from pam_antagonist.report import terminal
from pam_antagonist.report.document import Block, Findings, Section, Table, Text, markdown
from pam_antagonist.strict_json import dumps, write_json


def add_docs(parser: common.Parser, what: str = "the tables") -> None:
    """``--docs``: what a page of the documentation shows."""
    parser.option("--docs", f"write {what} as Markdown; FILE is replaced", Path, metavar="FILE")


def add_new_json(parser: common.Parser, what: str) -> None:
    """``--json``, of a command that overwrites nothing."""
    text = f"write {what} to FILE as well, a new file; - for standard output, and the tables on standard error"
    parser.option("--json", text, _new_file, metavar="FILE")


def _new_file(text: str) -> str:
    if text != "-" and Path(text).exists():
        raise argparse.ArgumentTypeError(f"{text}: exists; expected a new file, nothing is overwritten")
    return text


def show(blocks: Sequence[Block], arguments: argparse.Namespace, content: object = None) -> None:
    """Print blocks, and give them as Markdown and the content as JSON where ``--docs`` and ``--json`` say."""
    where, docs = getattr(arguments, "json", None), getattr(arguments, "docs", None)
    with common.json_alone(where):
        print(terminal.render(blocks))
    if content is not None and where is not None:
        common.give_json(where, dumps(content) + "\n")
    if docs is not None:
        common.write_text(docs, "\n\n".join(filter(None, map(in_markdown, blocks))) + "\n")


def in_markdown(block: Block) -> str:
    """A block as Markdown; empty for a table without rows and for what only a page of a report can show."""
    match block:
        case Text():
            return block.text
        case Findings():
            return "\n".join(f"- {item.text}" for item in block.items)
        case Table(rows=[_, *_]):
            return "\n".join([*([f"{block.caption}.", ""] if block.caption else []), *markdown(block)])
        case Section():
            return "\n\n".join([f"## {block.title}", *filter(None, map(in_markdown, block.blocks))])
    return ""


def made(folder: Path) -> Path:
    """A folder of outcomes, which may exist."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"{folder}: cannot be made: {error.strerror}") from None
    return folder


def kept(path: Path, work: Callable[[], object]) -> Any:
    """What a file of a folder of outcomes holds; what `work` gives is written there first where there is none."""
    if not path.exists():
        aside = path.with_suffix(".part")  # so that a file is whole or not there
        write_json(aside, work())
        aside.rename(path)
    return json.loads(path.read_text(encoding="utf-8"))


def lines(path: Path) -> list[Any]:
    """The outcomes of a file, one a line; none of a file that is not there."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []


def add_line(path: Path, outcome: object) -> None:
    """Append an outcome to a file."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(outcome, ensure_ascii=False) + "\n")


def commit() -> str:
    """Of the checkout; empty outside of one."""
    words = ["git", "rev-parse", "HEAD"]
    done = subprocess.run(words, cwd=Path(__file__).parent, capture_output=True, text=True, check=False)
    return done.stdout.strip()
