"""Run a sensor-less closed loop live and judge it.

Starts a simulated joint, the estimator and the controller as three processes at the rig's sample rate (1 kHz), and a
recorder. The reference of the joint's angle steps to both sides and back, by four fifths of the joint's range (20° of
shin2022), or that of its torque by five eighths of the largest (2 N m) with the joint locked at 0°. With --mode
stiffness the controller's law goes through the model: angle and stiffness step together, in smaller steps, for 30 s.
With --mode impedance somebody pushes the joint, which yields as a spring and damper; it knows the torque by its
estimate alone, for 30 s. Everything is recorded into a rosbag2 bag (MCAP), which is then replayed through the
estimator. The results are printed as tables and written to DIR/report.html and DIR/report.json. Limits are those of
the rig file. A stop for safety ends the demo, and its reason is the first line of what is printed and written.

The simulated joint differs a little from the rig file (--mismatch), as a real one does. It is a simulator all the
same: only a recording of a real joint shows how well a real joint does (see replay).

Status: 0 done, 2 bad input (one line says what and where), 130 interrupted (the bag up to then is kept), 1 failed, or
stopped for safety.

examples:
  {run} demo
  {run} demo --mode torque --duration 20 --out torque_demo
  {run} demo --mode stiffness
  {run} demo --mode impedance
  {run} demo --rig shin2022_regulators --no-pressures
  {run} demo --rig commissioned/rig.yaml --gains commissioned/parameters.yaml
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pam_antagonist.cli import common
from pam_antagonist.cli.common import real
from pam_antagonist.cli.driving import how_to_watch, stay_apart
from pam_antagonist.cli.progress import counted
from pam_antagonist.control.command import Mode
from pam_antagonist.control.laws import Reachable
from pam_antagonist.control.pi import FAST_GAINS, PUBLISHED_GAINS
from pam_antagonist.control.stiffness import Box
from pam_antagonist.errors import BadInput
from pam_antagonist.model.effects import DISTURBANCE
from pam_antagonist.nodes.processes import Processes, ProcessFailed, ros_arguments
from pam_antagonist.optional import needs_ros
from pam_antagonist.program import INTERRUPTED
from pam_antagonist.rig import Rig, RigIdentity, differences, load_rig
from pam_antagonist.rig.physical import angle_range, largest_torque
from pam_antagonist.strict_yaml import read_mapping

if TYPE_CHECKING:
    from pam_antagonist.nodes.client import ReferenceClient

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

_MODES = {
    "angle": Mode.ANGLE, "torque": Mode.TORQUE, "stiffness": Mode.ANGLE_STIFFNESS, "impedance": Mode.IMPEDANCE,
}  # fmt: skip
_RIGS = {Mode.IMPEDANCE: "shin2022_external_torque"}
"""Rigs of modes for which shin2022 will not do: the torque from outside has to be estimated."""
_DRAIN = 0.3  # from the last sample to the end of those who wait for it [s]
_LOOP = 0.05  # [s]
_PATIENCE = 8.0  # longer starts than this one are told why they are long [s]
_SWEEP = 0.25  # in which the reference passes half of the range: quick regulators overshoot a step [s]
_AFTER_STOP = 0.5  # for so long a demo goes on that was stopped for safety [s]


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("demo", __doc__)
    length = "length of the experiment [s] (default: 12, stiffness and impedance 30)"
    out.option("--duration", length, real(1.0, 3600.0, "seconds"), metavar="S")
    out.option("--mode", "what is controlled (default: angle)", default="angle", choices=tuple(_MODES))
    out.option(
        "--gains", "gains of the PI for shin2022: fast, or published, with which a step of the angle takes 9 s; or "
        "model, the law through the model; or a YAML file with the controller's parameters, such as parameters.yaml of "
        "commission (default: fast for shin2022; model for other joints and in modes stiffness and impedance)",
        metavar="{fast,published,model,FILE}",
    )  # fmt: skip
    out.option(
        "--rig", "a YAML file, or the name of a rig that comes with the package (default: shin2022; for impedance "
        "shin2022_external_torque)", metavar="RIG",
    )  # fmt: skip
    out.flag(
        "--no-pressures", "without pressure sensors: the filter uses the pressures that the regulators are commanded "
        "to hold; for a rig with drive: regulator",
    )  # fmt: skip
    out.option("--tuning", "filter tuning of the rig (default: default)", None, "default", "NAME")
    out.shared("--seed", help="seed of the joint's mismatch and sensor noise (default: 0)", metavar="N")
    mismatch = "relative standard deviation of the joint's parameters from the rig's (default: 0.01)"
    out.shared("--mismatch", help=mismatch, type=real(0.0, 0.29))
    out.option("--out", "folder for bag, logs and report; a new one (default: demo-DATE-TIME)", Path, metavar="DIR")
    out.shared("--no-figures", help="leave the figures out of report.html")
    out.shared("--open")
    return out


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
            "docs/explanation/control.md for what to write into its file"
        )
    out: Path = arguments.out or Path(datetime.now().strftime("demo-%Y%m%d-%H%M%S"))
    common.check_output(out)
    if arguments.duration is None:
        arguments.duration = 30.0 if mode.has_stiffness else 12.0
    found = found_gains(arguments.gains)
    law = law_of(rig, mode, arguments.gains) if not found else MODEL if found.get("law") == MODEL else FOUND
    asked = task(rig, mode, law, arguments.duration)
    try:
        (out / "logs").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"{out}: cannot be made: {error.strerror}") from None
    left = f"what was recorded until now is in {out / 'bag'}"
    try:
        stopped = _experiment(arguments, rig, mode, {**_gains(law, mode, rig), **found}, asked, out)
        left = f"the recording is in {out / 'bag'}, there is no report"
        _judge(out, rig, mode, law, stopped, arguments)
    except ProcessFailed as error:
        print(f"error: {error} (logs: {out / 'logs'})", file=sys.stderr)
        return common.FAILED
    except KeyboardInterrupt:
        print(f"\ninterrupted: {left}", file=sys.stderr)
        return INTERRUPTED
    return common.FAILED if stopped else common.DONE


def _judge(out: Path, rig: Rig, mode: Mode, law: str, stopped: str, arguments: argparse.Namespace) -> None:
    """Replay OUT/bag, print the tables, write OUT/report.html and OUT/report.json."""
    from pam_antagonist.recording import read_bag
    from pam_antagonist.replays import replay
    from pam_antagonist.report.demo import Demo

    begin = time.perf_counter()
    recording = read_bag(out / "bag")
    read_seconds = time.perf_counter() - begin
    joint, lock_angle = ("free", None) if mode.quantity is Mode.ANGLE else ("locked", 0.0)
    with counted(len(recording.stamp_ns), "replay") as advance:
        done = replay(recording, rig, arguments.tuning, joint, lock_angle, read_seconds, progress=advance)
    judged = Demo.of(done, mode, arguments.mismatch, arguments.seed, law, stopped)
    print(f"\n{judged.summary()}\n")
    judged.write(out, figures=not arguments.no_figures)
    print(f"recording: {out / 'bag'}")
    common.announce_report(arguments, out)
    print(common.next_command("replay", [out / "bag"], f"--rig {arguments.rig} --out DIR"))


def _experiment(
    arguments: argparse.Namespace, rig: Rig, mode: Mode, gains: dict[str, object], asked: Task, out: Path
) -> str:
    """Run the processes and step the reference; returns why the joint was stopped for safety, else nothing."""
    stay_apart()
    print(how_to_watch(), flush=True)
    name = str(Path(arguments.rig).resolve()) if arguments.rig.endswith((".yaml", ".yml")) else arguments.rig
    shared: dict[str, object] = {"rig": name}
    if arguments.no_pressures:
        shared["pressure_sensors"] = "none"
    joint = {"joint": "free" if mode.quantity is Mode.ANGLE else "locked"}
    with Processes(out / "logs") as processes:
        processes.start("estimator", ros_arguments({**shared, **joint, "tuning": arguments.tuning}, {}))
        processes.start("controller", ros_arguments({**shared, **gains}, {}))
        # Without pressures, the controller listens to what is left as well.
        waits = {"wait_for_subscribers": 3 if arguments.no_pressures else 2}
        simulated = {"seed": arguments.seed, "mismatch": arguments.mismatch, **waits}
        processes.start("plant", ros_arguments({**shared, **joint, **simulated}, {}))
        try:
            return _steps(processes, mode, asked, arguments.duration, out / "bag", rig.drive)
        finally:
            # From the source to the sink, so that every sample that was sent is estimated, commanded and recorded.
            processes.stop("plant")
            time.sleep(_DRAIN)
            processes.stop(*(name for name in ("controller", "estimator", "record") if name in processes.running))


def _gains(law: str, mode: Mode, rig: Rig) -> dict[str, object]:
    """Parameters of the controller."""
    if law in GAINS:
        gains, of = GAINS[law][mode], mode.name.lower()
        return {f"{of}_proportional": gains.proportional, f"{of}_integral": gains.integral}
    if law == FOUND or mode is Mode.IMPEDANCE:
        return {} if law == FOUND else {"law": "model"}
    # A new rig's estimate is very uncertain: with a margin for that, its joint would hardly move.
    return {"law": "model", "governor_level": 0.5, "max_angle_rate": angle_range(rig) / _SWEEP}


def _steps(processes: Processes, mode: Mode, asked: Task, duration: float, bag: Path, drive: str) -> str:
    """Step the reference; returns why the joint was stopped for safety, else nothing."""
    from tqdm import tqdm

    # ROS is imported while the nodes are starting.
    from pam_antagonist.nodes.client import ReferenceClient

    steps, pushed, stopped = asked.references, list(asked.pushes), ""
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
            start, shown, end = time.monotonic(), -1, duration
            while (elapsed := time.monotonic() - start) < end:
                processes.check()
                if not stopped and (stopped := processes.stopped()):
                    tqdm.write(f"stopped for safety after {elapsed:.1f} s: {stopped}", file=sys.stderr)
                    end = min(duration, elapsed + _AFTER_STOP)
                index = max(k for k, (at, _, _) in enumerate(steps) if at <= elapsed)
                watch.send(mode, *steps[index][1:], damping=asked.damping)
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
                print(f"  {end:5.1f} s: {_seen(watch, mode, steps[shown][1])}", flush=True)
            bar.n = end
            bar.refresh()
    return stopped or processes.stopped()


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


# ------------------------------------------------------------------ what is asked of the joint


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
    for node, block in read_mapping(path, "parameter", "parameters.yaml of commission").items():
        given = block.get("ros__parameters") if isinstance(block, dict) else None
        if node.split("/")[-1] == "controller" and isinstance(given, dict) and given:
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


main = common.command(parser, _main)
