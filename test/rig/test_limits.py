"""What a rig file says of its joint: how far it may go, where it rests, units for people, what intervals rest on."""

from __future__ import annotations

import math

import pytest

from pam_antagonist import new_rig
from pam_antagonist.cli.demo import MODEL, law_of, task
from pam_antagonist.control.command import Mode
from pam_antagonist.control.laws import Reachable
from pam_antagonist.control.stiffness import Box
from pam_antagonist.errors import BadInput
from pam_antagonist.nodes import controller, plant
from pam_antagonist.nodes.parameters import Parameter, by_rig
from pam_antagonist.report.document import Comparison, in_first_lines
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.physical import angle_range
from pam_antagonist.rig.units import assumption, readable, unit_of
from pam_antagonist.safety import EstimateSupervision, Following
from pam_antagonist.simulation import excitation
from pam_antagonist.simulation.plant import Plant

COMMON = {
    "inertia": "0.002", "mass": "0.4kg", "nominal_length": "200mm", "length": "187mm", "muscle": "DMSP-10",
}  # fmt: skip
RIGS = {
    "lever": {"radius": "20mm", "supply": "6bar", "valve": "MPYE-5-M5", "stop": "40deg", "rate": "500"},
    "pulley": {"kind": "pulley", "radius": "15mm", "supply": "2.5bar", "valve": "own", "valve_flow": "100",
               "voltage": "0:5", "stop": "30deg"},
    "slow": {"kind": "pulley", "radius": "16mm", "supply": "7bar", "drive": "regulator", "regulator": "ITV2050",
             "regulator_time": "0.11", "stop": "38deg", "rate": "50"},
    "no_stop": {"radius": "20mm", "supply": "5bar", "drive": "regulator", "regulator": "VEAA-D9"},
}  # fmt: skip


@pytest.fixture(scope="module")
def rigs() -> dict[str, Rig]:
    """Rigs of ``new_rig`` that are not of the paper's size."""
    return {name: new_rig(name=name, **COMMON, **answers) for name, answers in RIGS.items()}


def defaults(table: tuple[Parameter, ...], rig: Rig) -> dict:
    return by_rig({parameter.name: parameter.default for parameter in table}, rig)


def test_of_the_paper_s_joint_the_limits_are_the_paper_s() -> None:
    values = defaults(controller.PARAMETERS, load_rig("shin2022"))
    assert values["stop_angle"] == pytest.approx(math.radians(26.0))
    assert values["max_angle"] == pytest.approx(math.radians(25.0))
    assert values["max_torque"] == pytest.approx(3.2, abs=0.01)
    assert (values["safe_voltage"], values["bias"], values["vent_voltage"]) == ([5.5, 5.5], 5.5, [0.0, 0.0])
    assert values["max_age"] == 0.02
    assert defaults(plant.PARAMETERS, load_rig("shin2022"))["initial_pressure"] == [450e3, 450e3]
    assert excitation.for_rig(load_rig("shin2022"), "paper", 4.0, 0)[0, 0] == 5.5


@pytest.mark.parametrize("name", RIGS)
def test_of_another_joint_they_are_those_of_its_file(name: str, rigs: dict[str, Rig]) -> None:
    rig = rigs[name]
    values = defaults(controller.PARAMETERS, rig)
    stop = rig.joint.stop if rig.joint.stop is not None else math.radians(25.0)
    watched = EstimateSupervision(values["stop_angle"], 0.01, 13.8, 0.1, 0.1, rig.sample_period)
    stamps = range(0, 10**9, round(rig.sample_period * 1e9))
    assert not any(watched.check(stamp, 0.99 * stop, 1.0, 0) for stamp in stamps), "the joint may go to its stop"
    said = [watched.check(10**9 + stamp, -stop - 0.03, 1.0, 0) for stamp in stamps][-1]
    assert f"the limit is {math.degrees(stop) + 1.0:.1f} deg" in said
    assert values["max_angle"] == stop
    assert values["max_age"] >= 3 * rig.sample_period
    source = defaults(plant.PARAMETERS, rig)
    assert source["command_timeout"] >= 3 * rig.sample_period
    first, second = source["initial_pressure"]
    assert first == second and rig.atmosphere.pressure < first < rig.supply.pressure
    if rig.drive == "valve":
        low, high = rig.command_limits
        assert all(low < voltage < high for voltage in (*source["safe_voltage"], values["bias"]))
        still = Plant(rig, noise=False)
        for _ in range(round(2.0 / rig.sample_period)):
            sample = still.step(tuple(source["safe_voltage"]))
        assert sample.pressure == pytest.approx((first, second), rel=0.03), "the safe voltages keep the pressures"
        assert excitation.for_rig(rig, "paper", 4.0)[0, 0] == pytest.approx(source["safe_voltage"][0], abs=0.3)


