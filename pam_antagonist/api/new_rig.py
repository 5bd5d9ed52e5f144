"""``new_rig``: a rig from what a ruler, a scale and data sheets tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pam_antagonist.api.rig_questions import OWN, QUESTIONS, Question
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
    values: dict[str, Any] = {}
    unknown = sorted(answers.keys() - {question.name for question in QUESTIONS})
    if unknown:
        expected = ", ".join(question.name for question in QUESTIONS)
        raise BadInput(f"{unknown[0]}: no such answer; expected one of {expected}")
    for question in QUESTIONS:
        text = answers.get(question.name)
        if not question.wanted(values):
            if text is not None:
                raise BadInput(f"{question.name}: only with {question.condition.words.removeprefix('--')}")
            continue
        if text is None and question.default is None:
            raise BadInput(f"{question.name}: missing; expected {question.text[0].lower()}{question.text[1:]}")
        try:
            values[question.name] = question.read(str(question.default if text is None else text))
        except BadInput as error:
            raise BadInput(f"{question.name} {error}") from None
    return starting_point(facts_of(values))


def facts_of(values: Mapping[str, Any]) -> Facts:
    """What the answers say."""
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


def remarks(facts: Facts, assumed: Sequence[Question]) -> list[str]:
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
