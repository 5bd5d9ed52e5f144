"""What a demo asks of its joint: the law of control, steps within the rig's own range, and pushes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from pam_antagonist.control.command import Mode
from pam_antagonist.control.laws import Reachable
from pam_antagonist.control.pi import FAST_GAINS, PUBLISHED_GAINS
from pam_antagonist.control.stiffness import Box
from pam_antagonist.errors import BadInput
from pam_antagonist.rig import Rig, RigIdentity, differences, load_rig
from pam_antagonist.rig.physical import angle_range, largest_torque

GAINS = {"fast": FAST_GAINS, "published": PUBLISHED_GAINS}
"""Gains of the PI for the joint of the paper, by name."""
MODEL = "model"
"""The law through the model, whose gains do not depend on the joint."""
FOUND = "found"
"""The PI with gains that were found for the joint."""

_SHARES = (1.0, 0.0, -1.0, 0.0, 0.5, -0.5, 0.0)  # of the largest reference, one a step; a short demo takes the extremes
_STIFFNESS = (0.4, 0.5, 0.45, 0.3, 0.7, 0.2, 0.6)  # by turns, from the softest to the stiffest joint at that angle
_SOFT = (0.385, 0.155, 0.615)  # of the spring that yields, one after the other; likewise
_RELAXES = 1.0 / 12.0  # of the damper that yields, with the first of these springs [s]
_PUSHES, _PUSH = (1.0, 0.0, -1.0, 0.0, 0.6, 0.0, -0.6, 0.0), 2.5  # by turns, of the largest push; each as long [s]
_ANGLE, _ANGLE_STIFFNESS, _TORQUE, _PUSHED = 0.8, 0.4, 0.625, 0.3125
"""Largest references and pushes, as shares of the joint's range and of its largest torque: 20°, 10°, 2 N m and 1 N m of
the paper's joint, as in the paper."""
_REACHED = 0.97  # of what the law through the model reaches; the simulated joint differs a little from the rig file
_STEP = 2.75  # length of a step, about [s]; the slowest settles in 2.1 s
_REST = 1.0  # at the reference 0 before the first step [s]


class Task(NamedTuple):
    """What a demo asks of its joint."""

    # Time [s], value [rad] or [N m], and stiffness [N m/rad] of each step; NaN where none is asked for.
    references: list[tuple[float, float, float]]
    pushes: list[tuple[float, float]]  # time [s] and torque [N m] from then on
    damping: float  # [N m s/rad]; NaN where none is asked for


def found_gains(gains: str | None) -> dict[str, Any]:
    """Parameters of the controller in the file that ``--gains`` names; none for the name of a law."""
    if gains in (None, MODEL, *GAINS):
        return {}
    path = Path(str(gains))
    if path.suffix not in (".yaml", ".yml"):
        raise BadInput(f"--gains {gains}: expected {', '.join(GAINS)}, {MODEL}, or a YAML file as commission writes it")
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise BadInput(f"--gains {path}: cannot be read: {error}") from None
    blocks = content.items() if isinstance(content, dict) else ()
    for node, block in blocks:
        given = block.get("ros__parameters") if isinstance(block, dict) else None
        if str(node).split("/")[-1] == "controller" and isinstance(given, dict) and given:
            return given
    raise BadInput(f"--gains {path}: holds no parameters of the controller; expected what commission writes")


def law_of(rig: Rig, mode: Mode, gains: str | None) -> str:
    """The law: one of :data:`GAINS`, or :data:`MODEL`.

    `gains`: that were asked for; None: the fast ones for the joint that they were chosen for, else the other law.
    """
    if mode.has_stiffness or rig.drive == "regulator":
        if gains in GAINS:
            raise BadInput(
                f"--gains {gains}: they are of the PI, which knows neither stiffness nor regulators; leave it out"
            )
        return MODEL
    if gains is not None:
        return gains
    own = not differences(RigIdentity.of(load_rig("shin2022")), RigIdentity.of(rig))
    return "fast" if own else MODEL


def task(rig: Rig, mode: Mode, law: str, duration: float) -> Task:
    """Steps of the reference within the rig's range, and pushes where the joint is to yield.

    A joint that yields is asked for one angle all the time, with one stiffness after the other.

    `duration`: of the experiment [s].
    """
    reach = None
    if law == MODEL:
        p = rig.parameters()
        reach = Reachable(p, Box.of(p))
    if mode is Mode.IMPEDANCE:
        assert reach is not None  # the law through the model
        springs = [_stiffness(reach, 0.0, share) for share in _SOFT]
        steps = [(k * duration / len(springs), 0.0, spring) for k, spring in enumerate(springs)]
        return Task(steps, _pushes(rig, duration), springs[0] * _RELAXES)
    largest = _largest(rig, mode, reach)
    rest = min(_REST, 0.1 * duration)
    count = max(2, round((duration - rest) / _STEP))
    length = (duration - rest) / count
    shares = _SHARES if count > 2 else (1.0, -1.0)
    times = [0.0, *(rest + k * length for k in range(count))]
    values = [0.0, *(largest * shares[k % len(shares)] for k in range(count))]
    stiffness = [math.nan] * len(times)
    if mode.has_stiffness:
        assert reach is not None
        stiffness = [_stiffness(reach, value, _STIFFNESS[k % len(_STIFFNESS)]) for k, value in enumerate(values)]
    return Task(list(zip(times, values, stiffness, strict=True)), [], math.nan)


def _largest(rig: Rig, mode: Mode, reach: Reachable | None) -> float:
    """The largest reference [rad] or [N m]."""
    if mode.quantity is Mode.TORQUE:
        most, reached = _TORQUE * largest_torque(rig), (math.inf, math.inf) if reach is None else reach.torques(0.0)
    else:
        share = _ANGLE_STIFFNESS if mode.has_stiffness else _ANGLE
        most, reached = share * angle_range(rig), (math.inf, math.inf) if reach is None else reach.angles
    largest = min(most, _REACHED * min(map(abs, reached)))
    if not largest > 0.0:
        what = "torque" if mode.quantity is Mode.TORQUE else "angle"
        raise BadInput(f"rig {rig.name}: within its pressures the joint reaches no {what}; see reachable --rig")
    return float(f"{largest:.2g}") if mode.quantity is Mode.TORQUE else largest


def _stiffness(reach: Reachable, angle: float, share: float) -> float:
    """Stiffness [N m/rad] between the softest and the stiffest joint at an angle [rad]."""
    found = reach.at_angle(angle)
    return float(f"{found.softest + share * (found.stiffest - found.softest):.2g}")


def _pushes(rig: Rig, duration: float) -> list[tuple[float, float]]:
    """When somebody pushes the joint [s], and by how much from then on [N m]."""
    largest, count = float(f"{_PUSHED * largest_torque(rig):.2g}"), math.ceil((duration - _REST) / _PUSH)
    return [(0.0, 0.0), *((_REST + k * _PUSH, largest * _PUSHES[k % len(_PUSHES)]) for k in range(count))]
