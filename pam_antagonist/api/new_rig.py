"""``new_rig``: a rig from what a ruler, a scale and data sheets tell; what is asked, and what an answer may be."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from pam_antagonist.errors import BadInput
from pam_antagonist.numbers import plain
from pam_antagonist.recording.plausible import UNITS, canonical
from pam_antagonist.rig import Rig
from pam_antagonist.rig.new import Facts, starting_point
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

OWN = "own"
"""Answer for a muscle, a valve or a regulator that is in no list."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
_NUMBER = re.compile(r"\s*([-+]?[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*(.*)\s*")


def _quantity(quantity: str, low: float, high: float, own: str = "") -> Callable[[str], float]:
    """Reads a number with its unit; the bounds are in SI units.

    `own`: unit of a number without one; empty: it has to have one, unless it is 0.
    """

    def read(text: str) -> float:
        units = UNITS[quantity]
        example = {"length": "36.5mm", "pressure": "6bar", "force": "120N", "angle": "25deg"}
        found = _NUMBER.fullmatch(plain(text))
        if found is None or not (found[2] or own or float(found[1]) == 0.0):
            expected = f"{low:g} to {high:g} {own}" if own else f"such as {example.get(quantity, '250g')}"
            raise BadInput(f"{text!r}: expected a number and its unit, {expected}")
        unit = canonical(repr(text), quantity, found[2] or own or next(iter(units)))
        value = float(found[1]) * units[unit]
        if not low <= value <= high:
            raise BadInput(f"{text!r}: expected {low / units[unit]:g} to {high / units[unit]:g} {unit}")
        return value

    return read


def _one_of(*choices: str) -> Callable[[str], str]:
    def read(text: str) -> str:
        if text not in choices:
            raise BadInput(f"{text!r}: expected one of {', '.join(choices)}")
        return text

    return read


def _part(what: str, parts: Callable[[], dict[str, Any]]) -> Callable[[str], Any]:
    return lambda text: OWN if text == OWN else named(what, text, parts())


def _list(parts: Callable[[], Mapping[str, Any]]) -> str:
    return f"{', '.join(parts())}, or own where none of these is yours"


def _name(text: str) -> str:
    if _NAME.fullmatch(text) is None:
        raise BadInput(f"{text!r}: expected letters, digits, - and _, such as left_elbow")
    return text


def _or_none(quantity: str, low: float, high: float) -> Callable[[str], float | None]:
    return lambda text: None if text == "none" else _quantity(quantity, low, high)(text)


def _range(
    what: str, least: Callable[[str], float], largest: Callable[[str], float]
) -> Callable[[str], tuple[float, float]]:
    """Reads two numbers with a colon between them; their unit may be given once."""

    def read(text: str) -> tuple[float, float]:
        low, colon, high = text.partition(":")
        known, unit = _NUMBER.fullmatch(plain(low)), _NUMBER.fullmatch(plain(high))
        low += "" if known is None or known[2] or unit is None else unit[2]  # as in 1:6bar
        values = (least(low), largest(high)) if colon else (math.nan, math.nan)
        if not values[0] < values[1]:
            raise BadInput(f"{text!r}: expected the least and the largest {what}")
        return values

    return read


@dataclass(frozen=True)
class Question:
    """Something that a person is asked."""

    option: str
    text: str
    how: str
    read: Callable[[str], Any]
    default: str | None = None  # answer that is taken where none is given; None: there is none
    only_with: tuple[str, str] = ("", "")  # option and answer with which it is asked; no answer: with any but none

    @property
    def name(self) -> str:
        """Of its value."""
        return self.option.replace("-", "_")

    def wanted(self, values: Mapping[str, Any]) -> bool:
        """Whether it is asked beside these answers."""
        option, answer = self.only_with
        given = values.get(option.replace("-", "_"), "valve" if option == "drive" else None)
        return not option or (given == answer if answer else given is not None)


