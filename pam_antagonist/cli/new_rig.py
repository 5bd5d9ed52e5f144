"""``new_rig``: a rig file from what a ruler, a scale and data sheets tell."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pam_antagonist.cli import common
from pam_antagonist.errors import BadInput
from pam_antagonist.program import typed
from pam_antagonist.recording.units import UNITS, canonical
from pam_antagonist.rig import load_rig
from pam_antagonist.rig.new import Facts, starting_point
from pam_antagonist.rig.parts import MusclePart, ValvePart, muscle_parts, named, valve_parts
from pam_antagonist.rig.schema import Curve
from pam_antagonist.rig.write import write_rig

_DESCRIPTION = """\
Write the rig file of a new joint.

Asks for what a person can measure with a ruler, a scale and data sheets. Every answer can also be given as an option;
then it is not asked for. Lengths, pressures and so on are given with their unit, such as 36.5mm or 6bar. What nobody
can measure by hand is filled in, marked as assumed, and has a wide prior: identify moves it.

Muscles and valves of the data sheets: {parts}.
Status: 0 done, 2 bad input (one line says what and where).
"""
_EXAMPLES = """\
examples:
  {run} new_rig --out my_rig.yaml
  {run} new_rig --out my_rig.yaml --radius 36.5mm --muscle DMSP-10 --supply 6bar --valve MPYE-5-M5
