"""``new_rig``: a rig file from what a ruler, a scale and data sheets tell."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pam_antagonist.cli import common
from pam_antagonist.cli.rig_questions import OWN, QUESTIONS, Question, condition
from pam_antagonist.errors import BadInput
from pam_antagonist.program import typed
from pam_antagonist.rig import Rig
from pam_antagonist.rig.load import write_rig
from pam_antagonist.rig.new import Contradiction, Facts, starting_point
from pam_antagonist.rig.parts import (
    MusclePart,
    RegulatorPart,
    ValvePart,
    muscle_parts,
    named,
    regulator_parts,
    valve_parts,
)
from pam_antagonist.rig.schema import Curve

_DESCRIPTION = """\
Write the rig file of a new joint.

Asks for what a person can measure with a ruler, a scale and data sheets. Every answer can also be given as an option;
then it is not asked for. Lengths, pressures and so on are given with their unit, such as 36.5mm or 6bar. What nobody
can measure by hand is filled in, marked as assumed, and has a wide prior: identify moves it.

Muscles, valves and regulators by name: {parts}.
Status: 0 done, 2 bad input (one line says what and where).
"""
_EXAMPLES = """\
examples:
  {run} new_rig --out my_rig.yaml
  {run} new_rig --out my_rig.yaml --radius 36.5mm --muscle DMSP-10 --supply 6bar --valve MPYE-5-M5
  {run} new_rig --out my_rig.yaml --drive regulator --regulator ITV2050
"""


def parser() -> common.Parser:
    """The arguments."""
    parts = ", ".join((*muscle_parts(), *valve_parts(), *regulator_parts()))
    out = common.Parser("new_rig", _DESCRIPTION.format(parts=parts), _EXAMPLES)
    out.add_argument("--out", required=True, type=Path, metavar="FILE", help="the rig file to write (.yaml), a new one")
    for question in QUESTIONS:
        default = "" if question.default is None else f" (default: {question.default})"
        own = "" if question.wanted({}) else f"; with {condition(question.option)}"
        text = f"{question.text[0].lower()}{question.text[1:]}: {question.how}{own}{default}"
        out.add_argument(f"--{question.option}", metavar="ANSWER", help=text.replace("%", "%%"))
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the command; the result is its exit status."""
    return common.run(parser, _main, argv)


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
    assumed = [question for question in QUESTIONS if question.name in answers.taken]
    try:
        write_rig(rig, path, _remarks(facts, assumed))
    except OSError as error:
        raise BadInput(f"--out {path}: cannot be written: {error.strerror}") from None
    print(f"rig: {path}\n")
    print("Look at its head: it says what was measured and what is assumed. Then record and identify:")
    for words in ("record --out free_bag", f"check free_bag --rig {path}"):
        print(typed(words))
    print(common.next_command("identify", (), f"free_bag locked_bag --rig {path} --out identified"))
    return common.DONE


class _Answers:
    """Answers of options first, then of the person at the terminal, where there is one."""

    def __init__(self, given: Mapping[str, str | None]) -> None:
        self._given = given
        self._person = sys.stdin.isatty()
        self._values: dict[str, Any] = {}
        self._texts: dict[str, str] = {}
        self.asked = False
        self.taken: set[str] = set()

    def rig(self) -> tuple[Facts, Rig]:
        """What the answers say, and the rig file that they make; answers that contradict each other are asked again."""
        self._read()
        while True:
            facts = _facts(self._values)
            try:
                return facts, starting_point(facts)
            except Contradiction as error:
                again = [
                    question
                    for question in QUESTIONS
                    if question.option in error.answers and self._values.get(question.name, OWN) != OWN
                ]
                if not (self._person and again):
                    options = ", ".join(f"--{question.option}" for question in again)
                    raise BadInput(f"{options}: {error}" if options else str(error)) from None
                print(f"\n{error}\nPlease answer again; Enter keeps an answer.")
                for question in again:
                    self._ask(question, self._texts[question.name])
                self._complete()

    def _complete(self) -> None:
        """Ask what a new answer makes necessary, and forget what it makes needless."""
        for question in QUESTIONS:
            if not question.wanted(self._values):
                self._values.pop(question.name, None)
                self._texts.pop(question.name, None)
            elif question.name not in self._values:
                self._ask(question, question.default)

    def _read(self) -> None:
        missing = []
        for question in QUESTIONS:
            text = self._given[question.name]
            if not question.wanted(self._values):
                if text is not None:
                    raise BadInput(f"--{question.option}: only with {condition(question.option)}")
            elif text is not None:
                try:
                    self._take(question, text)
                except BadInput as error:
                    raise BadInput(f"--{question.option} {error}") from None
            elif self._person:
                self._ask(question, question.default)
            elif question.default is not None:
                self._take(question, question.default)
                self.taken.add(question.name)
            else:
                missing.append(f"--{question.option} ({question.how})")
                self._values[question.name] = None
        if missing:
            raise BadInput(
                f"missing: {', '.join(missing)}; give them as options, or start the command in a terminal, where it "
                "asks for them"
            )

    def _take(self, question: Question, text: str) -> None:
        self._values[question.name] = question.read(text)
        self._texts[question.name] = text

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
                self._take(question, default if not text and default is not None else text)
            except BadInput as error:
                print(f"  {error}")
                continue
            self.taken.discard(question.name)
            if not text and default == question.default:
                self.taken.add(question.name)
            return

    def command(self, path: Path) -> str:
        """The command line with these answers."""
        words = ["new_rig", "--out", str(path)]
        for question in QUESTIONS:
            if question.name in self._texts:
                words += [f"--{question.option}", self._texts[question.name]]
        return typed(shlex.join(words))


