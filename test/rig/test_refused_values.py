"""Values that a rig may not have: each is refused in one line that names file, key and what was expected."""

from __future__ import annotations

import pytest

from pam_antagonist.model import parameters as par
from pam_antagonist.rig import load_rig
from pam_antagonist.rig.file import write_rig

CASES: dict[str, tuple[str, ...]] = {
    "typo in a key": ("radius: 0.0365", "raduis: 0.0365", "geometry.raduis", "did you mean 'radius'"),
    "typo in a section": ("geometry:", "geometri:", "geometri", "did you mean 'geometry'"),
    "unknown key": ("radius: 0.0365", "radius: 0.0365\n  colour: 3", "unknown key 'geometry.colour'"),
    "missing key": ("  length: 0.165", "  # length: 0.165", "geometry.length is missing"),
    "missing section": ("supply: {pressure: 710.0e+3}", "", "supply is missing"),
    "word for a number": ("radius: 0.0365", "radius: wide", "geometry.radius",
        "r, radius of the seesaw or pulley [m]"),
    "nothing for a number": ("radius: 0.0365", "radius:", "geometry.radius", "r, radius of the seesaw or pulley [m]"),
    "list for a number": ("radius: 0.0365", "radius: [0.0365]", "geometry.radius",
        "r, radius of the seesaw or pulley [m]"),
    "number for a section": ("gas:\n", "gas: 3\nother:\n", "other"),
    "duplicate key": ("radius: 0.0365", "radius: 0.0365\n  radius: 0.0400", "'radius'", "twice", "line 12"),
    "duplicate section": ("supply: {", "gas: {}\nsupply: {", "'gas'", "twice"),
    "gauge supply": ("710.0e+3}", "0.0}", "supply.pressure", "150000", "P_tank, absolute [Pa]"),
    "supply in kPa": ("710.0e+3}", "710.0}", "supply.pressure", "greater than 150000", "absolute [Pa]"),
    "supply in bar": ("710.0e+3}", "7.1}", "supply.pressure", "absolute [Pa]"),
    "gauge atmosphere": ("101.3e+3}", "0.0}", "atmosphere.pressure", "50000", "P_out, absolute [Pa]"),
    "atmosphere in kPa": ("101.3e+3}", "101.3}", "atmosphere.pressure", "absolute [Pa]"),
    "stop in degrees": ("stop: 0.4363323129985824", "stop: 25.0", "joint.stop", "[rad]"),
    "radius in mm": ("radius: 0.0365", "radius: 36.5", "geometry.radius", "[m]"),
    "length in mm": ("length: 0.165", "length: 165.0", "geometry.length", "[m]"),
    "period in ms": ("sample_period: 0.001", "sample_period: 1.0", "sample_period", "T_stp [s]"),
    "temperature in °C": ("temperature: 293.0", "temperature: 20.0", "gas.temperature", "T [K]"),
    "area in mm²": ("inflow_area: 5.184e-8", "inflow_area: 0.05184", "valve_1.inflow_area", "[m²]"),
    "negative inertia": ("inertia: 4.263e-4", "inertia: -4.263e-4", "joint.inertia", "J [kg m²]"),
    "yes for a number": ("stiffness: 4.117e-4", "stiffness: yes", "joint.stiffness", "'yes'"),
    "true for a number": ("stiffness: 4.117e-4", "stiffness: true", "joint.stiffness", "expected a number"),
    "a time for a number": ("inertia: 4.263e-4", "inertia: 0:30", "joint.inertia", "'0:30'"),
    "pressure floor in kPa": ("pressure_floor: 20.0e+3", "pressure_floor: 20.0", "friction.pressure_floor", "[Pa]"),
    "noise in kPa": ("pressure_std: 600.0", "pressure_std: 0.6", "sensors.pressure_std", "[Pa]"),
    "an uncertainty above the value of a positive number": ("friction.shaft: 0.004 ", "friction.shaft: 0.3 ",
        "uncertainty of friction.shaft", "cannot be negative"),
    "a gain that does not exist": ("gain: standard", "gain: optimal", "tunings.published.gain", "printed"),
    "negative friction": ("shaft: 0.2 ", "shaft: -0.2 ", "friction.shaft", "μ_s"),
    "open rate falls": ("0.33, 0.394", "0.394, 0.33", "valve_1.curve.open_rate", "do not decrease"),
    "open rate above 1": ("0.80, 1.0]", "0.80, 100.0]", "valve_1.curve.open_rate", "0 to 1"),
    "voltage falls": ("5.0, 5.5, 6.0", "5.5, 5.0, 6.0", "valve_1.curve.voltage", "increasing", "[V]"),
    "voltage stands": ("5.0, 5.5, 6.0", "5.5, 5.5, 6.0", "valve_1.curve.voltage", "increasing"),
    "a rate is missing": ("0.80, 1.0]", "1.0]", "valve_1.curve", "9 voltages but 8 open rates"),
    "no points": ("[0.0, 4.0, 4.6, 5.0, 5.5, 6.0, 6.6, 7.5, 10.0]", "[]", "valve_1.curve",
        "0 points, expected 2 to 24"),
    "voltage limits exchanged": ("voltage_min: 0.0, voltage_max: 10.0", "voltage_min: 9.0, voltage_max: 1.0",
        "valves.voltage_min", "voltage_max"),
    "volume in cm³": ("d1: -2.440e-2, d2: 6.824e-3, d3: -4.254e-4}               # m, m2",
        "d1: -24.40e+3, d2: 6.824e+3, d3: -425.4} # m, m2", "muscle_1.volume", "m³"),
    "force per kPa": ("v1: 7.045e-3, v2: -1.017e-3", "v1: 7.045, v2: -1.017", "muscle_1.force", "dF/dP",
        "absolute pressure in Pa"),
    "uncertain parameter misspelt": ("friction.shaft: 0.004", "friction.shft: 0.004", "friction.shft",
        "did you mean 'friction.shaft'"),
    "uncertain by nothing": ("friction.shaft: 0.004", "friction.shaft: 0.0", "uncertainty", "friction.shaft",
        "above 0"),
    "uncertain by less than nothing": ("friction.shaft: 0.004", "friction.shaft: -1.0", "uncertainty",
        "friction.shaft"),
    "no default tuning": ("  default:\n", "  other:\n", "tunings", "'default'"),
    "negative variance": ("[1.0e-12, 1.0e-6", "[-1.0e-12, 1.0e-6", "tunings.default"),
    "no measurement noise": ("[3.65e+5, 3.65e+5]", "[3.65e+5, 0.0]", "tunings.default", "measurement"),
    "three variances": ("process: [1.0e-12, 1.0e-6, 1.0e+4, 1.0e+4]", "process: [1.0e-12, 1.0e-6, 1.0e+4]",
        "tunings.default.process"),
    "neither yes nor no": ("consider: true", "consider: maybe", "tunings.default.consider"),
}  # fmt: skip
"""What is replaced in shin2022, by what, and words of the refusal."""


