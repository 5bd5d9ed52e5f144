"""The pipeline at its fullest, beside one that passes the same messages through.

It has the torque from outside as a state of the filter, the law through the model, and the governor at work.
"""

from __future__ import annotations

import contextlib
import math
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from pam_antagonist.control.command import Mode
from pam_antagonist.errors import BadInput
from pam_antagonist.model.effects import DISTURBANCE
from pam_antagonist.nodes.processes import Processes, ProcessFailed, ros_arguments
from pam_antagonist.replays.accounting import STAGES
from pam_antagonist.rig import Rig
from pam_antagonist.rig.write import write_rig
from validation.benchmark.figure import Figure, at_most
from validation.benchmark.pipeline import run, start_passthrough

ROUND_TRIP = 1.3
"""What the round trip may be of that of messages that are passed through."""
_PUSHED = {"noise": 0.1, "prior": 0.5, "onset": 5.5}
"""What a rig without that state is given: see config/rigs/shin2022_external_torque.yaml."""
_REFERENCES = ((math.radians(18.0), 6.0), (math.radians(-18.0), 7.0))
"""Sent by turns, twice a second [rad], [N m/rad]: too far apart for the limits below to let the joint get there, so
that the governor predicts at each sample."""
_LIMITS = {"governor_push": 0.1, "max_velocity": 0.5, "max_contraction": 0.06, "max_extension": 0.06}


def measure(rig: Rig, duration: float) -> list[Figure]:
    """Run both pipelines for the same time, one after the other, each with the recorder.

    Args:
        rig: of the joint; the torque from outside becomes a state of it where it is none.
        duration: of each [s].

    Raises:
        BadInput: ROS 2 is missing, or a node does not start.
    """
    period = rig.sample_period
    with tempfile.TemporaryDirectory(prefix="pam_interaction_") as name:
        path = Path(name) / "rig.yaml"
        write_rig(rig.replaced(effects={DISTURBANCE: _PUSHED} | dict(rig.effects)), path)
        try:
            empty = run(start_passthrough(period), duration, period)
            real = run(_start(str(path)), duration, period, _references)
        except ProcessFailed as error:
            raise BadInput(f"interaction: {error}") from None
    latency, through = real.account.latency, empty.account.latency
    return [
        at_most(
            "interaction_round_trip",
            "median time pressure → command with the torque from outside, the law through the model and the governor, "
            "against that of a pipeline that passes ordinary message objects through",
            latency.median / through.median,
            ROUND_TRIP,
            "×",
            {
                "pipeline_ms": latency.median,
                "passthrough_ms": through.median,
                "pipeline_p99_ms": latency.p99,
                "passthrough_p99_ms": through.p99,
            },
        ),
        at_most(
            "interaction_lost",
            f"messages missing between discovery and the end, over all stages, of {real.account.expected} samples",
            float(sum(real.account.lost.values())),
            0.0,
            "",
            {**{stage: float(real.account.lost[stage]) for stage in STAGES}, "late": float(real.account.late)},
        ),
    ]


def _start(rig: str) -> Callable[[Processes], None]:
    def start(processes: Processes) -> None:
        shared: dict[str, object] = {"rig": rig}
        processes.start("estimator", ros_arguments(shared, {}))
        processes.start("controller", ros_arguments({**shared, "law": "model", **_LIMITS}, {}))
        processes.start("plant", ros_arguments({**shared, "mismatch": 0.01, "wait_for_subscribers": 2}, {}))

    return start


@contextlib.contextmanager
def _references() -> Iterator[Callable[[float], None]]:
    from pam_antagonist.nodes.client import ReferenceClient

    with ReferenceClient(listening=False) as client:

        def send(elapsed: float) -> None:
            client.send(Mode.ANGLE_STIFFNESS, *_REFERENCES[int(2.0 * elapsed) % len(_REFERENCES)])

        yield send
