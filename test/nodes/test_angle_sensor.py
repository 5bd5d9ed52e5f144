"""Plant and estimator as processes, with an encoder and with pushes; what the replay of the bag says then."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from pam_antagonist.nodes.processes import Processes, ros_arguments
from pam_antagonist.recording import read_bag
from pam_antagonist.replays import replay
from pam_antagonist.rig import load_rig

pytestmark = [pytest.mark.ros, pytest.mark.realtime]


def test_live_and_replay_agree_bit_by_bit_with_an_encoder(tmp_path: Path, module_domain: None) -> None:
    from pam_antagonist.nodes.client import ReferenceClient

    given = {"rig": "shin2022_external_torque", "angle_sensor": "encoder"}
    with Processes(tmp_path) as processes, ReferenceClient() as client:
        processes.start("record", ["--out", str(tmp_path / "bag")])
        processes.start("estimator", ros_arguments(given, {}))
        # Commands never come: the valves keep their safe voltages, and only the pushes move the joint.
        plant = {**given, "mismatch": 0.01, "seed": 3, "wait_for_subscribers": 2}
        processes.start("plant", ros_arguments(plant, {}))
        heard = ("joint_estimate", "measured_joint_states")
        processes.wait(lambda: "" if all(map(client.latest, heard)) and client.may_push() else "nobody to push")
        for torque in (0.0, 0.8, 0.0):
            client.push(torque)
            time.sleep(0.8)
        processes.stop("plant")
        time.sleep(0.3)
        processes.stop("estimator", "record")
    recording = read_bag(tmp_path / "bag")
    assert recording.angle_sensor is not None and recording.external_torque is not None
    done = replay(recording, load_rig(given["rig"]))
    live, external = done.report.live_equal, done.report.ukf.external_torque
    assert live is not None and live.equal == live.compared > 2000
    assert done.report.estimator.counts.angles_used > 2000
    assert external is not None and external.rmse < 0.15 and external.delay_s is not None
    assert external.coverage95 is not None and external.coverage95 > 0.9
    assert 0.0 <= external.delay_s <= 0.05
