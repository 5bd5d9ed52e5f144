"""``demo``: a sensor-less closed loop, live, recorded, replayed and judged."""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from pam_antagonist.cli import common
from pam_antagonist.cli.numbers import SEED, real
from pam_antagonist.cli.progress import counted
from pam_antagonist.control import FAST_GAINS, PUBLISHED_GAINS, Mode
from pam_antagonist.errors import BadInput
from pam_antagonist.model.effects import DISTURBANCE
from pam_antagonist.nodes.processes import Processes, ProcessFailed, free_domain, ros_arguments
from pam_antagonist.optional import needs_ros
from pam_antagonist.rig import Rig, load_rig

if TYPE_CHECKING:
    from pam_antagonist.nodes.client import ReferenceClient

_DESCRIPTION = """\
Run a sensor-less closed loop live and judge it.

Starts a simulated joint, the estimator and the controller as three processes at the rig's sample rate (1 kHz), and a
recorder. The reference of the joint's angle steps to ±20° and back, or that of its torque to ±2 N m with the joint
locked at 0°. With --mode stiffness the controller's law goes through the model: angle and stiffness step together, in
smaller steps, for 30 s. With --mode impedance somebody pushes the joint by up to 1 N m, which yields as a spring and
damper; it knows the torque by its estimate alone, for 30 s. Everything is recorded into a rosbag2 bag (MCAP), which is
then replayed through the estimator. The results are printed as tables and written to DIR/report.html and
DIR/report.json.

The simulated joint differs a little from the rig file (--mismatch), as a real one does. It is a simulator all the
same: only a recording of a real joint shows how well a real joint does (see replay).

Status: 0 done, 2 bad input (one line says what and where), 130 interrupted (the bag up to then is kept), 1 failed.
"""
_EXAMPLES = """\
examples:
  {run} demo
  {run} demo --mode torque --duration 20 --out torque_demo
  {run} demo --mode stiffness
  {run} demo --mode impedance
  {run} demo --rig shin2022_regulators --no-pressures
"""

_SHARES = (1.0, 0.0, -1.0, 0.0, 0.5, -0.5, 0.0)  # of the largest reference, one a step; a short demo takes the extremes
_STIFFNESS = (
    6.0,
    7.0,
    6.5,
    5.0,
    9.0,
    4.0,
    8.0,
)  # by turns; within reach of the paper's joint [N m/rad]
_SOFT, _DAMPING = (6.0, 4.0, 8.0), 0.5  # of the spring that yields, one after the other [N m/rad], [N m s/rad]
_PUSHES, _PUSH = (1.0, 0.0, -1.0, 0.0, 0.6, 0.0, -0.6, 0.0), 2.5  # by turns [N m]; each as long [s]
_MODES = {
    "angle": Mode.ANGLE, "torque": Mode.TORQUE, "stiffness": Mode.ANGLE_STIFFNESS, "impedance": Mode.IMPEDANCE,
}  # fmt: skip
_RIGS = {Mode.IMPEDANCE: "shin2022_external_torque"}
"""Rigs of modes for which shin2022 will not do: the torque from outside has to be estimated."""
_LARGEST = {Mode.ANGLE: math.radians(20.0), Mode.TORQUE: 2.0}  # as in the paper [rad], [N m]
_STEP = 2.75  # length of a step, about [s]; the slowest settles in 2.1 s
_REST = 1.0  # at the reference 0 before the first step [s]
_GAINS = {"fast": FAST_GAINS, "published": PUBLISHED_GAINS}
_DRAIN = 0.3  # from the last sample to the end of those who wait for it [s]
_LOOP = 0.05  # [s]
_PATIENCE = 8.0  # longer starts than this one are told why they are long [s]


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("demo", _DESCRIPTION, _EXAMPLES)
    add = out.add_argument
    add(
        "--duration",
        type=real(1.0, 3600.0, "seconds"),
        metavar="S",
        help="length of the experiment [s] (default: 12, stiffness and impedance 30)",
    )
    add("--mode", choices=tuple(_MODES), default="angle", help="what is controlled (default: angle)")
    gains_help = (
        "gains of the PI: fast (default), or paper, with which a step of the angle takes 9 s; modes stiffness and "
        "impedance use another law"
    )
    add("--gains", choices=tuple(_GAINS), default="fast", help=gains_help)
    rig_help = (
        "a YAML file, or the name of a rig that comes with the package (default: shin2022; for impedance "
        "shin2022_external_torque)"
    )
    add("--rig", metavar="RIG", help=rig_help)
    add(
        "--no-pressures", action="store_true",
        help="without pressure sensors: the filter uses the pressures that the regulators are commanded to hold; for "
        "a rig with drive: regulator",
    )  # fmt: skip
    add("--tuning", default="default", metavar="NAME", help="filter tuning of the rig (default: default)")
    add("--seed", type=SEED, default=0, metavar="N", help="seed of the joint's mismatch and sensor noise (default: 0)")
    mismatch_help = "relative standard deviation of the joint's parameters from the rig's (default: 0.01)"
    add("--mismatch", type=real(0.0, 0.29), default=0.01, metavar="X", help=mismatch_help)
    out_help = "folder for bag, logs and report; a new one (default: demo-DATE-TIME)"
    add("--out", type=Path, metavar="DIR", help=out_help)
    add("--no-figures", action="store_true", help="leave the figures out of report.html")
    common.add_open(out)
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    return common.run(parser, _main, argv)