def test_the_valves_of_a_slow_rig_may_follow_a_sample_behind() -> None:
    """At 50 Hz a ramp of the command over four samples is no disobedience; a command that is ignored is one."""
    period, following = 0.02, Following((400e3, 400e3), 25e3, 0.02)
    said = []
    for look in range(4 * 40):
        now, sample = round(look * period / 4 * 1e9), look // 4
        command, valves = (400e3 + 30e3 * min(max(k, 0), 4) for k in (sample, sample - 1))
        following.saw((valves, valves), now)
        said.append(following.astray((command, command), now))
    assert not any(said)
    late = [following.astray((700e3, 700e3), round((1.0 + 0.005 * k) * 1e9)) for k in range(40)]
    assert not any(late), "valves that were not heard of for long are not known"
    for k in range(40):
        following.saw((400e3, 400e3), round((2.0 + 0.005 * k) * 1e9))
        late.append(following.astray((700e3, 700e3), round((2.0 + 0.005 * k) * 1e9)))
    assert any(late)


def test_what_was_given_is_not_changed(rigs: dict[str, Rig]) -> None:
    values = {"stop_angle": 0.2, "safe_voltage": [-1.0, 3.0], "command_timeout": 0.5}
    assert by_rig(values, rigs["lever"]) == {**values, "safe_voltage": [5.0, 3.0]}


def test_the_law_of_control_is_that_of_the_drive_unless_it_is_said(rigs: dict[str, Rig]) -> None:
    drives = {rig.drive: by_rig({"law": "auto"}, rig)["law"] for rig in rigs.values()}
    assert drives == {"valve": "pi", "regulator": "model"}
    assert by_rig({"law": "model"}, rigs["lever"])["law"] == "model"


def test_a_value_below_the_range_is_refused_unless_it_leaves_it_to_the_rig_file() -> None:
    (timeout,) = (parameter for parameter in plant.PARAMETERS if parameter.name == "command_timeout")
    assert timeout.check(0.0) == 0.0
    with pytest.raises(BadInput, match=r"from 0.002 to 1, or 0"):
        timeout.check(0.001)
    (bias,) = (parameter for parameter in controller.PARAMETERS if parameter.name == "bias")
    with pytest.raises(BadInput, match=r"from -10 to 10"):
        bias.check(-10.5)


@pytest.mark.parametrize("name", RIGS)
@pytest.mark.parametrize("mode", [Mode.ANGLE, Mode.TORQUE, Mode.ANGLE_STIFFNESS])
def test_a_demo_asks_for_what_the_joint_reaches(name: str, mode: Mode, rigs: dict[str, Rig]) -> None:
    rig = rigs[name]
    law = law_of(rig, mode, None)
    assert law == MODEL, "the gains of the PI are the paper's joint's"
    steps = task(rig, mode, law, 12.0).references
    reach = Reachable(rig.parameters(), Box.of(rig.parameters()))
    for _, value, stiffness in steps:
        asked = reach.nearest(mode, value, stiffness)
        assert asked[0] == value and asked[1] == pytest.approx(stiffness, rel=0.02, nan_ok=True)
    largest = max(value for _, value, _ in steps)
    assert largest >= 0.3 * (angle_range(rig) if mode is not Mode.TORQUE else reach.torques(0.0)[1])


