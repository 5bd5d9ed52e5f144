"""How faults are made: a cause is a generator of the times [ns since 1970] at which its fault begins and is over."""

from __future__ import annotations

import resource
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.processes import ProcessFailed
from pam_antagonist.recording import read_bag
from validation.faults import valve_log
from validation.faults.bench import Bench
from validation.faults.fault import LIMIT_MS, Ended

Cause = Callable[[Bench], Iterator[Ended]]
_START = 30.0  # of one node [s]
_RECORDING = 1.5  # before the disk is full [s]


def at_device(order: str) -> Cause:
    """A fault of the device or its line: ``KIND`` or ``KIND=VALUE`` of ``hardware.line_faults``."""

    def cause(bench: Bench) -> Iterator[Ended]:
        yield Ended(bench.order(f"+{order}"))
        yield Ended(bench.order(f"-{order.partition('=')[0]}"))

    return cause


def killed(node: str) -> Cause:
    """SIGKILL; started again at the end."""

    def cause(bench: Bench) -> Iterator[Ended]:
        yield Ended(bench.kill(node))
        now = time.time_ns()
        bench.start(node)
        yield Ended(now)

    return cause


def stalled(node: str, seconds: float) -> Cause:
    """SIGSTOP and SIGCONT, as when a machine has other things to do."""

    def cause(bench: Bench) -> Iterator[Ended]:
        yield from map(Ended, bench.stall(node, seconds))

    return cause


def device_stalled(seconds: float) -> Cause:
    """The device stands still."""

    def cause(bench: Bench) -> Iterator[Ended]:
        begin = bench.order("+stall")
        time.sleep(max(0.0, seconds - (time.time_ns() - begin) * 1e-9))
        over = bench.order("-stall")
        yield Ended(begin)
        yield Ended(over)

    return cause


def messages(order: str, topics: tuple[str, ...]) -> Cause:
    """``drop=SHARE``, ``double`` or ``late=SECONDS`` happens to messages on their way."""

    def cause(bench: Bench) -> Iterator[Ended]:
        yield Ended([bench.relay(f"+{order} {topic}") for topic in topics][0])
        yield Ended([bench.relay(f"-{topic}") for topic in topics][0])

    return cause


def second_commander(voltage: tuple[float, float], seconds: float) -> Cause:
    """Somebody else publishes commands, 500 times a second."""

    def cause(bench: Bench) -> Iterator[Ended]:
        thread = threading.Thread(target=bench.watcher.intrude, args=(seconds, voltage))
        now = time.time_ns()
        thread.start()
        yield Ended(now)
        thread.join()
        yield Ended(time.time_ns())

    return cause


def clock_set_back(seconds: float) -> Cause:
    """The nodes' time goes back, or ahead where that is negative; that stays so."""

    def cause(bench: Bench) -> Iterator[Ended]:
        yield Ended(bench.set_clock_back(seconds))
        yield Ended(time.time_ns())

    return cause


def disk_full(bench: Bench) -> Iterator[Ended]:
    """A recorder whose files may not grow any more; it ends by itself, and its bag can be read."""
    bag = bench.folder / "bag"
    bench.record(bag)
    bench.until(lambda: bench.watcher.latest("recorder: bag") is not None, _START, "a recorder")
    bench.wait(_RECORDING)
    size = max(file.stat().st_size for file in bag.iterdir())
    now = time.time_ns()
    # What a full disk is to a process: its writes fail.
    resource.prlimit(bench.processes.running["record"].popen.pid, resource.RLIMIT_FSIZE, (size, size))
    yield Ended(now)
    process = bench.processes.running.pop("record")
    status = process.popen.wait(_START)
    now = time.time_ns()
    if status != 2:
        raise ProcessFailed(f"the recorder ended with status {status}: {process.last_words()}")
    try:
        yield Ended(now, f"{len(read_bag(bag))} samples of the bag can be read")
    except BadInput as error:
        raise ProcessFailed(f"what was recorded cannot be read: {error}") from None


def wrong_rig(node: str, changes: str, runs: bool = True) -> Cause:
    """A node is started again with the rig file of something else, and with its own at the end.

    `changes` is YAML that is laid over the pipeline's rig. `runs`: whether the node can run with it, and control comes
    back for a moment before somebody notices; the fault begins then.
    """

    def again(bench: Bench, more: dict[str, object] | None = None) -> None:
        bench.watcher.collect()  # what the old one said last is not the new one's
        before = len(bench.watcher.statuses)
        bench.start(node, more)
        if more is None or runs:
            said = lambda: any(s.part == f"{node}: lifecycle" for s in bench.watcher.statuses[before:])  # noqa: E731
            bench.until(said, _START, f"{node} again")

    def cause(bench: Bench) -> Iterator[Ended]:
        path = bench.folder / f"wrong_{node}.yaml"
        path.write_text(f"based_on: {bench.rig}\nname: something_else\n{changes}\n", encoding="utf-8")
        stopped = bench.kill(node)
        bench.wait(0.2)
        started = time.time_ns()
        again(bench, {"rig": str(path)})
        if runs:
            bench.wait(0.5)
            yield Ended(valve_log.first_obeyed(bench.rows(), started) or stopped)
            over, note = bench.kill(node), ""
        else:
            if bench.processes.running.pop(node).popen.wait(_START) != 2:
                raise ProcessFailed(f"{node} took a rig file that makes no sense")
            yield Ended(stopped)
            over, note = time.time_ns(), _last_words(bench.folder / f"{node}.log")
        again(bench)
        yield Ended(over, note)

    return cause


def _last_words(log: Path) -> str:
    lines = [line for line in log.read_text(errors="replace").splitlines() if line.startswith("error:")]
    return lines[-1] if len(lines) == 1 else f"{len(lines)} lines of errors"


def neighbour(bench: Bench) -> Iterator[Ended]:
    """Another pipeline in another namespace of the same domain, whose controller is killed; its valves become safe."""
    with bench.run_beside() as second:
        begin = second.kill("controller")
        yield Ended(begin)
        now = time.time_ns()
        since = valve_log.safe_since(second.rows(), begin, now)
        status = second.watcher.latest("bridge: commands")
    if since is None or status is None or status.level == 0:
        raise ProcessFailed("the pipeline beside it lost its controller, and its valves or diagnostics do not show it")
    milliseconds = (since.time_ns - begin) * 1e-6
    if milliseconds > LIMIT_MS:
        raise ProcessFailed(f"the valves of the pipeline beside it were safe after {milliseconds:.0f} ms only")
    yield Ended(now, f"those of the other one are safe after {milliseconds:.0f} ms")