def _facts(values: Mapping[str, Any]) -> Facts:
    if values["muscle"] == OWN:
        muscle = MusclePart(
            diameter=values["muscle_diameter"],
            force=values["muscle_force"],
            pressure=values["muscle_pressure"],
            contraction=values["muscle_contraction"] / 100.0,
            source="measured or by its data sheet",
        )
    else:
        muscle = named("muscle", values["muscle"], muscle_parts())
    low, high = values.get("voltage", (0.0, 10.0))
    regulator = _regulator(values) if values["drive"] == "regulator" else None
    if regulator is not None:
        valve = valve_parts()["shin2022"].replaced(source=regulator.source)  # its numbers play no part
    elif values["valve"] == OWN:
        curve = Curve(voltage=(low, high), open_rate=(0.0, 1.0))
        valve = ValvePart(
            flow=values["valve_flow"],
            curve=curve,
            closed_centre=values["valve_centre"] == "closed",
            source="its data sheet; the curve is a guess",
        )
    else:
        valve = named("valve", values["valve"], valve_parts())
    mass = values["limb_mass"]
    return Facts(
        name=values["name"],
        kind=values["kind"],
        radius=values["radius"],
        length=values["length"],
        nominal_length=values["nominal_length"],
        muscle=muscle,
        muscle_name=f"muscle {values['muscle']}",
        supply=values["supply"],
        valve=valve,
        valve_name=f"valve {values['valve']}" if regulator is None else f"pressure regulators {values['regulator']}",
        voltage=(low, high),
        shaft_radius=values["shaft_radius"],
        mass=values["mass"],
        inertia=values["inertia"],
        stop=values["stop"],
        pressure_range=values["sensor_range"],
        pressure_bits=round(values["sensor_bits"]),
        period=1.0 / values["rate"],
        regulator=regulator,
        regulator_time=values.get("regulator_time", 0.0),
        limb=None if mass is None else (mass, values["limb_distance"], values["limb_hanging"]),
    )


def _regulator(values: Mapping[str, Any]) -> RegulatorPart:
    if values["regulator"] != OWN:
        return named("regulator", values["regulator"], regulator_parts())
    low, high = values["regulator_range"]
    return RegulatorPart(lowest=low, highest=high, hysteresis=0.0, source="your answer")


def _remarks(facts: Facts, assumed: Sequence[Question]) -> list[str]:
    """The head of the file: which numbers come from where."""
    lines = [
        "A starting point by new_rig: identify finds the values of your joint.",
        "Measured: geometry, supply, joint.mass, joint.inertia, sensors.pressure_step.",
        "From data sheets: force and volume of the muscles, areas of the valves. Muscles of one kind differ by 15 %.",
        "Assumed: valve curves, friction, gas.polytropic_*, noise of the sensors, uncertainty, tunings.",
        "Priors (standard deviations before identification) are wide where a number is assumed.",
        "Those of valve_offset say by how much the guessed curves may be shifted.",
    ]
    if assumed:
        lines.append(f"Default answers were taken for: {', '.join(question.option for question in assumed)}.")
    if facts.regulator is not None:
        told = "hysteresis by the same source" if facts.regulator.hysteresis else "hysteresis unknown and taken as none"
        lines.append(f"Of the regulators: range by {facts.regulator.source}.")
        lines.append(
            f"Their rise time is your answer, their damping ratio assumed, {told}. Valves and flow are not used."
        )
        lines.append("Compare range and hysteresis with the data sheet of yours.")
    if facts.valve.closed_centre:
        lines.append(
            "This valve lets no air pass at its middle voltage (overlap 0.5). Near it, it holds a pressure, so that the"
        )
        lines.append("voltages alone do not tell the pressures: recordings with measured pressures are needed.")
    return lines