def test_gains_of_voltages_are_refused_for_a_joint_without_them(rigs: dict[str, Rig]) -> None:
    with pytest.raises(BadInput, match="--gains fast"):
        law_of(rigs["slow"], Mode.ANGLE, "fast")
    assert law_of(load_rig("shin2022"), Mode.ANGLE, None) == "fast"
    assert law_of(load_rig("shin2022"), Mode.ANGLE, "published") == "published"
    assert law_of(rigs["lever"], Mode.ANGLE, "fast") == "fast"


@pytest.mark.parametrize(
    ("name", "unit", "shown", "value"),
    [
        ("valve_1.inflow_area", "m²", "mm²", 0.05184),
        ("supply.pressure", "Pa", "kPa", 710.0),
        ("joint.stop", "rad", "°", 25.0),
        ("friction.muscle", "N m Pa²", "N m kPa²", 400.0),
        ("gas.polytropic_flow", "-", "-", 1.1),
    ],
)
def test_a_parameter_is_shown_in_a_unit_for_people(name: str, unit: str, shown: str, value: float) -> None:
    rig = load_rig("shin2022")
    assert unit_of(rig, name) == unit
    assert readable(unit).name == shown
    assert rig.value(name) * readable(unit).scale == pytest.approx(value)


def test_a_row_of_pressures_has_one_unit_in_which_its_smallest_can_be_read() -> None:
    table = Comparison("", "UKF", "model alone")
    table.pressures("RMSE", (0.0662, 412.0))
    table.pressures("RMSE", (1520.0, None))
    assert table.table().rows == (("RMSE [Pa]", "0.0662", "412"), ("RMSE [kPa]", "1.52", "–"))


RIG = load_rig("shin2022")


def test_what_a_file_claims_is_called_an_assumption() -> None:
    text = assumption(RIG)
    assert text is not None and text.startswith("Assumption: rig shin2022 was not identified.")
    assert "friction.shaft ± 2.0 %" in text and "muscle_2.force.w2 ± 2.9 %" in text
    assert text.endswith("and if nothing else is wrong.")
    assert [block.text for block in in_first_lines(text)] == [text]


@pytest.mark.parametrize(("tuning", "uncertainty"), [("published", RIG.uncertainty), ("default", {})])
def test_a_filter_that_knows_of_no_uncertainty_claims_exact_parameters(tuning: str, uncertainty: dict) -> None:  # type: ignore[type-arg]
    text = assumption(RIG.replaced(uncertainty=uncertainty), tuning)
    assert text is not None and "known exactly" in text and "±" not in text


def test_beside_an_identified_rig_it_is_said_of_which_rig_it_is() -> None:
    text = assumption(RIG, identified=True)
    assert text is not None and "As configured, its 95 % intervals" in text
    assert "intervals of the identified rig follow from the recordings" in text
    assert "As configured" not in (assumption(RIG) or "")


def test_an_identified_rig_assumes_nothing() -> None:
    assert load_rig("sealed_joint").identified
    assert assumption(RIG.replaced(identified="free, locked")) is None
    assert in_first_lines(None) == ()


def test_a_coefficient_has_the_unit_of_its_form() -> None:
    units = {}
    for form in ("hildebrandt", "sarosi", "braided"):
        rig = RIG.unchecked(model=RIG.model.unchecked(force=form))
        units[form] = [unit_of(rig, f"muscle_1.force.c{k}") for k in range(1, 8)]
    assert units["hildebrandt"] == ["N"] * 7
    assert units["sarosi"] == ["N", "N", "-", "N", "N", "N", "N"]
    assert units["braided"] == ["N", "-", "N", "-", "-", "m", "N"]
