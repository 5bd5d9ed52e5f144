"""The controller node in the process of the tests: one command for each estimate, safe voltages for everything else."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from sent import MS, asked, estimate, refer, stamp_of

pytestmark = pytest.mark.ros

SAFE = (5.5, 5.5)


@pytest.fixture
def node(new_node: Callable[..., Any]) -> Any:
    from pam_antagonist.nodes.controller import ControllerNode

    node = new_node(ControllerNode)
    node.trigger_activate()
    node.keep(commands=node._output)
    return node


def published(node: Any) -> list[tuple[int, tuple[float, float]]]:
    """Stamp and voltages of each command so far."""
    return [(stamp_of(message), tuple(message.voltage)) for message in node.sent["commands"]]


def choose(node: Any, **values: Any) -> tuple[bool, str]:
    from rclpy.parameter import Parameter

    result = node.set_parameters_atomically([Parameter(name, value=value) for name, value in values.items()])
    return result.successful, result.reason


def test_one_command_for_each_estimate_with_its_stamp(node: Any) -> None:
    begin = node.now_ns()
    estimate(node, begin - MS, angle=0.2)
    assert published(node)[-1][1] == SAFE, "without a reference"
    node.sent["commands"].clear()
    refer(node, 0, 0.1)
    for k in range(50):
        node.now_ns = lambda k=k: begin + k * MS  # a machine that stalls makes no estimate late
        estimate(node, begin + k * MS, angle=0.01 * math.sin(k))
    assert [stamp for stamp, _ in published(node)] == [begin + k * MS for k in range(50)]
    assert published(node)[0][1] == SAFE  # bumpless
    # then the paper's law: 5.45 V/rad on the change of the angle
    change = published(node)[11][1][0] - published(node)[10][1][0]
    assert change == pytest.approx(-5.45 * 0.01 * (math.sin(11) - math.sin(10)), abs=1e-3)


def test_torque_reference_controls_the_torque(node: Any) -> None:
    begin = node.now_ns()
    refer(node, 1, 0.5)
    estimate(node, begin, angle=0.3, torque=0.5)
    estimate(node, begin + MS, angle=-0.3, torque=0.5)
    assert [voltage for _, voltage in published(node)] == [SAFE, SAFE]
    estimate(node, begin + 2 * MS, angle=0.3, torque=0.4)
    assert published(node)[-1][1][0] == pytest.approx(5.5 + 7.45 * 0.1, abs=1e-3)


@pytest.mark.parametrize(
    ("law", "wrong"),
    [
        *(("pi", wrong) for wrong in ({"angle": math.nan}, {"angle": -math.inf}, {"flags": 64}, {"age": 21 * MS})),
        *(("model", wrong) for wrong in ({"angle": math.nan}, {"flags": 64}, {"age": 21 * MS}, {"pressure": math.nan})),
    ],
)
def test_estimates_that_cannot_be_used_give_safe_voltages_and_the_next_one_goes_on(
    node: Any, law: str, wrong: dict[str, float]
) -> None:
    choose(node, law=law)
    begin = node.now_ns()
    refer(node, *((0, 0.3) if law == "pi" else (3, 0.5, 6.0)))
    estimate(node, begin, angle=0.3)
    estimate(node, begin + MS, angle=0.1)
    before = published(node)[-1][1]
    assert before != SAFE
    given = {"angle": 0.1, **wrong}
    estimate(node, node.now_ns() - int(given.pop("age", 0)), **given)
    assert published(node)[-1][1] == SAFE
    estimate(node, node.now_ns(), angle=0.1)
    if law == "pi":  # the other law begins anew, without a bump
        assert published(node)[-1][1] == pytest.approx(before, abs=1e-3)


@pytest.mark.parametrize(
    ("law", "wrong"),
    [
        *(("pi", wrong) for wrong in ((0, math.nan), (0, -math.inf), (1, math.inf), (2, 0.0))),
        *(("model", (mode, 0.1, stiffness)) for mode, stiffness in ((2, math.nan), (2, -6.0), (3, 0.0), (4, math.inf))),
        ("model", (9, 0.1, 6.0)),
    ],
)
def test_references_that_cannot_be_used_give_safe_voltages_until_a_better_one_comes(
    node: Any, law: str, wrong: tuple[float, ...]
) -> None:
    choose(node, law=law)
    good = (0, 0.1) if law == "pi" else (2, 0.1, 6.0)
    begin = node.now_ns() + 10**9  # never late, and a sample apart, however long this takes
    refer(node, *good)
    for k in range(50):
        estimate(node, begin + k * MS)
    assert published(node)[-1][1] != SAFE
    refer(node, *wrong)
    for k in range(50, 53):
        estimate(node, begin + k * MS)
        assert published(node)[-1][1] == SAFE
    assert node.health(1)["commands"].level == 2
    refer(node, *good)
    for k in range(53, 55):
        estimate(node, begin + k * MS)
    assert published(node)[-1][1] != SAFE and node.health(2)["commands"].level < 2


def test_estimates_behind_a_gap_give_safe_voltages_until_the_filter_has_settled(node: Any) -> None:
    begin = node.now_ns() + 10**9
    refer(node, 0, 0.3)
    for k in (*range(10), *range(40, 90)):
        estimate(node, begin + k * MS, angle=0.1)
    safe = [voltage == SAFE for _, voltage in published(node)]
    assert safe[1:] == [False] * 9 + [True] * 40 + [False] * 10  # the very first one is what the valves have


def test_silence_gives_safe_voltages_in_the_order_of_stamps(node: Any) -> None:
    node._watch()
    assert published(node) == []  # nothing has come that could be missed
    begin = node.now_ns() - 25 * MS
    refer(node, 0, 0.3)
    estimate(node, begin, angle=0.3)
    node._heard_ns = begin
    node._watch()
    node._watch()
    estimate(node, begin + MS, angle=0.1)
    stamps = [stamp for stamp, _ in published(node)]
    assert len(stamps) == 4
    assert stamps == sorted(set(stamps))
    assert stamps[1] < begin + MS
    assert [voltage for _, voltage in published(node)[1:3]] == [SAFE, SAFE]


def test_last_command_is_safe(node: Any) -> None:
    begin = node.now_ns()
    refer(node, 0, 0.3)
    estimate(node, begin)
    estimate(node, begin + MS)
    node.close()
    assert published(node)[-1] == (begin + MS + 1, SAFE)


def test_an_inactive_controller_tells_its_health_and_can_be_cleared(node: Any) -> None:
    begin = node.now_ns()
    refer(node, 0, 0.3)
    for k in range(20):
        estimate(node, begin + k * MS, angle=0.5)
    assert "angle" in node.health(1)["commands"].message
    node.trigger_deactivate()
    assert node.health(2)["commands"].level == 2
    assert node.health(3)["reference"].values["publishers"] == "none"
    node.now_ns = lambda: begin + 1000 * MS  # the angle that was too large is long ago
    assert asked(node._clear)[0]
    node.trigger_activate()
    estimate(node, begin + 1000 * MS, angle=0.1)
    assert published(node)[-1][1] == SAFE  # the reference from before does not count
    assert node.health(4)["reference"].message == "no reference has come yet"


def tell_rig(node: Any, who: str, rig: str) -> None:
    from std_msgs.msg import String

    from pam_antagonist.rig import RigIdentity, load_rig

    node._rigs._on_rig(String(data=RigIdentity.of(load_rig(rig), who).text()))


@pytest.mark.parametrize("who", ["estimator", "plant", "bridge"])
def test_another_joints_rig_file_stops_until_the_files_agree(node: Any, who: str, monkeypatch) -> None:
    begin = node.now_ns() + 10**9
    monkeypatch.setattr(node, "now_ns", lambda: begin)  # reading rig files takes a busy machine a second and more
    refer(node, 0, 0.3)
    for k in range(3):
        estimate(node, begin + k * MS, angle=0.1)
    assert published(node)[-1][1] != SAFE
    tell_rig(node, "estimator", "shin2022")
    tell_rig(node, "bridge", "shin2022")
    estimate(node, begin + 3 * MS, angle=0.1)
    assert published(node)[-1][1] != SAFE and node.health(1)["rig"].message == "the same for all"

    monkeypatch.setattr(node._rigs, "forget_the_gone", lambda: None)  # nobody here is really there
    tell_rig(node, who, "shin2022_as_printed")
    estimate(node, begin + 4 * MS, angle=0.1)
    assert published(node)[-1][1] == SAFE
    health = node.health(2)
    assert health["commands"].level == health["rig"].level == 2
    assert f"the rig file of the {who} is another joint's: force of muscle 2" in health["commands"].message
    assert "(shin2022_as_printed (" in health["rig"].message and "here shin2022 (" in health["rig"].message
    good, why = asked(node._clear)
    assert not good and why.startswith(f"not cleared, since the cause is still present: the rig file of the {who}")

    tell_rig(node, who, "shin2022")
    estimate(node, begin + 5 * MS, angle=0.1)
    assert published(node)[-1][1] == SAFE  # latched
    assert node.health(3)["rig"].level == 0
    assert asked(node._clear)[0]
    for k in range(6, 90):
        estimate(node, begin + k * MS, angle=0.1)
    assert published(node)[-1][1] != SAFE


def test_a_bridge_replaces_the_plant_and_who_is_gone_does_not_count(node: Any) -> None:
    tell_rig(node, "plant", "shin2022_as_printed")
    tell_rig(node, "bridge", "shin2022")
    assert node._rigs.present == "" and "plant" not in node.health(1)["rig"].values
    tell_rig(node, "estimator", "sealed_joint")
    assert "estimator" in node._rigs.present
    assert asked(node._clear)[0]  # nobody of that name is there any more
    assert node._rigs.present == ""


def test_what_is_no_rig_is_passed_over(node: Any) -> None:
    from std_msgs.msg import String

    for text in ("", "shin2022", "{}", '{"node": "estimator"}'):
        node._rigs._on_rig(String(data=text))
    tell_rig(node, "controller", "sealed_joint")  # its own name: an earlier life's
    assert node._rigs.present == "" and not node.stopped
    assert node.health(1)["rig"].message == "no other node has published its rig yet"


def test_a_stiffness_takes_the_law_through_the_model_and_says_so(node: Any) -> None:
    begin = node.now_ns() + 10**9
    refer(node, 2, 0.1, 6.0)
    estimate(node, begin)
    assert published(node)[-1][1] == SAFE
    assert "law: pi does not have: set law to model" in node.health(1)["reference"].message
    assert choose(node, law="model") == (True, "")
    refer(node, 2, 0.1, 6.0)
    for k in range(1, 400):
        estimate(node, begin + k * MS)
    assert published(node)[1][1] == SAFE  # bumpless
    assert published(node)[-1][1][0] > 6.0 and published(node)[-1][1][1] < 5.0
    health = node.health(2)
    assert health["commands"].level == 0 and health["commands"].values["law"] == "model"
    assert health["reference"].values["mode"] == "angle_stiffness"
    good, why = choose(node, law="pi")
    assert not good and "law: pi has no mode ANGLE_STIFFNESS" in why
    assert choose(node, law="none")[0] is False


def test_a_change_of_the_law_makes_no_jump(node: Any) -> None:
    begin = node.now_ns() + 10**9
    refer(node, 0, 0.1)
    for k in range(300):
        estimate(node, begin + k * MS)
    for number, law in enumerate(("model", "pi", "model")):
        before = published(node)[-1][1]
        assert choose(node, law=law)[0]
        for k in range(300):
            estimate(node, begin + (300 * (number + 1) + k) * MS)
            if k == 0:
                assert published(node)[-1][1] == pytest.approx(before, abs=1e-9)
        assert published(node)[-1][1] != pytest.approx(before, abs=0.05)


def test_modes_and_law_that_change_while_it_is_stopped_move_no_valve_and_count_once_it_is_cleared(node: Any) -> None:
    begin = node.now_ns() + 10**9
    choose(node, law="model")
    refer(node, 2, 0.1, 6.0)
    for k in range(50):
        estimate(node, begin + k * MS)
    assert published(node)[-1][1] != SAFE
    node.stop("somebody said so")
    for k, (mode, value, stiffness) in enumerate([(2, 0.1, 6.0), (4, 0.0, 6.0), (3, 0.5, 6.0), (2, 0.1, -1.0)]):
        refer(node, mode, value, stiffness)
        estimate(node, begin + (50 + k) * MS)
        assert published(node)[-1][1] == SAFE
    refer(node, 0, -0.1)
    assert choose(node, law="pi") == (True, "")
    estimate(node, begin + 54 * MS)
    assert published(node)[-1][1] == SAFE
    assert asked(node._clear)[0]
    for k in range(55, 400):
        estimate(node, begin + k * MS)
    after = [voltage for stamp, voltage in published(node) if stamp >= begin + 55 * MS]
    assert after[0] == SAFE  # bumpless
    assert after[-1][0] < SAFE[0] - 0.01 and after[-1][1] > SAFE[1] + 0.01
    assert node.health(1)["reference"].values["mode"] == "angle"


def test_a_reference_out_of_reach_becomes_the_nearest_one_and_that_is_said(node: Any) -> None:
    choose(node, law="model")
    refer(node, 2, 0.1, 60.0)
    estimate(node, node.now_ns())
    health = node.health(1)["reference"]
    assert health.level == 1 and "with 60 N m/rad is out of reach" in health.message
    assert 5.0 < float(health.values["stiffness asked for [N m/rad]"]) < 15.0


def test_the_governor_holds_a_reference_back_and_says_by_which_limit(node: Any) -> None:
    begin = node.now_ns() + 10**9
    choose(node, law="model")
    refer(node, 2, 0.43, 6.0)  # the set ends at 0.36 rad, and the limit is 0.436: the estimate's variance counts
    for k in range(40):
        estimate(node, begin + k * MS, angle=0.1, variance=4e-3)
    values = node.health(1)["commands"].values
    assert values["governor"] == "holds the reference back: angle" and values["held back by the governor"] > 0
    refer(node, 2, 0.1, 6.0)
    for k in range(40, 80):
        estimate(node, begin + k * MS, angle=0.1, variance=4e-3)
    assert node.health(2)["commands"].values["governor"] == "lets the reference through"