class Answers:
    """Answers to the questions, by name: `values` as they are read, `texts` as they were given.

    `assumed`: names of the questions for which the default was taken. `before`: of an answer's name in messages.
    """

    _how_to_give = "expected an answer to each of these"

    def __init__(self, given: Mapping[str, str | None], before: str = "") -> None:
        self._given, self._before = given, before
        self.values: dict[str, Any] = {}
        self.texts: dict[str, str] = {}
        self.assumed: set[str] = set()

    def read(self) -> None:
        """Read what was given, in the order of the questions; what another answer made needless is forgotten."""
        missing = []
        for question in QUESTIONS:
            name, text, label = question.name, self._given.get(question.name), self._label(question.option)
            if not question.wanted(self.values):
                if text is not None and name not in self.texts:
                    option, answer = question.only_with
                    raise BadInput(f"{label}: only with {self._label(option)} {answer}".rstrip())
                self.values.pop(name, None)
                self.texts.pop(name, None)
            elif name in self.texts:
                continue
            elif text is not None:
                try:
                    self.take(question, str(text))
                except BadInput as error:
                    raise BadInput(f"{label} {error}") from None
            elif not self.answered(question):
                missing.append(f"{label} ({question.how})")
                self.values[name] = None
        if missing:
            raise BadInput(f"missing: {', '.join(missing)}; {self._how_to_give}")

    def _label(self, option: str) -> str:
        return f"{self._before}{option}" if self._before else option.replace("-", "_")

    def take(self, question: Question, text: str) -> None:
        """Take an answer."""
        self.values[question.name], self.texts[question.name] = question.read(text), text

    def answered(self, question: Question) -> bool:
        """Take the default where there is no answer; whether there is one."""
        if question.default is not None:
            self.take(question, question.default)
            self.assumed.add(question.name)
        return question.default is not None


