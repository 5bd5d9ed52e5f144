"""A joint with pressure regulators, live: the same nodes, with pressures as commands; safety as for valves."""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pam_antagonist import read_bag, replay
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator
from pam_antagonist.hardware.calibration import Converter, load_calibration
from pam_antagonist.nodes.processes import Processes, ros_arguments
from pam_antagonist.replays.accounting import account
from pam_antagonist.rig import load_rig
from pam_antagonist.safety import SafeAction

pytestmark = pytest.mark.ros

RIG = load_rig("shin2022_regulators", regulators=True)
LOW, HIGH = RIG.command_limits
SAFE = 0.5 * (LOW + HIGH)
GOAL = math.radians(8.0)


@dataclass(frozen=True)
class Run:
    """Pressures asked for: of a joint that is held, without commands, of a command too high, after a stop."""

    bag: Path
    steered: np.ndarray
    silent: np.ndarray
    beyond: np.ndarray
    stopped: np.ndarray


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, module_domain: None) -> Run:
    """Some seconds at 1 kHz. Times are long, so that a busy machine does not make the commands late."""
    from probe import Probe

    from pam_antagonist_msgs.msg import PressureCommand

    folder = tmp_path_factory.mktemp("regulators")
    Estimator(RIG)  # compiles, or loads; the processes then find it
    rig = {"rig": "shin2022_regulators"}
    patient = {"command_timeout": 0.3, "max_command_age": 2.0, "missing_time": 0.5}
    with Processes(folder) as processes, Probe("pressure_state", "pressure_command") as probe:

        def asked(seconds: float) -> np.ndarray:
            probe.clear()
            probe.wait(seconds)
            return np.array([message.pressure for _, message in probe.seen["pressure_state"]])

        def command(pressure: float, seconds: float) -> np.ndarray:
            probe.clear()
            for _ in range(round(seconds / 0.02)):
                probe.publisher("pressure_command").publish(PressureCommand(pressure=[pressure, SAFE]))
                probe.wait(0.02)
            return np.array([message.pressure for _, message in probe.seen["pressure_state"]])

        processes.start("record", ["--out", str(folder / "bag")])
        processes.start("estimator", ros_arguments({**rig, "max_age": 0.5}, {}))
        processes.start("controller", ros_arguments({**rig, "law": "model", "max_age": 0.5}, {}))
        given = {**rig, **patient, "mismatch": 0.01, "seed": 3, "wait_for_subscribers": 2}
        processes.start("plant", ros_arguments(given, {}))
        probe.until(
            lambda: probe.matched("reference", 2) and len(probe.seen["pressure_command"]) > 200, 240.0, "a start"
        )
        probe.refer(0, 0.0)
        probe.wait(1.0)
        probe.refer(0, GOAL)
        probe.wait(3.0)
        steered = asked(0.2)
        processes.check()
        processes.stop("record")
        controller = processes.running["controller"].popen
        controller.send_signal(signal.SIGSTOP)
        probe.wait(0.8)
        silent = asked(0.2)
        controller.send_signal(signal.SIGCONT)
        processes.stop("controller")
        probe.until(lambda: probe.matched("pressure_command"), what="the plant listens to another commander")
        probe.wait(1.5)  # a commander that is silent for long loses its right
        beyond = command(9e5, 0.5)
        from std_srvs.srv import Trigger

        assert probe.call(Trigger, "plant/stop").success
        stopped = command(6e5, 0.3)
    return Run(folder / "bag", steered, silent, beyond, stopped)


@pytest.mark.realtime
def test_the_controller_asks_for_pressures_that_hold_the_angle(run: Run) -> None:
    assert np.all((run.steered >= LOW) & (run.steered <= HIGH))
    assert np.all(run.steered[:, 0] - run.steered[:, 1] > 30e3), "muscle 1 turns the joint to positive angles"
    recording = read_bag(run.bag)
    assert recording.drive == "regulator" and recording.angle is not None
    assert np.mean(recording.angle[-200:]) == pytest.approx(GOAL, abs=math.radians(1.5))
    slew = np.abs(np.diff(recording.voltage, axis=0)).max()
    assert slew <= 2e7 * 1.001e-3


@pytest.mark.realtime
def test_a_replay_gives_the_bits_of_the_live_estimate(run: Run) -> None:
    report = replay(run.bag, RIG).report
    assert report.live_equal is not None and report.live_equal.compared > 2000
    assert report.live_equal.equal == report.live_equal.compared
    assert report.ukf.angle is not None and report.ukf.angle.rmse < 1.0
    counted = account(read_bag(run.bag), RIG.sample_period)
    assert counted is not None and counted.expected > 2000 and set(counted.lost.values()) == {0}


@pytest.mark.realtime
def test_without_commands_beyond_the_range_and_stopped_the_regulators_are_asked_for_what_is_safe(run: Run) -> None:
    assert run.silent == pytest.approx(np.full_like(run.silent, SAFE))
    assert run.beyond[-1] == pytest.approx([HIGH, SAFE])
    assert run.stopped[-1] == pytest.approx([SAFE, SAFE])


@pytest.fixture
def nodes(ros: None) -> Iterator[list[Any]]:
    made: list[Any] = []
    yield made
    for node in made:
        node.close()
        node.destroy_node()


def test_the_paper_s_law_is_refused_with_what_to_set(nodes: list[Any]) -> None:
    from rclpy.parameter import Parameter

    from pam_antagonist.nodes.controller import ControllerNode

    def node(**values: Any) -> Any:
        return ControllerNode(parameter_overrides=[Parameter(name, value=value) for name, value in values.items()])

    with pytest.raises(BadInput, match="law: pi puts voltages on valves.*set law to model"):
        nodes.append(node(rig="shin2022_regulators"))
    with pytest.raises(BadInput, match="safe_pressure.*expected two pressures within 110000 to 700000 Pa"):
        nodes.append(node(rig="shin2022_regulators", law="model", safe_pressure=[5.5, 5.5]))


def test_valves_are_not_driven_without_measured_pressures(nodes: list[Any]) -> None:
    from rclpy.parameter import Parameter

    from pam_antagonist.nodes.controller import ControllerNode
    from pam_antagonist.nodes.estimator import EstimatorNode
    from pam_antagonist.nodes.plant import PlantNode

    given = [Parameter("pressure_sensors", value="none")]
    for kind in (PlantNode, EstimatorNode, ControllerNode):
        with pytest.raises(BadInput, match="rig shin2022 has valves, whose voltages do not determine the pressures"):
            nodes.append(kind(parameter_overrides=given))


def test_a_device_puts_out_voltages_that_ask_for_the_pressures() -> None:
    converter = Converter(load_calibration("example_regulators"))
    assert converter.output((401.3e3, 101.3e3)) == pytest.approx((5.0, 0.0))
    assert converter.asked((5.0, 0.0)) == pytest.approx((401.3e3, 101.3e3))
    safe = converter.action(SafeAction((401.3e3, 341.3e3), (101.3e3, 101.3e3), 30e3))
    assert safe.hold == pytest.approx((5.0, 4.0)) and safe.vent == pytest.approx((0.0, 0.0))
    assert safe.rate == pytest.approx(0.5)
    with pytest.raises(BadInput, match="calibration example has no regulators, but the rig has"):
        Converter(load_calibration("example")).adapt("regulator")