"""
_OWN = "own"
_NUMBER = re.compile(r"\s*([-+]?[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*(.*)\s*")


@dataclass(frozen=True)
class _Question:
    """Something that a person is asked.

    Attributes:
        option: on the command line, without the dashes.
        text: the question.
        how: how to find out.
        read: makes a value of an answer; raises BadInput.
        default: answer that is taken where none is given; None: there is none.
        wanted: whether it is asked at all, by the values so far.
    """

    option: str
    text: str
    how: str
    read: Callable[[str], Any]
    default: str | None = None
    wanted: Callable[[Mapping[str, Any]], bool] = lambda values: True

    @property
    def name(self) -> str:
        return self.option.replace("-", "_")


def _quantity(quantity: str, low: float, high: float) -> Callable[[str], float]:
    """Reads a number with its unit; the bounds are in SI units."""

    def read(text: str) -> float:
        units = UNITS[quantity]
        example = {"length": "36.5mm", "pressure": "6bar", "force": "120N", "angle": "25deg", "voltage": "10V"}
        found = _NUMBER.fullmatch(text)
        if found is None or not found[2]:
            raise BadInput(f"{text!r}: expected a number and its unit, such as {example.get(quantity, '250g')}")
        unit = canonical(repr(text), quantity, found[2])
        value = float(found[1]) * units[unit]
        if not low <= value <= high:
            raise BadInput(f"{text!r}: expected {low / units[unit]:g} to {high / units[unit]:g} {unit}")
        return value

    return read


def _number(low: float, high: float, unit: str) -> Callable[[str], float]:
    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise BadInput(f"{text!r}: expected {low:g} to {high:g} {unit}".rstrip())
        return value

    return read


def _one_of(*choices: str) -> Callable[[str], str]:
    def read(text: str) -> str:
        if text not in choices:
            raise BadInput(f"{text!r}: expected one of {', '.join(choices)}")
        return text

    return read


def _part(what: str, parts: Callable[[], Mapping[str, Any]]) -> Callable[[str], str]:
    def read(text: str) -> str:
        if text != _OWN:
            named(what, text, dict(parts()))
        return text

    return read


def _stop(text: str) -> float | None:
    return None if text == "none" else _quantity("angle", math.radians(1.0), math.radians(89.0))(text)


def _volts(text: str) -> tuple[float, float]:
    low, colon, high = text.partition(":")
    read = _number(0.0, 10.0, "V")
    values = (read(low), read(high)) if colon else (math.nan, math.nan)
    if not values[0] < values[1]:
        raise BadInput(f"{text!r}: expected the least and the largest voltage [V], such as 0:10")
    return values


def _gauge_range(text: str) -> tuple[float, float]:
    low, colon, high = text.partition(":")
    read = _quantity("pressure", 0.0, 1.5e6)
    values = (read(low), read(high)) if colon else (math.nan, math.nan)
    if not values[0] < values[1]:
        raise BadInput(f"{text!r}: expected the least and the largest gauge pressure, such as 0bar:6bar")
    return values


def _is_driven_by(drive: str) -> Callable[[Mapping[str, Any]], bool]:
    return lambda values: values.get("drive", "valve") == drive


def _condition(option: str) -> str:
    """With which other answer an option goes together."""
    if option in ("valve", "voltage"):
        return "--drive valve"
    first = option.split("-", maxsplit=1)[0]
    return "--drive regulator" if first == "regulator" else f"--{first} {_OWN}"


def _is_own(name: str) -> Callable[[Mapping[str, Any]], bool]:
    return lambda values: values.get(name) == _OWN


_SHEET = "its data sheet"
_QUESTIONS = (
    _Question("name", "Name of the rig", "letters, digits, - and _", str, "my_rig"),
    _Question(
        "kind",
        "Lever or pulley",
        "lever: muscles pull at two points of a bar; pulley: at a belt on a wheel",
        _one_of("lever", "pulley"),
        "lever",
    ),
    _Question(
        "radius",
        "Lever arm, or radius of the pulley",
        "from the axis to where a muscle pulls, by ruler",
        _quantity("length", 2e-3, 0.4),
    ),
    _Question("muscle", "Muscle", "a name of the list above, or own", _part("muscle", muscle_parts)),
    _Question(
        "muscle-diameter",
        "Inner diameter of the muscle without pressure",
        _SHEET,
        _quantity("length", 2e-3, 0.15),
        wanted=_is_own("muscle"),
    ),
    _Question(
        "muscle-pressure",
        "Gauge pressure at which the next two answers hold",
        _SHEET,
        _quantity("pressure", 2e4, 1.5e6),
        wanted=_is_own("muscle"),
    ),
    _Question(
        "muscle-force",
        "Force of the muscle there without contraction",
        "its data sheet, or a scale between its ends",
        _quantity("force", 1.0, 5e4),
        wanted=_is_own("muscle"),
    ),
    _Question(
        "muscle-contraction",
        "Contraction there without load, in percent",
        "inflate it and measure its length",
        _number(3.0, 45.0, "%"),
        wanted=_is_own("muscle"),
    ),
    _Question(
        "nominal-length",
        "Length of the muscle without pressure and load",
        "the hose between the fittings, by ruler",
        _quantity("length", 0.03, 1.5),
    ),
    _Question(
        "length",
        "Length of a muscle in the joint at angle 0",
        "the same hose, joint in the middle, no pressure",
        _quantity("length", 0.03, 1.5),
    ),
    _Question(
        "supply", "Gauge pressure of the supply", "the gauge of the regulator", _quantity("pressure", 6e4, 1.5e6)
    ),
    _Question(
        "drive",
        "Proportional valves or pressure regulators: valve or regulator",
        "what your driver commands: a voltage, or a pressure",
        _one_of("valve", "regulator"),
        "valve",
    ),
    _Question(
        "regulator-range",
        "Least and largest gauge pressure of a regulator",
        _SHEET,
        _gauge_range,
        "0bar:6bar",
        _is_driven_by("regulator"),
    ),
    _Question(
        "regulator-time",
        "Time of a regulator from 10 to 90 % of a small step, with the muscle on it [s]",
        "a recorded step, or its data sheet",
        _number(0.002, 1.0, "s"),
        "0.03",
        _is_driven_by("regulator"),
    ),
    _Question(
        "valve",
        "Valve",
        "a name of the list above, or own",
        _part("valve", valve_parts),
        wanted=_is_driven_by("valve"),
    ),
    _Question(
        "valve-flow",
        "Standard nominal flow of the valve [l/min]",
        _SHEET,
        _number(0.1, 5e3, "l/min"),
        wanted=_is_own("valve"),
    ),
    _Question(
        "voltage",
        "Least and largest voltage of a valve [V]",
        "what your driver may put out",
        _volts,
        "0:10",
        _is_driven_by("valve"),
    ),
    _Question(
        "inertia",
        "Inertia of what turns [kg m²]",
        "mass times squared distance of its centre from the axis",
        _number(2e-7, 5.0, "kg m²"),
    ),
    _Question("mass", "Mass of what the shaft carries", "a scale", _quantity("mass", 0.0, 80.0)),
    _Question("shaft-radius", "Radius of the shaft", "a calliper", _quantity("length", 5e-4, 0.08), "5mm"),
    _Question(
        "stop", "Angle at which the joint stops, to either side", "a protractor; none if it has no stop", _stop, "none"
    ),
    _Question("sensor-range", "Range of a pressure sensor", _SHEET, _quantity("pressure", 1e5, 2e6), "10bar"),
    _Question("sensor-bits", "Bits of its converter", "the board's data sheet", _number(8, 24, "bits"), "12"),
    _Question("rate", "Samples a second", "your driver", _number(50, 10000, "Hz"), "1000"),
)
"""In the order in which they are asked."""


def parser() -> common.Parser:
    """The arguments."""
    parts = ", ".join((*muscle_parts(), *valve_parts()))
    out = common.Parser("new_rig", _DESCRIPTION.format(parts=parts), _EXAMPLES)
    out.add_argument("--out", required=True, type=Path, metavar="FILE", help="the rig file to write (.yaml), a new one")
    for question in _QUESTIONS:
        default = "" if question.default is None else f" (default: {question.default})"
        own = "" if question.wanted({}) else f"; with {_condition(question.option)}"
        text = f"{question.text[0].lower()}{question.text[1:]}: {question.how}{own}{default}"
        out.add_argument(f"--{question.option}", metavar="ANSWER", help=text.replace("%", "%%"))
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the command; the result is its exit status."""
    return common.run(_main, argv)


