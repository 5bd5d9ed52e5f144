"""The controller node in the process of the tests: one command for each estimate, safe voltages for everything else."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from sent import MS, Loop, asked

pytestmark = pytest.mark.ros

SAFE = (5.5, 5.5)


def test_one_command_for_each_estimate_with_its_stamp(loop: Loop) -> None:
    assert loop.run(angle=0.2) == SAFE, "without a reference"
    loop.node.sent["commands"].clear()
    loop.refer(0, 0.1)
    begin = loop.now
    for k in range(50):
        loop.run(angle=0.01 * math.sin(k))
    assert [stamp for stamp, _ in loop.commands] == [begin + k * MS for k in range(1, 51)]
    assert loop.voltages[0] == SAFE  # bumpless
    # then the paper's law: 5.45 V/rad on the change of the angle
    change = loop.voltages[11][0] - loop.voltages[10][0]
    assert change == pytest.approx(-5.45 * 0.01 * (math.sin(11) - math.sin(10)), abs=1e-3)


def test_torque_reference_controls_the_torque(loop: Loop) -> None:
    loop.refer(1, 0.5)
    assert loop.run(angle=0.3, torque=0.5) == loop.run(angle=-0.3, torque=0.5) == SAFE
    assert loop.run(angle=0.3, torque=0.4)[0] == pytest.approx(5.5 + 7.45 * 0.1, abs=1e-3)


@pytest.mark.parametrize(
    ("law", "wrong"),
    [
        *(("pi", wrong) for wrong in ({"angle": math.nan}, {"angle": -math.inf}, {"flags": 64}, {"age": 21})),
        *(
            ("model", wrong)
            for wrong in ({"angle": math.nan}, {"flags": 64}, {"age": 21}, {"pressure": [math.nan] * 2})
        ),
    ],
)
def test_estimates_that_cannot_be_used_give_safe_voltages_and_the_next_one_goes_on(
    loop: Loop, law: str, wrong: dict[str, Any]
) -> None:
    loop.choose(law=law)
    loop.refer(*((0, 0.3) if law == "pi" else (3, 0.5, 6.0)))
    loop.run(angle=0.3)
    before = loop.run(angle=0.1)
    assert before != SAFE
    given = {"angle": 0.1, **wrong}
    late = loop.now + (given.pop("age", 0) + 1) * MS
    clock, loop.node.now_ns = loop.node.now_ns, lambda: late if "age" in wrong else loop.now
    assert loop.run(**given) == SAFE
    loop.node.now_ns = clock
    after = loop.run(angle=0.1)
    if law == "pi":  # the other law begins anew, without a bump
        assert after == pytest.approx(before, abs=1e-3)


@pytest.mark.parametrize(
    ("law", "wrong"),
    [
        *(("pi", wrong) for wrong in ((0, math.nan), (0, -math.inf), (1, math.inf), (2, 0.0))),
        *(("model", (mode, 0.1, stiffness)) for mode, stiffness in ((2, math.nan), (2, -6.0), (3, 0.0), (4, math.inf))),
        ("model", (9, 0.1, 6.0)),
    ],
)
def test_references_that_cannot_be_used_give_safe_voltages_until_a_better_one_comes(
    loop: Loop, law: str, wrong: tuple[float, ...]
) -> None:
    loop.choose(law=law)
    good = (0, 0.1) if law == "pi" else (2, 0.1, 6.0)
    loop.refer(*good)
    assert loop.run(50) != SAFE
    loop.refer(*wrong)
    loop.run(3)
    assert loop.voltages[-3:] == [SAFE] * 3 and loop.health("commands").level == 2
    loop.refer(*good)
    assert loop.run(2) != SAFE and loop.health("commands").level < 2


def test_estimates_behind_a_gap_give_safe_voltages_until_the_filter_has_settled(loop: Loop) -> None:
    loop.refer(0, 0.3)
    loop.run(10, angle=0.1)
    loop.now += 30 * MS
    loop.run(50, angle=0.1)
    safe = [voltage == SAFE for voltage in loop.voltages]
    assert safe[1:] == [False] * 9 + [True] * 40 + [False] * 10  # the very first one is what the valves have


def test_silence_gives_safe_voltages_in_the_order_of_stamps(loop: Loop) -> None:
    loop.node._watch()
    assert loop.commands == []  # nothing has come that could be missed
    loop.refer(0, 0.3)
    loop.run(angle=0.3)
    loop.silent(25)
    loop.node._watch()
    loop.node._watch()
    loop.run(angle=0.1)
    stamps = [stamp for stamp, _ in loop.commands]
    assert len(stamps) == 4 and stamps == sorted(set(stamps)) and stamps[2] < loop.now
    assert loop.voltages[1:3] == [SAFE, SAFE]


def test_last_command_is_safe(loop: Loop) -> None:
    loop.refer(0, 0.3)
    loop.run(2)
    loop.node.close()
    assert loop.commands[-1] == (loop.now + 1, SAFE)


def test_an_inactive_controller_tells_its_health_and_can_be_cleared(loop: Loop) -> None:
    loop.refer(0, 0.3)
    loop.run(20, angle=0.5)
    assert "angle" in loop.health("commands").message
    loop.node.trigger_deactivate()
    assert loop.health("commands").level == 2
    assert loop.health("reference").values["publishers"] == "none"
    loop.silent(1000)  # the angle that was too large is long ago
    assert asked(loop.node._clear)[0]
    loop.node.trigger_activate()
    assert loop.run(angle=0.1) == SAFE  # the reference from before does not count
    assert loop.health("reference").message == "no reference has come yet"


def tell_rig(loop: Loop, who: str, rig: str) -> None:
    from std_msgs.msg import String

    from pam_antagonist.rig import RigIdentity, load_rig

    loop.node._rigs._on_rig(String(data=RigIdentity.of(load_rig(rig), who).text()))


@pytest.mark.parametrize("who", ["estimator", "plant", "bridge"])
def test_another_joints_rig_file_stops_until_the_files_agree(
    loop: Loop, who: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop.node.now_ns = lambda: loop.now  # reading rig files takes a busy machine a second and more
    loop.refer(0, 0.3)
    assert loop.run(3, angle=0.1) != SAFE
    tell_rig(loop, "estimator", "shin2022")
    tell_rig(loop, "bridge", "shin2022")
    assert loop.run(angle=0.1) != SAFE and loop.health("rig").message == "the same for all"

    monkeypatch.setattr(loop.node._rigs, "forget_the_gone", lambda: None)  # nobody here is really there
    tell_rig(loop, who, "shin2022_as_printed")
    assert loop.run(angle=0.1) == SAFE
    commands, rig = loop.health("commands"), loop.health("rig")
    assert commands.level == rig.level == 2
    assert f"the rig file of the {who} is another joint's: force of muscle 2" in commands.message
    assert "(shin2022_as_printed (" in rig.message and "here shin2022 (" in rig.message
    good, why = asked(loop.node._clear)
    assert not good and why.startswith(f"not cleared, since the cause is still present: the rig file of the {who}")

    tell_rig(loop, who, "shin2022")
    assert loop.run(angle=0.1) == SAFE  # latched
    assert loop.health("rig").level == 0 and asked(loop.node._clear)[0]
    assert loop.run(84, angle=0.1) != SAFE


def test_a_bridge_replaces_the_plant_and_who_is_gone_does_not_count(loop: Loop) -> None:
    tell_rig(loop, "plant", "shin2022_as_printed")
    tell_rig(loop, "bridge", "shin2022")
    assert loop.node._rigs.present == "" and "plant" not in loop.health("rig").values
    tell_rig(loop, "estimator", "sealed_joint")
    assert "estimator" in loop.node._rigs.present
    assert asked(loop.node._clear)[0]  # nobody of that name is there any more
    assert loop.node._rigs.present == ""


def test_what_is_no_rig_is_passed_over(loop: Loop) -> None:
    from std_msgs.msg import String

    for text in ("", "shin2022", "{}", '{"node": "estimator"}'):
        loop.node._rigs._on_rig(String(data=text))
    tell_rig(loop, "controller", "sealed_joint")  # its own name: an earlier life's
    assert loop.node._rigs.present == "" and not loop.node.stopped
    assert loop.health("rig").message == "no other node has published its rig yet"


def test_a_stiffness_takes_the_law_through_the_model_and_says_so(loop: Loop) -> None:
    loop.refer(2, 0.1, 6.0)
    assert loop.run() == SAFE
    assert "law: pi does not have: set law to model" in loop.health("reference").message
    assert loop.choose(law="model") == (True, "")
    loop.refer(2, 0.1, 6.0)
    assert loop.run() == SAFE  # bumpless
    first, second = loop.run(398)
    assert first > 6.0 and second < 5.0
    commands = loop.health("commands")
    assert commands.level == 0 and commands.values["law"] == "model"
    assert loop.health("reference").values["mode"] == "angle_stiffness"
    good, why = loop.choose(law="pi")
    assert not good and "law: pi has no mode ANGLE_STIFFNESS" in why
    assert loop.choose(law="none")[0] is False


def test_a_change_of_the_law_makes_no_jump(loop: Loop) -> None:
    loop.refer(0, 0.1)
    before = loop.run(300)
    for law in ("model", "pi", "model"):
        assert loop.choose(law=law)[0]
        assert loop.run() == pytest.approx(before, abs=1e-9)
        after = loop.run(299)
        assert after != pytest.approx(before, abs=0.05)
        before = after


def test_modes_and_law_that_change_while_it_is_stopped_move_no_valve_and_count_once_it_is_cleared(loop: Loop) -> None:
    loop.choose(law="model")
    loop.refer(2, 0.1, 6.0)
    assert loop.run(50) != SAFE
    loop.node.stop("somebody said so")
    for mode, value, stiffness in ((2, 0.1, 6.0), (4, 0.0, 6.0), (3, 0.5, 6.0), (2, 0.1, -1.0)):
        loop.refer(mode, value, stiffness)
        assert loop.run() == SAFE
    loop.refer(0, -0.1)
    assert loop.choose(law="pi") == (True, "")
    assert loop.run() == SAFE
    assert asked(loop.node._clear)[0]
    assert loop.run() == SAFE  # bumpless
    first, second = loop.run(344)
    assert first < SAFE[0] - 0.01 and second > SAFE[1] + 0.01
    assert loop.health("reference").values["mode"] == "angle"


def test_a_reference_out_of_reach_becomes_the_nearest_one_and_that_is_said(loop: Loop) -> None:
    loop.choose(law="model")
    loop.refer(2, 0.1, 60.0)
    loop.run()
    health = loop.health("reference")
    assert health.level == 1 and "with 60 N m/rad is out of reach" in health.message
    assert 5.0 < float(health.values["stiffness asked for [N m/rad]"]) < 15.0


def test_the_governor_holds_a_reference_back_and_says_by_which_limit(loop: Loop) -> None:
    loop.choose(law="model")
    loop.refer(2, 0.43, 6.0)  # the set ends at 0.36 rad, and the limit is 0.436: the estimate's variance counts
    loop.run(40, angle=0.1, variance=4e-3)
    values = loop.health("commands").values
    assert values["governor"] == "holds the reference back: angle" and values["held back by the governor"] > 0
    loop.refer(2, 0.1, 6.0)
    loop.run(40, angle=0.1, variance=4e-3)
    assert loop.health("commands").values["governor"] == "lets the reference through"


def test_a_finding_of_the_monitor_stops_the_controller_if_stop_on_names_it(controller: Callable[..., Loop]) -> None:
    from pam_antagonist.errors import BadInput
    from pam_antagonist.nodes.controller import stops_on
    from pam_antagonist_msgs.msg import Health

    loop = controller(stop_on=["leak", "slack"])
    loop.refer(0, 0.1)
    for k in range(20):
        loop.run(angle=0.002 * k)
    assert loop.voltages[-1] != SAFE
    loop.node._heard_of(Health(name="thermal"))
    assert not loop.node.stopped
    loop.node._heard_of(Health(name="leak", muscle=1, sentence="air leaks from muscle 1"))
    assert loop.run() == SAFE
    assert "air leaks from muscle 1" in loop.node.stopped and loop.health("commands").level == 2
    with pytest.raises(BadInput, match="no effect is called 'leek'"):
        stops_on(["leek"])
    assert stops_on([""]) == frozenset()


def another(loop: Loop, topic: str, count: int) -> Any:
    """Another node that publishes one of the topics, which is known when this returns."""
    import time

    from rclpy.node import Node

    from pam_antagonist.nodes import qos
    from pam_antagonist_msgs.msg import JointEstimate

    other = Node("second_estimator", namespace="/pam")
    for _ in range(count):
        other.create_publisher(JointEstimate, topic, qos.STREAM)
    end = time.monotonic() + 10.0
    while loop.node.count_publishers(f"/pam/{topic}") < count and time.monotonic() < end:
        time.sleep(0.01)
    return other


def test_a_second_estimator_is_named_and_stops_the_joint_and_no_sample_is_answered_twice(loop: Loop) -> None:
    loop.refer(0, 0.3)
    assert loop.run(5, angle=0.1) != SAFE
    loop.now -= MS
    before = len(loop.commands)
    loop.run(angle=0.2)  # the same sample again, of one publisher
    loop.node._watch()
    assert len(loop.commands) == before and not loop.node.stopped
    other = another(loop, "joint_estimate", 2)
    try:
        assert loop.run(3, angle=0.1) != SAFE
        assert "2 nodes publish /pam/joint_estimate" in loop.health("commands").message, "before it sends"
        for _ in range(3):
            loop.run(angle=0.1)
            loop.now -= MS
            loop.run(angle=0.12)
        loop.node._watch()
        assert loop.run(angle=0.1) == SAFE
        health = loop.health("commands")
        assert health.level == 2 and "/pam/second_estimator" in health.message
        assert "stopped: 2 nodes publish /pam/joint_estimate" in health.message
        assert health.values["estimates not newer than the last"] == 4
        good, why = asked(loop.node._clear)
        assert not good and "the cause is still present: 2 nodes publish" in why
    finally:
        other.destroy_node()
    loop.node._estimators.look(loop.node._estimators._until_ns + 1)  # none is repeated for a second
    assert asked(loop.node._clear)[0]
    assert loop.run(84, angle=0.1) != SAFE


def test_a_controller_without_estimates_says_whether_anybody_publishes_them(loop: Loop) -> None:
    assert loop.health("commands").message == "no estimate has come yet: nobody publishes /pam/joint_estimate"
    other = another(loop, "joint_estimate", 1)
    try:
        assert loop.health("commands").message.endswith(
            "no message of /pam/joint_estimate comes, though there is a publisher"
        )
    finally:
        other.destroy_node()


def test_an_angle_without_a_stiffness_is_followed_without_a_word(loop: Loop) -> None:
    """A message holds 0 where nobody has written a stiffness."""
    assert loop.choose(law="model")[0]
    for mode in (0, 1):
        for stiffness in (0.0, 6.0, math.inf):
            loop.refer(mode, 0.2, stiffness)
            loop.run(3, angle=0.1)
            assert loop.health("reference").message == "followed" and not loop.references.limited_count
            assert math.isnan(loop.references.stiffness)
