"""Every fault of the matrix, how it is made, and what is expected of it.

A cause is a generator of the times [ns since 1970] at which its fault begins and is over.
"""

from __future__ import annotations

import resource
import threading
import time
from collections.abc import Callable, Iterator

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.processes import ProcessFailed
from pam_antagonist.recording import read_bag
from validation.faults.bench import RELAYED, Bench
from validation.faults.verdict import LIMIT_MS, Fault, Recovery, Valves, Wanted, first_obeyed, safe_since

Cause = Callable[[Bench], Iterator[int]]
_START = 30.0  # of one node [s]
_RECORDING = 1.5  # before the disk is full [s]


def at_device(order: str) -> Cause:
    """A fault of the device or its line: ``KIND`` or ``KIND=VALUE`` of ``validation.device.line_faults``."""

    def cause(bench: Bench) -> Iterator[int]:
        yield bench.order(f"+{order}")
        yield bench.order(f"-{order.partition('=')[0]}")

    return cause


def killed(node: str) -> Cause:
    """SIGKILL; started again at the end."""

    def cause(bench: Bench) -> Iterator[int]:
        yield bench.kill(node)
        now = time.time_ns()
        bench.start(node)
        yield now

    return cause


def stalled(node: str, seconds: float) -> Cause:
    """SIGSTOP and SIGCONT, as when a machine has other things to do."""

    def cause(bench: Bench) -> Iterator[int]:
        yield from bench.stall(node, seconds)

    return cause


def device_stalled(seconds: float) -> Cause:
    """The device stands still."""

    def cause(bench: Bench) -> Iterator[int]:
        begin = bench.order("+stall")
        time.sleep(max(0.0, seconds - (time.time_ns() - begin) * 1e-9))
        over = bench.order("-stall")
        yield begin
        yield over

    return cause


def messages(order: str, topics: tuple[str, ...]) -> Cause:
    """``drop=SHARE``, ``double`` or ``late=SECONDS`` happens to messages on their way."""

    def cause(bench: Bench) -> Iterator[int]:
        yield [bench.relay(f"+{order} {topic}") for topic in topics][0]
        yield [bench.relay(f"-{topic}") for topic in topics][0]

    return cause


def second_commander(voltage: tuple[float, float], seconds: float) -> Cause:
    """Somebody else publishes commands, 500 times a second."""

    def cause(bench: Bench) -> Iterator[int]:
        thread = threading.Thread(target=bench.intrude, args=(seconds, voltage))
        now = time.time_ns()
        thread.start()
        yield now
        thread.join()
        yield time.time_ns()

    return cause


def clock_set_back(seconds: float) -> Cause:
    """The nodes' time goes back, or ahead where that is negative; that stays so."""

    def cause(bench: Bench) -> Iterator[int]:
        yield bench.set_clock_back(seconds)
        yield time.time_ns()

    return cause


def disk_full(bench: Bench) -> Iterator[int]:
    """A recorder whose files may not grow any more; it ends by itself, and its bag can be read."""
    bag = bench.folder / "bag"
    bench.record(bag)
    bench.until(lambda: bench.latest("recorder: bag") is not None, _START, "a recorder")
    bench.wait(_RECORDING)
    size = max(file.stat().st_size for file in bag.iterdir())
    now = time.time_ns()
    # What a full disk is to a process: its writes fail.
    resource.prlimit(bench.processes.running["record"].popen.pid, resource.RLIMIT_FSIZE, (size, size))
    yield now
    process = bench.processes.running.pop("record")
    status = process.popen.wait(_START)
    now = time.time_ns()
    if status != 2:
        raise ProcessFailed(f"the recorder ended with status {status}: {process.last_words()}")
    try:
        bench.note = f"{len(read_bag(bag))} samples of the bag can be read"
    except BadInput as error:
        raise ProcessFailed(f"what was recorded cannot be read: {error}") from None
    yield now


def wrong_rig(node: str, changes: str, runs: bool = True) -> Cause:
    """A node is started again with the rig file of something else, and with its own at the end.

    `changes` is YAML that is laid over the pipeline's rig. `runs`: whether the node can run with it, and control comes
    back for a moment before somebody notices; the fault begins then.
    """

    def again(bench: Bench, more: dict[str, object] | None = None) -> None:
        bench.collect()  # what the old one said last is not the new one's
        before = len(bench.statuses)
        bench.start(node, more)
        if more is None or runs:
            said = lambda: any(s.part == f"{node}: lifecycle" for s in bench.statuses[before:])  # noqa: E731
            bench.until(said, _START, f"{node} again")

    def cause(bench: Bench) -> Iterator[int]:
        path = bench.folder / f"wrong_{node}.yaml"
        path.write_text(f"based_on: {bench.rig}\nname: something_else\n{changes}\n", encoding="utf-8")
        stopped = bench.kill(node)
        bench.wait(0.2)
        started = time.time_ns()
        again(bench, {"rig": str(path)})
        if runs:
            bench.wait(0.5)
            yield first_obeyed(bench.rows(), started) or stopped
            over = bench.kill(node)
        else:
            if bench.processes.running.pop(node).popen.wait(_START) != 2:
                raise ProcessFailed(f"{node} took a rig file that makes no sense")
            yield stopped
            over = time.time_ns()
            log = (bench.folder / f"{node}.log").read_text(errors="replace").splitlines()
            lines = [line for line in log if line.startswith("error:")]
            bench.note = lines[-1] if len(lines) == 1 else f"{len(lines)} lines of errors"
        again(bench)
        yield over

    return cause


