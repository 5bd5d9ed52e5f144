"""``new_rig``: a rig from what a ruler, a scale and data sheets tell."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from pam_antagonist.api.rig_questions import OWN, QUESTIONS, Answers
from pam_antagonist.errors import BadInput
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
    return starting_point(facts_of(given.values))


_AS_ANSWERED = (
    "name", "kind", "radius", "length", "nominal_length", "supply", "shaft_radius", "mass", "inertia", "stop"
)  # fmt: skip


def facts_of(values: Mapping[str, Any]) -> Facts:
    """What the answers say."""
    low, high = values.get("voltage", (0.0, 10.0))
    regulator = _regulator(values) if values["drive"] == "regulator" else None
    mass = values["limb_mass"]
    return Facts(
        **{name: values[name] for name in _AS_ANSWERED},
        muscle=_muscle(values),
        muscle_name=f"muscle {values['muscle']}",
        valve=_valve(values, regulator),
        valve_name=f"valve {values['valve']}" if regulator is None else f"pressure regulators {values['regulator']}",
        voltage=(low, high),
        pressure_range=values["sensor_range"],
        pressure_bits=round(values["sensor_bits"]),
        period=1.0 / values["rate"],
        regulator=regulator,
        regulator_time=values.get("regulator_time", 0.0),
        limb=None if mass is None else (mass, values["limb_distance"], values["limb_hanging"]),
    )


def _muscle(values: Mapping[str, Any]) -> MusclePart:
    if values["muscle"] != OWN:
        return named("muscle", values["muscle"], muscle_parts())
    sheet = {name: values[f"muscle_{name}"] for name in ("diameter", "force", "pressure")}
    share = values["muscle_contraction"] / 100.0
    return MusclePart(**sheet, contraction=share, source="measured or by its data sheet")


def _valve(values: Mapping[str, Any], regulator: RegulatorPart | None) -> ValvePart:
    if regulator is not None:
        return valve_parts()["shin2022"].replaced(source=regulator.source)  # its numbers play no part
    if values["valve"] != OWN:
        return named("valve", values["valve"], valve_parts())
    curve, closed = Curve(voltage=values["voltage"], open_rate=(0.0, 1.0)), values["valve_centre"] == "closed"
    source = "its data sheet; the curve is a guess"
    return ValvePart(flow=values["valve_flow"], curve=curve, closed_centre=closed, source=source)


def _regulator(values: Mapping[str, Any]) -> RegulatorPart:
    if values["regulator"] != OWN:
        return named("regulator", values["regulator"], regulator_parts())
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