@pytest.mark.parametrize("case", CASES)
def test_refused(edited, refusal, case):
    old, new, *words = CASES[case]
    message = refusal(edited((old, new)))
    assert all(word in message for word in words), message


OVERLAID: dict[str, tuple[str, ...]] = {
    "bounds without the value": ("bounds: {friction.shaft: [0.3, 0.4]}", "friction.shaft", "holds its value, 0.2"),
    "bounds of nothing": ("bounds: {friction.shft: [0.1, 0.4]}", "unknown 'fr", "did you mean 'friction.shaft'?"),
    "negative bound of a positive number": ("bounds: {friction.shaft: [-0.1, 0.4]}", "bounds of friction.shaft: -0.1"),
    "effect": ("effects: {hysterese: {width: 1.0e-3}}", "'hysterese'", "did you mean 'hysteresis'", "creep"),
    "its parameter": ("effects: {leak: {aera_1: 1.0e-9}}", "effects.leak", "did you mean 'area_1'", "area_2"),
    "no muscle": ("effects: {leak: {area: 1.0e-9}}", "effects.leak", "'area'", "expected one of area_1, area_2"),
    "below": ("effects: {leak: {area_1: -1.0e-9}}", "effects.leak.area_1", "-1e-09", "0 to 5e-08 m2"),
    "above": ("effects: {valve_lag: {time_2: 12.0}}", "effects.valve_lag.time_2", "12", "0 to 2 s"),
    "quick": ("effects: {valve_lag: {time_1: 1.0e-4}}", "valve_lag.time_1", "0.0005 s, or 0 for none", "integration"),
    "quick at 100 Hz": ("sample_period: 0.01\neffects: {valve_lag: {time_1: 4.0e-4}}", "at least 0.0005 s, or 0"),
    "shape": ("effects: {creep: {time: 0.0}}", "effects.creep.time", "0.2 to 60 s", "time constant"),
    "nan": ("effects: {creep: {share_1: .nan}}", "effects.creep.share_1"),
    "number for an effect": ("effects: {leak: 3.0}", "effects.leak"),
    "word for a size": ("effects: {leak: {area_1: large}}", "effects.leak.area_1"),
    "true for a size": ("effects: {leak: {area_1: true}}", "effects.leak.area_1", "expected a number"),
    "uncertainty": ("uncertainty: {effects.leak.area_3: 1.0e-9}", "effects.leak.area_3", "did you mean"),
    "direction": ("directions: {a: {effects.leak.aera_1: 1e-9}}", "directions.a", "did you mean 'effects.leak.area_1'"),
    "force law": ("model: {force: polinomial}", *(f"'{name}'" for name in par.FORCE_FORMS)),
    "friction law": ("model: {friction: kikuwe}", *(f"'{name}'" for name in par.FRICTION_LAWS)),
    "no coefficients": ("model: {force: sarosi}", "muscle_1.force gives dF/dP"),
    "law13": ("effects: {learned: {law13: {place: flow}}}", "'law13'", "expected one of law1"),
    "number for a law": ("effects: {learned: {law1: 3.0}}", "'law1'", "expected one of"),
    "list for a law": ("effects: {learned: {law1: [1.0]}}", "law1: expected entries place"),
    "parameter of a law": ("effects: {learned: {law1_place: 3.0}}", "learned.law1"),
    "number for laws": ("effects: {learned: 3.0}", "learned"),
    "a sensor's law of slope 1": (
        "effects: {learned: {law1: {place: sensor, muscle: 1, argument: pressure, nodes: [0.0, 1.0e+5], "
        "values: [0.0, 1.0e+5]}}}", "law1.values", "readings that tell the pressures apart"),
    "a sensor's second law": (
        "effects: {learned: {law1: &s {place: sensor, muscle: both, argument: pressure, nodes: [1.0e+5, 2.0e+5], "
        "values: [0.0, 10.0]}, law2: *s}}", "law2.place: a second law of this sensor"),
}  # fmt: skip
"""What is laid over shin2022 -> words of the refusal."""