def neighbour(bench: Bench) -> Iterator[int]:
    """Another pipeline in another namespace of the same domain, whose controller is killed; its valves become safe."""
    with bench.run_beside() as second:
        begin = second.kill("controller")
        yield begin
        now = time.time_ns()
        since = safe_since(second.rows(), begin, now)
        status = second.latest("bridge: commands")
    if since is None or status is None or status.level == 0:
        raise ProcessFailed("the pipeline beside it lost its controller, and its valves or diagnostics do not show it")
    milliseconds = (since.time_ns - begin) * 1e-6
    if milliseconds > LIMIT_MS:
        raise ProcessFailed(f"the valves of the pipeline beside it were safe after {milliseconds:.0f} ms only")
    bench.note = f"those of the other one are safe after {milliseconds:.0f} ms"
    yield now


_OK, _WARN, _ERROR = 0, 1, 2
_SAFE, _ON = Valves.SAFE, Valves.CONTROLLED
_RESTART, _CLEAR, _KEPT = Recovery.RESTART, Recovery.CLEAR, Recovery.NOT_LOST
_STALL = 0.05  # [s]
_NO_ESTIMATES = Wanted("controller: commands", _ERROR, "estimates have stopped")
_NO_COMMAND = Wanted("bridge: commands", _WARN, "no command in time")