def _main(argv: Sequence[str] | None) -> int:
    arguments = parser().parse_args(argv)
    path: Path = arguments.out
    if path.suffix not in (".yaml", ".yml"):
        raise BadInput(f"--out {path}: expected a file that ends in .yaml")
    if path.exists():
        raise BadInput(f"--out {path}: exists; expected a new file, nothing is overwritten")
    values, assumed = _answers(vars(arguments))
    facts = _facts(values)
    rig = starting_point(facts)
    try:
        write_rig(rig, path, _remarks(facts, assumed))
    except OSError as error:
        raise BadInput(f"--out {path}: cannot be written: {error.strerror}") from None
    load_rig(path, regulators=True)
    print(f"rig: {path}\n")
    print("Look at its head: it says what was measured and what is assumed. Then record and identify:")
    for words in ("record --out free_bag", f"check free_bag --rig {path}"):
        print(typed(words))
    print(common.next_command("identify", (), f"free_bag locked_bag --rig {path} --out identified"))
    return common.DONE


def _answers(given: Mapping[str, str | None]) -> tuple[dict[str, Any], list[_Question]]:
    """Values by name, from options first, then from the person; and the questions whose default was taken.

    Raises:
        BadInput: an option that makes no sense, or nobody to ask for what is missing.
    """
    values: dict[str, Any] = {}
    assumed, missing = [], []
    person = sys.stdin.isatty()
    for question in _QUESTIONS:
        text = given[question.name]
        if not question.wanted(values):
            if text is not None:
                raise BadInput(f"--{question.option}: only with {_condition(question.option)}")
            continue
        if text is not None:
            try:
                values[question.name] = question.read(text)
            except BadInput as error:
                raise BadInput(f"--{question.option} {error}") from None
        elif person:
            values[question.name], taken = _asked(question)
            assumed += [question] if taken else []
        elif question.default is not None:
            values[question.name] = question.read(question.default)
            assumed.append(question)
        else:
            missing.append(f"--{question.option} ({question.how})")
            values[question.name] = None
    if missing:
        raise BadInput(f"not known: {', '.join(missing)}; expected an option each, or a terminal to ask at")
    return values, assumed


def _asked(question: _Question) -> tuple[Any, bool]:
    """Ask until an answer makes sense; the value, and whether it is the default."""
    default = f" [{question.default}]" if question.default is not None else ""
    print(f"\n{question.text}\n  ({question.how})")
    while True:
        try:
            text = input(f"  {default.lstrip() + ' ' if default else ''}> ").strip()
        except EOFError:
            raise BadInput(f"{question.text}: the input ended; nothing was written") from None
        taken = not text and question.default is not None
        try:
            return question.read(question.default if taken and question.default is not None else text), taken
        except BadInput as error:
            print(f"  {error}")


def _facts(values: Mapping[str, Any]) -> Facts:
    if values["muscle"] == _OWN:
        muscle = MusclePart(
            diameter=values["muscle_diameter"],
            force=values["muscle_force"],
            pressure=values["muscle_pressure"],
            contraction=values["muscle_contraction"] / 100.0,
            source="measured or by its data sheet",
        )
    else:
        muscle = named("muscle", values["muscle"], muscle_parts())
    regulated = values["drive"] == "regulator"
    low, high = values.get("voltage", (0.0, 10.0))
    if regulated:
        valve = valve_parts()["shin2022"].replaced(source="range and time as asked")  # its numbers play no part
    elif values["valve"] == _OWN:
        curve = Curve(voltage=(low, high), open_rate=(0.0, 1.0))
        valve = ValvePart(
            flow=values["valve_flow"], curve=curve, closed_centre=False, source="its data sheet; the curve is a guess"
        )
    else:
        valve = named("valve", values["valve"], valve_parts())
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
        valve_name="pressure regulators" if regulated else f"valve {values['valve']}",
        voltage=(low, high),
        shaft_radius=values["shaft_radius"],
        mass=values["mass"],
        inertia=values["inertia"],
        stop=values["stop"],
        pressure_range=values["sensor_range"],
        pressure_bits=round(values["sensor_bits"]),
        period=1.0 / values["rate"],
        regulator=(*values["regulator_range"], values["regulator_time"]) if regulated else None,
    )


def _remarks(facts: Facts, assumed: Sequence[_Question]) -> list[str]:
    """The head of the file: which numbers come from where."""
    lines = [
        "A starting point by new_rig: identify finds what yours really is.",
        "Measured: geometry, supply, joint.mass, joint.inertia, sensors.pressure_step.",
        "From data sheets: force and volume of the muscles, areas of the valves. Muscles of one kind differ by 15 %.",
        "Assumed: valve curves, friction, gas.polytropic_*, noise of the sensors, uncertainty, tunings.",
        "Priors (standard deviations before identification) are wide where a number is assumed.",
    ]
    if assumed:
        lines.append(f"Default answers were taken for: {', '.join(question.option for question in assumed)}.")
    if facts.regulator is not None:
        lines.append("Of the regulators: range and time as asked, damping ratio assumed. Valves and flow play no part.")
    if facts.valve.closed_centre:
        lines.append(
            "Attention: this valve lets no air pass at its middle voltage. Equation (5) has no such place: steady"
        )
        lines.append("pressures near it are not predicted well. Keep the voltages away from it, or moving.")
    return lines


if __name__ == "__main__":
    sys.exit(main())