_SHEET = "its data sheet"
_VALVES, _REGULATORS, _LIMB = ("drive", "valve"), ("drive", "regulator"), ("limb-mass", "")
_NO_MUSCLE = ("muscle", OWN)
_metres = partial(_quantity, "length")
_pascals = partial(_quantity, "pressure")
_volts = _quantity("voltage", -10.0, 10.0, "V")
_FIELDS = (
    ("name", "Name of the rig", "letters, digits, - and _", _name, "my_rig"),
    ("kind", "Lever or pulley",
     "lever: the muscles pull at two points of a bar; pulley: they pull at a belt on a wheel",
     _one_of("lever", "pulley"), "lever"),
    ("radius", "Lever arm, or radius of the pulley", "from the axis to where a muscle pulls, by ruler",
     _metres(2e-3, 0.4)),
    ("muscle", "Muscle", _list(muscle_parts), _part("muscle", muscle_parts)),
    ("muscle-diameter", "Inner diameter of the muscle without pressure", _SHEET, _metres(2e-3, 0.15), None, _NO_MUSCLE),
    ("muscle-pressure", "Gauge pressure for the next two answers (force and contraction)", _SHEET,
     _pascals(2e4, 1.5e6), None, _NO_MUSCLE),
    ("muscle-force", "Force of the muscle at that pressure, without contraction",
     "its data sheet, or a scale between its ends", _quantity("force", 1.0, 5e4), None, _NO_MUSCLE),
    ("muscle-contraction", "Contraction of the muscle at that pressure, without load, in percent",
     "inflate it and measure its length", _quantity("share", 3.0, 45.0, "%"), None, _NO_MUSCLE),
    ("nominal-length", "Length of the muscle without pressure and load", "the hose between the fittings, by ruler",
     _metres(0.03, 1.5)),
    ("length", "Length of a muscle in the joint at angle 0", "the same hose, joint in the middle, no pressure",
     _metres(0.03, 1.5)),
    ("supply", "Gauge pressure of the supply", "the gauge of the regulator", _pascals(6e4, 1.5e6)),
    ("drive", "What drives the joint, proportional valves or pressure regulators: valve or regulator",
     "valve if your driver commands a voltage, regulator if it commands a pressure", _one_of("valve", "regulator"),
     "valve"),
    ("regulator", "Pressure regulator", _list(regulator_parts), _part("regulator", regulator_parts), OWN, _REGULATORS),
    ("regulator-range", "Least and largest gauge pressure of a regulator", _SHEET,
     _range("gauge pressure, such as 0bar:6bar", _pascals(0.0, 9e5), _pascals(2e4, 1.5e6)), "0bar:6bar",
     ("regulator", OWN)),
    ("regulator-time", "Time of a regulator from 10 to 90 % of a small step, with the muscle on it [s]",
     "a recorded step, or its data sheet", _quantity("time", 0.002, 1.0, "s"), "0.03", _REGULATORS),
    ("valve", "Valve", _list(valve_parts), _part("valve", valve_parts), None, _VALVES),
    ("valve-flow", "Standard nominal flow of the valve [l/min]", _SHEET, _quantity("flow", 0.1, 5e3, "l/min"), None,
     ("valve", OWN)),
    ("valve-centre", "Middle position of the valve: closed or open",
     "its data sheet: closed if no air passes in the middle, as in a 5/3 valve with closed centre",
     _one_of("closed", "open"), "closed", ("valve", OWN)),
    ("voltage", "Least and largest voltage of a valve [V]",
     "what your driver can put out; -5:5 with a bipolar amplifier, over whose range the valve's curve is then laid",
     _range("voltage [V], such as 0:10 or -5:5", _volts, _volts), "0:10", _VALVES),
    ("inertia", "Inertia of the parts that turn with the joint [kg m²]",
     "roughly the mass times the squared distance of its centre from the axis",
     _quantity("inertia", 2e-7, 5.0, "kg m²")),
    ("mass", "Mass of the parts that the shaft carries", "a scale", _quantity("mass", 0.0, 80.0)),
    ("limb-mass", "Mass of a limb that the joint carries in a vertical plane",
     "a scale; type none if there is no limb, or if its weight is not known", _or_none("mass", 1e-3, 80.0), "none"),
    ("limb-distance", "Distance of the limb's centre from the axis", "balance the limb on an edge, then by ruler",
     _metres(1e-3, 2.0), None, _LIMB),
    ("limb-hanging", "Angle of the joint at which the limb hangs straight down",
     "a protractor; the angle grows when muscle 1 shortens, and may lie outside the joint's range",
     _quantity("angle", -math.pi, math.pi), None, _LIMB),
    ("shaft-radius", "Radius of the shaft", "a calliper", _metres(5e-4, 0.08), "5mm"),
    ("stop", "Angle of the mechanical stop, to either side", "a protractor; type none if there is no stop",
     _or_none("angle", math.radians(1.0), math.radians(89.0)), "none"),
    ("sensor-range", "Range of a pressure sensor", _SHEET, _pascals(1e5, 2e6), "10bar"),
    ("sensor-bits", "Bits of the converter that reads the pressure sensor", "the board's data sheet",
     _quantity("bits", 8, 24, "bits"), "12"),
    ("rate", "Samples a second that your driver takes", "your driver", _quantity("rate", 10, 10000, "Hz"), "1000"),
)  # fmt: skip
QUESTIONS = tuple(Question(*fields) for fields in _FIELDS)
"""In the order in which they are asked."""


def new_rig(**answers: str) -> Rig:
    """The rig of a new joint, as the command ``new_rig`` makes it.

    What nobody can measure by hand is filled in and has a wide prior: :func:`identify` moves it.

    Args:
        answers: by the names of the command's options, each with its unit; those with a default may be left out.

    Returns:
        The rig.

    Raises:
        BadInput: an answer that is missing, is out of range, has no unit, or contradicts another one.

    Example:
        >>> from pam_antagonist import new_rig
        >>> rig = new_rig(
        ...     radius="36.5mm", muscle="DMSP-10", supply="6bar", valve="MPYE-5-M5", nominal_length="200mm",
        ...     length="190mm", inertia="0.01", mass="1kg",
        ... )
        >>> rig.geometry.radius
        0.0365
    """
    unknown = sorted(answers.keys() - {question.name for question in QUESTIONS})
    if unknown:
        expected = ", ".join(question.name for question in QUESTIONS)
        raise BadInput(f"{unknown[0]}: no such answer; expected one of {expected}")
    given = Answers(answers)
    given.read()
    return starting_point(facts_of(given))