FAULTS: tuple[Fault, ...] = (
    # ---- processes
    Fault("estimator killed", "SIGKILL", killed("estimator"), _SAFE, (_NO_ESTIMATES,), _RESTART),
    Fault("controller killed", "SIGKILL", killed("controller"), _SAFE, (_NO_COMMAND,), _RESTART),
    Fault("bridge killed", "SIGKILL", killed("bridge"), _SAFE, (_NO_ESTIMATES,), _RESTART),
    Fault("estimator stalls", "SIGSTOP for 50 ms", stalled("estimator", _STALL), _SAFE,
          (Wanted("controller: commands", _WARN, "safe voltages"),), lasts=0.0),
    Fault("controller stalls", "SIGSTOP for 50 ms", stalled("controller", _STALL), _SAFE, (_NO_COMMAND,), lasts=0.0),
    Fault("bridge stalls", "SIGSTOP for 50 ms", stalled("bridge", _STALL), _SAFE,
          (Wanted("bridge: device", _WARN, "watchdog trips"),), lasts=0.0),
    # ---- the device and its line
    Fault("device unplugged", "port closed for 0.6 s", at_device("unplug"), _SAFE,
          (Wanted("bridge: device", _ERROR, "no device"),), lasts=0.6),
    Fault("device silent", "sends nothing for 0.6 s", at_device("silent"), _SAFE,
          (Wanted("bridge: device", _ERROR, "no device: silent"),), lasts=0.6),
    Fault("device deaf", "hears nothing for 0.4 s", at_device("deaf"), _SAFE,
          (Wanted("bridge: device", _WARN, "watchdog trips"),)),
    Fault("device stalls", "stands still for 50 ms", device_stalled(_STALL), _ON,
          (Wanted("estimator: samples", _WARN, "late", counted=True),), lasts=0.0),
    Fault("device restarts", "begins anew, clock at 0", at_device("restart"), _SAFE,
          (Wanted("bridge: device", _ERROR, "devices lost", counted=True),), lasts=0.1),
    Fault("damaged frames", "1 % of the bytes, both ways, for 1 s", at_device("flip=0.01"), _ON,
          (Wanted("bridge: device", _WARN, "damaged frames"),), lasts=1.0),
    Fault("emergency stop", "pressed at the device", at_device("stop"), _SAFE,
          (Wanted("bridge: safety", _ERROR, "the emergency stop"),), _CLEAR, clear=("bridge",)),
    # ---- sensors
    Fault("pressure NaN", "sensor 1 for 0.4 s", at_device("nan=1"), _SAFE,
          (Wanted("bridge: safety", _ERROR, "pressure 1 is missing"),), _CLEAR, clear=("controller", "bridge")),
    Fault("pressure wire broken", "sensor 2 shows 0 V", at_device("broken=2"), _SAFE,
          (Wanted("bridge: safety", _ERROR, "pressure 2 is missing"),), _CLEAR, clear=("controller", "bridge")),
    Fault("pressure stuck", "sensor 2 repeats its reading", at_device("freeze=2"), _SAFE,
          (Wanted("bridge: safety", _ERROR, "pressure 2 is frozen"),), _CLEAR, clear=("controller", "bridge")),
    # ---- who commands, and with what
    Fault("second commander", "10 V and 0 V, 500 times a second", second_commander((10.0, 0.0), 0.8), _ON,
          (Wanted("bridge: commands", _ERROR, "commands refused"),), _KEPT),
    Fault("disk full", "the recorder's writes fail", disk_full, _ON,
          (Wanted("recorder: bag", _ERROR, "the recording has ended"),), _KEPT, lasts=0.2),
    Fault("rig file makes no sense", "estimator started with it",
          wrong_rig("estimator", "supply: {pressure: -1.0}", runs=False), _SAFE, (_NO_ESTIMATES,), _RESTART),
    # The pressures cannot show these: what the nodes tell about their files does.
    Fault("rig file of another joint", "estimator started with it: supply of 400 kPa",
          wrong_rig("estimator", "supply: {pressure: 400.0e+3}"), _SAFE,
          (Wanted("controller: commands", _ERROR, "the rig file of the estimator"),), _CLEAR, clear=("controller",)),
    Fault("rig file of other valves", "bridge started with it: inflow areas ten times as large",
          wrong_rig("bridge", "valve_1: {inflow_area: 5.184e-7}\nvalve_2: {inflow_area: 5.184e-7}"), _SAFE,
          (Wanted("controller: commands", _ERROR, "the rig file of the bridge"),), _CLEAR, clear=("controller",)),
    Fault("rig file with refined values", "estimator started with it: areas off by 10 %, a leak",
          wrong_rig("estimator", "valve_1: {inflow_area: 5.7e-8}\neffects: {leak: {area_1: 1.0e-10}}"), _ON,
          (Wanted("controller: rig", _OK, "the same joint; estimator with other values"),), _KEPT),
    Fault("rig file of another device", "bridge started with it: 250 Hz",
          wrong_rig("bridge", "sample_period: 0.004"), _SAFE,
          (Wanted("bridge: device", _ERROR, "samples every 1 ms"),
           Wanted("controller: rig", _ERROR, "sample_period 0.004 s rather than 0.001 s")), _CLEAR,
          clear=("controller",)),
    Fault("two pipelines", "another one in /left/elbow; its controller killed", neighbour, _ON, (), _KEPT),
    # ---- messages
    Fault("messages lost", "20 % of pressure 1, estimates and commands", messages("drop=0.2", RELAYED), _ON,
          (Wanted("estimator: samples", _WARN, "incomplete"),), lasts=1.0, bench="relayed"),
    Fault("messages twice", "all of the same", messages("double", RELAYED), _ON,
          # whichever of two pressures completes its sample first leaves the other one too late for it
          (Wanted("estimator: samples", _OK, "duplicate messages or messages too late for their sample", True),),
          _KEPT, lasts=1.0, bench="relayed"),
    Fault("pressure late", "pressure 1 by 100 ms", messages("late=0.1", ("pressure_1",)), _SAFE,
          (Wanted("controller: commands", _ERROR, "without pressure 1"),), _CLEAR, clear=("controller",),
          bench="relayed"),
    Fault("estimates late", "by 100 ms", messages("late=0.1", ("joint_estimate",)), _SAFE,
          (Wanted("controller: commands", _WARN, "late"),), bench="relayed"),
    Fault("commands late", "by 100 ms", messages("late=0.1", ("valve_command",)), _SAFE,
          (Wanted("bridge: commands", _WARN, "late"),), bench="relayed"),
    # ---- time
    # For 0.3 s the bridge listens to the device's clock anew, and has no stamps for its samples.
    Fault("machine's clock set back", "by 5 s, with device and bridge", clock_set_back(5.0), _SAFE,
          (Wanted("bridge: clock", _WARN, "listens"), Wanted("controller: commands", _WARN, "jumped backwards")),
          lasts=0.2, bench="stepped"),
    Fault("machine's clock set ahead", "by 5 s, with device and bridge", clock_set_back(-5.0), _SAFE,
          (Wanted("bridge: clock", _WARN, "listens"),), lasts=0.2, bench="stepped"),
)  # fmt: skip
"""All of them; those of one pipeline stand together."""
