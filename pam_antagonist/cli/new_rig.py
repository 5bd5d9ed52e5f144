"""Write the rig file of a new joint.

Asks for what a person can measure with a ruler, a scale and data sheets. Every answer can also be given as an option;
then it is not asked for. Lengths, pressures and so on are given with their unit, such as 36.5mm or 6bar. Where a
question names a unit, a number is enough. What nobody can measure by hand is filled in, marked as assumed, and has a
wide prior: identify moves it.

Muscles, valves and regulators by name: {parts}.
Status: 0 done, 2 bad input (one line says what and where).

examples:
  {run} new_rig --out my_rig.yaml
  {run} new_rig --out my_rig.yaml --radius 36.5mm --muscle DMSP-10 --supply 6bar --valve MPYE-5-M5
  {run} new_rig --out my_rig.yaml --drive regulator --regulator ITV2050
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path

from typing_extensions import override

from pam_antagonist.api.new_rig import OWN, QUESTIONS, Answers, Question, facts_of, remarks
from pam_antagonist.cli import common
from pam_antagonist.errors import BadInput
from pam_antagonist.program import typed
from pam_antagonist.rig import Rig
from pam_antagonist.rig.file import write_rig
from pam_antagonist.rig.new import Contradiction, Facts, starting_point
from pam_antagonist.rig.parts import muscle_parts, regulator_parts, valve_parts


def parser() -> common.Parser:
    """The arguments."""
    parts = ", ".join((*muscle_parts(), *valve_parts(), *regulator_parts()))
    out = common.Parser("new_rig", (__doc__ or "").replace("{parts}", parts))
    out.option("--out", "the rig file to write (.yaml), a new one", Path, metavar="FILE", required=True)
    for question in QUESTIONS:
        default = "" if question.default is None else f" (default: {question.default})"
        own = "" if question.wanted({}) else f"; with --{' '.join(question.only_with)}".rstrip()
        text = f"{question.text[0].lower()}{question.text[1:]}: {question.how}{own}{default}"
        out.option(f"--{question.option}", text.replace("%", "%%"), metavar="ANSWER")
    return out


def _main(arguments: argparse.Namespace) -> int:
    path: Path = arguments.out
    if path.suffix not in (".yaml", ".yml"):
        raise BadInput(f"--out {path}: expected a file that ends in .yaml")
    if path.exists():
        raise BadInput(f"--out {path}: exists; expected a new file, nothing is overwritten")
    if not os.access(path.absolute().parent, os.W_OK):
        raise BadInput(f"--out {path}: expected a file in a folder that exists and can be written to")
    answers = _Answers(vars(arguments))
    try:
        facts, rig = answers.rig()
    except (BadInput, KeyboardInterrupt):
        if answers.asked:
            print(f"\nnothing was written; your answers up to now:\n{answers.command(path)}", file=sys.stderr)
        raise
    try:
        write_rig(rig, path, remarks(facts, answers.assumed))
    except OSError as error:
        raise BadInput(f"--out {path}: cannot be written: {error.strerror}") from None
    print(f"rig: {path}\n")
    print("Look at its head: it says what was measured and what is assumed. With recordings of the joint:")
    for words in (f"check BAG --rig {path}", f"identify BAG... --rig {path} --out identified"):
        print(typed(words))
    print("without, rehearse how the joint is driven and identified, then do it on the joint:")
    rehearsal = f"--rig {path} --out rehearsed --source rehearsal --unattended"
    print(common.next_command("commission", (), rehearsal))
    return common.DONE


class _Answers(Answers):
    """Answers of options first, then of the person at the terminal, where there is one."""

    _how_to_give = "give them as options, or start the command in a terminal, where it asks for them"

    def __init__(self, given: Mapping[str, str | None]) -> None:
        super().__init__(given, "--")
        self._person = sys.stdin.isatty()
        self.asked = False

    def rig(self) -> tuple[Facts, Rig]:
        """What the answers say, and the rig file that they make; answers that contradict each other are asked again."""
        while True:
            self.read()
            facts = facts_of(self)
            try:
                return facts, starting_point(facts)
            except Contradiction as error:
                again = [
                    question
                    for question in QUESTIONS
                    if question.option in error.answers and self.values.get(question.name, OWN) != OWN
                ]
                if not (self._person and again):
                    options = ", ".join(f"--{question.option}" for question in again)
                    raise BadInput(f"{options}: {error}" if options else str(error)) from None
                print(f"\n{error}\nPlease answer again; Enter keeps an answer.")
                for question in again:
                    self._ask(question, self.texts[question.name])

    @override
    def answered(self, question: Question) -> bool:
        if self._person:
            self._ask(question, question.default)
        return self._person or super().answered(question)

    def _ask(self, question: Question, default: str | None) -> None:
        """Ask until an answer makes sense."""
        print(f"\n{question.text}\n  ({question.how})")
        while True:
            try:
                text = input(f"  [{default}] > " if default is not None else "  > ").strip()
            except EOFError:
                raise BadInput(f"{question.text}: the input ended") from None
            self.asked = True
            try:
                self.take(question, default if not text and default is not None else text)
            except BadInput as error:
                print(f"  {error}")
                continue
            self.assumed.discard(question.name)
            if not text and default == question.default:
                self.assumed.add(question.name)
            return

    def command(self, path: Path) -> str:
        """The command line with these answers."""
        words = ["new_rig", "--out", str(path)]
        for question in QUESTIONS:
            if question.name in self.texts:
                words += [f"--{question.option}", self.texts[question.name]]
        return typed(shlex.join(words))


main = common.command(parser, _main)