def references(mode: Mode, duration: float, largest_angle: float = math.inf) -> list[tuple[float, float, float]]:
    """The steps of the reference: time [s], value [rad] or [N m], and stiffness [N m/rad], NaN where none is asked for.

    A joint that yields is asked for one angle all the time, with one stiffness after the other.

    Args:
        mode: what is controlled.
        duration: of the experiment [s].
        largest_angle: what the joint can reach [rad]; larger steps are scaled down to four fifths of it.
    """
    if mode is Mode.IMPEDANCE:
        return [(k * duration / len(_SOFT), 0.0, stiffness) for k, stiffness in enumerate(_SOFT)]
    rest = min(_REST, 0.1 * duration)
    count = max(2, round((duration - rest) / _STEP))
    length = (duration - rest) / count
    shares = _SHARES if count > 2 else (1.0, -1.0)
    largest = _LARGEST[mode.quantity] if mode is not Mode.ANGLE_STIFFNESS else 0.5 * _LARGEST[Mode.ANGLE]
    if mode.quantity is Mode.ANGLE:
        largest = min(largest, 0.8 * largest_angle)

    def stiffness(k: int) -> float:
        return _STIFFNESS[k % len(_STIFFNESS)] if mode.has_stiffness else math.nan

    steps = ((rest + k * length, largest * shares[k % len(shares)], stiffness(k + 1)) for k in range(count))
    return [(0.0, 0.0, stiffness(0)), *steps]


def pushes(mode: Mode, duration: float) -> list[tuple[float, float]]:
    """When somebody pushes the joint [s], and by how much from then on [N m].

    Args:
        mode: what is controlled; nobody pushes but where the joint is to yield.
        duration: of the experiment [s].
    """
    if mode is not Mode.IMPEDANCE:
        return []
    count = math.ceil((duration - _REST) / _PUSH)
    return [(0.0, 0.0), *((_REST + k * _PUSH, _PUSHES[k % len(_PUSHES)]) for k in range(count))]