_AS_ANSWERED = (
    "name", "kind", "radius", "length", "nominal_length", "supply", "shaft_radius", "mass", "inertia", "stop"
)  # fmt: skip


def facts_of(answers: Answers) -> Facts:
    """What the answers say."""
    values, texts = answers.values, answers.texts
    regulator = _regulator(values) if values["drive"] == "regulator" else None
    mass = values["limb_mass"]
    return Facts(
        **{name: values[name] for name in _AS_ANSWERED},
        muscle=_muscle(values),
        muscle_name=f"muscle {texts['muscle']}",
        valve=_valve(values, regulator),
        valve_name=f"valve {texts['valve']}" if regulator is None else f"pressure regulators {texts['regulator']}",
        voltage=values.get("voltage", (0.0, 10.0)),
        pressure_range=values["sensor_range"],
        pressure_bits=round(values["sensor_bits"]),
        period=1.0 / values["rate"],
        regulator=regulator,
        regulator_time=values.get("regulator_time", 0.0),
        limb=None if mass is None else (mass, values["limb_distance"], values["limb_hanging"]),
    )


def _muscle(values: Mapping[str, Any]) -> MusclePart:
    if values["muscle"] != OWN:
        return values["muscle"]
    sheet = {name: values[f"muscle_{name}"] for name in ("diameter", "force", "pressure")}
    share = values["muscle_contraction"] / 100.0
    return MusclePart(**sheet, contraction=share, source="measured or by its data sheet")


def _valve(values: Mapping[str, Any], regulator: RegulatorPart | None) -> ValvePart:
    if regulator is not None:
        return valve_parts()["shin2022"].replaced(source=regulator.source)  # its numbers play no part
    if values["valve"] != OWN:
        return values["valve"]
    curve, closed = Curve(voltage=values["voltage"], open_rate=(0.0, 1.0)), values["valve_centre"] == "closed"
    source = "its data sheet; the curve is a guess"
    return ValvePart(flow=values["valve_flow"], curve=curve, closed_centre=closed, source=source)


def _regulator(values: Mapping[str, Any]) -> RegulatorPart:
    if values["regulator"] != OWN:
        return values["regulator"]
    low, high = values["regulator_range"]
    return RegulatorPart(lowest=low, highest=high, hysteresis=0.0, source="your answer")


def remarks(facts: Facts, assumed: Collection[str]) -> list[str]:
    """The head of the file: which numbers come from where. `assumed`: names of the questions with the default."""
    lines = [
        "A starting point by new_rig: identify finds the values of your joint.",
        "Measured: geometry, supply, joint.mass, joint.inertia, sensors.pressure_step.",
        "From data sheets: force and volume of the muscles, areas of the valves. Muscles of one kind differ by 15 %.",
        "Assumed: valve curves, friction, gas.polytropic_*, noise of the sensors, uncertainty, tunings.",
        "Priors (standard deviations before identification) are wide where a number is assumed.",
        "Those of valve_offset say by how much the guessed curves may be shifted.",
    ]
    if assumed:
        options = ", ".join(question.option for question in QUESTIONS if question.name in assumed)
        lines.append(f"Default answers were taken for: {options}.")
    if facts.regulator is not None:
        told = "hysteresis by the same source" if facts.regulator.hysteresis else "hysteresis unknown and taken as none"
        lines += [
            f"Of the regulators: range by {facts.regulator.source}.",
            f"Their rise time is your answer, their damping ratio assumed, {told}. Valves and flow are not used.",
            "Compare range and hysteresis with the data sheet of yours.",
        ]
    elif facts.voltage[0] < 0.0:
        low, high = facts.voltage
        lines.append(f"A bipolar amplifier: {low:g} to {high:g} V move the valve from end to end.")
    if facts.valve.closed_centre:
        lines += [
            "This valve lets no air pass at its middle voltage (overlap 0.5). Near it, it holds a pressure, so that",
            "the voltages alone do not tell the pressures: recordings with measured pressures are needed.",
        ]
    return lines