@pytest.mark.parametrize("case", OVERLAID)
def test_what_is_laid_over_another_rig_is_refused_as_well(tmp_path, refusal, case):
    (body, *words), path = OVERLAID[case], tmp_path / "rig.yaml"
    path.write_text(f"based_on: shin2022\nname: trial\n{body}", encoding="utf-8")
    message = refusal(path, 700)
    assert all(word in message for word in words), message


PLACES = {
    "geometry.radius": "radius: 0.0365",
    "muscle_1.volume.d1": "volume: {d1: -2.440e-2, d2: 6.824e-3, d3: -4.254e-4}               # m, m2",
    "joint.stop": "stop: 0.4363323129985824",
    "friction.shaft": "shaft: 0.2 ",
    "sensors.torque_std": "torque_std: 0.010",
    "uncertainty.friction.shaft": "friction.shaft: 0.004",
    "tunings.default.process": "process: [1.0e-12",
    "valve_1.curve.voltage": "voltage:   [0.0",
    "valve_1.curve.open_rate": "open_rate: [0.0",
}
"""Key -> text that ends with (or begins the value of) its first number."""


@pytest.mark.parametrize("value", [".nan", ".inf", "-.inf"])
@pytest.mark.parametrize("key", PLACES)
def test_numbers_that_are_none(edited, refusal, text, key, value):
    old = PLACES[key]
    number = "-2.440e-2" if key.endswith("d1") else old.split("[")[-1].split(" ")[-1 if old.strip() == old else -2]
    assert number in old
    message = refusal(edited((old, old.replace(number, value))))
    for part in (key.split(".")[0], key.split(".")[-1]):
        assert part in message, message


def test_several_mistakes_are_counted(edited, refusal):
    message = refusal(edited(("radius: 0.0365", "radius: wide"), ("length: 0.165", "length: long")))
    assert message.endswith("and 1 more")


def test_null_stop_means_none(edited):
    rig = load_rig(edited(("stop: 0.4363323129985824", "stop: null")))
    assert rig.joint.stop is None
    assert rig.parameters()[rig.parameters() == float("inf")].size == 1


@pytest.mark.parametrize("number", ["4e8", "400000000", "0400000000", "+4.e8", "0x17d78400"])
def test_a_number_is_read_as_written(edited, number):
    """YAML 1.1 reads 4e8 as text, and 0400000000 in base 8."""
    assert load_rig(edited(("muscle: 4.0e+8", f"muscle: {number}"))).friction.muscle == 4e8


@pytest.mark.parametrize("name", ["no", "on", "2022-01-01", "12:30"])
def test_a_word_is_no_switch_and_a_date_is_a_text(edited, tmp_path, name):
    rig = load_rig(edited(("name: shin2022\n", f"name: {name}\n"), ("consider: true", "consider: yes")))
    assert rig.name == name and rig.tunings["default"].consider is True
    # A text that looks like a number is quoted.
    for text in (name, "1e5", "0o17", "null"):
        write_rig(rig.replaced(name=text), tmp_path / f"{text}.yaml")
        assert load_rig(tmp_path / f"{text}.yaml").name == text


def test_rig_cannot_be_changed():
    rig = load_rig("shin2022")
    with pytest.raises((TypeError, ValueError)):
        rig.geometry.radius = 1.0  # type: ignore[misc]
    with pytest.raises((TypeError, ValueError)):
        rig.name = "other"  # type: ignore[misc]