def _main(arguments: argparse.Namespace) -> int:
    needs_ros("demo")
    common.only_available_figures(arguments)
    mode = _MODES[arguments.mode]
    arguments.rig = arguments.rig or _RIGS.get(mode, "shin2022")
    rig = load_rig(arguments.rig, regulators=True)
    rig.tuning(arguments.tuning)
    if arguments.no_pressures and rig.drive == "valve":
        raise BadInput(
            f"--no-pressures: rig {rig.name} has valves; expected a rig with pressure regulators, such as --rig "
            "shin2022_regulators"
        )
    if mode is Mode.IMPEDANCE and DISTURBANCE not in rig.effects:
        raise BadInput(
            f"--mode impedance: rig {rig.name} does not have the state {DISTURBANCE}; leave --rig out, or see "
            "docs/interaction.md for what to write into its file"
        )
    out: Path = arguments.out or Path(datetime.now().strftime("demo-%Y%m%d-%H%M%S"))
    common.check_output(out)
    try:
        (out / "logs").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"{out}: cannot be made: {error.strerror}") from None
    if arguments.duration is None:
        arguments.duration = 30.0 if mode.has_stiffness else 12.0
    try:
        _experiment(arguments, rig, mode, out)
    except ProcessFailed as error:
        print(f"error: {error} (logs: {out / 'logs'})", file=sys.stderr)
        return common.FAILED
    except KeyboardInterrupt:
        print(f"\ninterrupted: what was recorded until now is in {out / 'bag'}", file=sys.stderr)
        return common.INTERRUPTED
    try:
        _judge(out, rig, mode, arguments)
    except KeyboardInterrupt:
        print(f"\ninterrupted: the recording is in {out / 'bag'}, there is no report", file=sys.stderr)
        return common.INTERRUPTED
    return common.DONE


def _judge(out: Path, rig: Rig, mode: Mode, arguments: argparse.Namespace) -> None:
    """Replay OUT/bag, print the tables, write OUT/report.html and OUT/report.json.

    Raises:
        BadInput: the recording cannot be used.
    """
    from pam_antagonist.recording import read_bag
    from pam_antagonist.replays import replay
    from pam_antagonist.report import demo, terminal

    begin = time.perf_counter()
    recording = read_bag(out / "bag")
    read_seconds = time.perf_counter() - begin
    joint, lock_angle = ("free", None) if mode.quantity is Mode.ANGLE else ("locked", 0.0)
    with counted(len(recording.stamp_ns), "replay") as advance:
        done = replay(recording, rig, arguments.tuning, joint, lock_angle, read_seconds, progress=advance)
    gains = "model" if mode.has_stiffness or rig.drive == "regulator" else arguments.gains
    judged = demo.Demo.of(done, mode, demo.Simulated(arguments.mismatch, arguments.seed), gains)
    print(f"\n{terminal.render(demo.summary(judged))}\n")
    demo.write_report(out, judged, with_figures=not arguments.no_figures)
    print(f"recording: {out / 'bag'}")
    common.announce_report(arguments, out)
    print(common.next_command("replay", [out / "bag"], f"--rig {arguments.rig} --out DIR"))


def _experiment(arguments: argparse.Namespace, rig: Rig, mode: Mode, out: Path) -> None:
    """Run the processes and step the reference."""
    # A domain of its own keeps two demos, or a demo and a rig, from hearing each other.
    if "ROS_DOMAIN_ID" not in os.environ:
        os.environ["ROS_DOMAIN_ID"] = str(free_domain())
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    name = str(Path(arguments.rig).resolve()) if arguments.rig.endswith((".yaml", ".yml")) else arguments.rig
    shared: dict[str, object] = {"rig": name}
    if arguments.no_pressures:
        shared["pressure_sensors"] = "none"
    joint: dict[str, object] = (
        {"joint": "free"} if mode.quantity is Mode.ANGLE else {"joint": "locked", "lock_angle": 0.0}
    )
    with Processes(out / "logs") as processes:
        processes.start("estimator", ros_arguments({**shared, **joint, "tuning": arguments.tuning}, {}))
        processes.start("controller", ros_arguments({**shared, **_gains(arguments.gains, mode, rig)}, {}))
        simulated = {"seed": arguments.seed, "mismatch": arguments.mismatch, "wait_for_subscribers": 2}
        if arguments.no_pressures:
            # The controller listens to what is left as well.
            simulated["wait_for_subscribers"] = 3
        processes.start("plant", ros_arguments({**shared, **joint, **simulated}, {}))
        try:
            steps = references(mode, arguments.duration, rig.joint.stop or math.inf)
            _steps(processes, mode, steps, pushes(mode, arguments.duration), arguments.duration, out / "bag", rig.drive)
        finally:
            # From the source to the sink, so that every sample that was sent is estimated, commanded and recorded.
            processes.stop("plant")
            time.sleep(_DRAIN)
            processes.stop(*(name for name in ("controller", "estimator", "record") if name in processes.running))


def _gains(name: str, mode: Mode, rig: Rig) -> dict[str, object]:
    """Parameters of the controller."""
    if mode.has_stiffness or rig.drive == "regulator":
        return {"law": "model"}
    gains, of = _GAINS[name][mode], mode.name.lower()
    return {f"{of}_proportional": gains.proportional, f"{of}_integral": gains.integral}


def _steps(
    processes: Processes,
    mode: Mode,
    steps: list[tuple[float, float, float]],
    pushed: list[tuple[float, float]],
    duration: float,
    bag: Path,
    drive: str,
) -> None:
    from tqdm import tqdm

    # ROS is imported while the nodes are starting.
    from pam_antagonist.nodes.client import ReferenceClient

    with ReferenceClient(drive=drive) as watch:
        begin = time.monotonic()

        def missing() -> str:
            if "record" not in processes.running:
                if not watch.listeners:
                    return "the controller does not subscribe to the reference"
                # The plant waits for the recorder. So the recording does not begin while a node compiles.
                processes.start("record", ["--out", str(bag)])
            return watch.missing() or (
                "" if not pushed or watch.may_push() else "the simulated joint does not take a push"
            )

        processes.wait(_patient(missing))
        took = f"plant, estimator and controller are running after {time.monotonic() - begin:.1f} s"
        print(f"{took}; recording {duration:g} s", flush=True)
        look = "{percentage:3.0f} %|{bar:20}| {n:.1f}/{total:g} s{postfix}"
        with tqdm(total=duration, bar_format=look, disable=None) as bar:
            start, shown = time.monotonic(), -1
            while (elapsed := time.monotonic() - start) < duration:
                processes.check()
                index = max(k for k, (at, _, _) in enumerate(steps) if at <= elapsed)
                watch.send(mode, *steps[index][1:], damping=_DAMPING if mode is Mode.IMPEDANCE else math.nan)
                while pushed and pushed[0][0] <= elapsed:
                    watch.push(pushed.pop(0)[1])
                bar.n = elapsed
                bar.set_postfix_str(_seen(watch, mode, steps[index][1]), refresh=True)
                if bar.disable and index != shown and shown >= 0:
                    # What the last reference came to, not what the new one begins with.
                    print(f"  {elapsed:5.1f} s: {_seen(watch, mode, steps[shown][1])}", flush=True)
                shown = index
                time.sleep(_LOOP)
            if bar.disable:
                print(f"  {duration:5.1f} s: {_seen(watch, mode, steps[shown][1])}", flush=True)
            bar.n = duration
            bar.refresh()


def _patient(missing: Callable[[], str]) -> Callable[[], str]:
    """The same question, which says once why the answer takes long."""
    begin, said = time.monotonic(), False

    def asked() -> str:
        nonlocal said
        what = missing()
        if what and not said and time.monotonic() - begin > _PATIENCE:
            print("still starting: at the first start the nodes are compiled, once (about a minute)", flush=True)
            said = True
        return what

    return asked


def _seen(watch: ReferenceClient, mode: Mode, reference: float) -> str:
    """Reference, estimate and measurement now."""
    estimate, measured = watch.read(mode)
    if mode.quantity is Mode.ANGLE:
        return "reference {:+5.1f}°  estimate {:+6.2f}°  measured {:+6.2f}°".format(
            *(math.degrees(value) for value in (reference, estimate, measured))
        )
    return f"reference {reference:+4.1f} N m  estimate {estimate:+6.3f} N m  measured {measured:+6.3f} N m"
