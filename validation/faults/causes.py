"""How faults are made: each cause begins one in a running pipeline, and ends it."""

from __future__ import annotations

import resource
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.processes import ProcessFailed
from pam_antagonist.recording import read_bag
from validation.faults import valve_log
from validation.faults.bench import Bench
from validation.faults.fault import LIMIT_MS, Ended

_START = 30.0  # of one node [s]
_RECORDING = 1.5  # before the disk is full [s]


@dataclass(frozen=True)
class AtDevice:
    """A fault of the device or its line, see :data:`pam_antagonist.hardware.line_faults.KINDS`.

    Attributes:
        order: ``KIND`` or ``KIND=VALUE``.
    """

    order: str

    def begin(self, bench: Bench) -> int:
        """Seen in the device's own log."""
        return bench.order(f"+{self.order}")

    def end(self, bench: Bench) -> Ended:
        """Likewise."""
        return Ended(bench.order(f"-{self.order.partition('=')[0]}"))


@dataclass(frozen=True)
class Killed:
    """SIGKILL; started again at the end.

    Attributes:
        node: its executable.
    """

    node: str

    def begin(self, bench: Bench) -> int:
        """The moment right before."""
        return bench.kill(self.node)

    def end(self, bench: Bench) -> Ended:
        """Start it again."""
        now = time.time_ns()
        bench.start(self.node)
        return Ended(now)


@dataclass
class Stalled:
    """SIGSTOP and SIGCONT, as when a machine has other things to do.

    Attributes:
        node: its executable.
        seconds: [s].
    """

    node: str
    seconds: float
    _over: int = field(default=0, init=False)

    def begin(self, bench: Bench) -> int:
        """The moment right before; it is over when this returns."""
        begin, self._over = bench.stall(self.node, self.seconds)
        return begin

    def end(self, bench: Bench) -> Ended:
        """Nothing is left to do."""
        return Ended(self._over)


@dataclass
class DeviceStalled:
    """The device stands still.

    Attributes:
        seconds: [s].
    """

    seconds: float
    _over: int = field(default=0, init=False)

    def begin(self, bench: Bench) -> int:
        """Seen in the device's own log; it is over when this returns."""
        begin = bench.order("+stall")
        time.sleep(max(0.0, self.seconds - (time.time_ns() - begin) * 1e-9))
        self._over = bench.order("-stall")
        return begin

    def end(self, bench: Bench) -> Ended:
        """How long it was."""
        return Ended(self._over)


@dataclass(frozen=True)
class Messages:
    """Something happens to messages on their way.

    Attributes:
        order: ``drop=SHARE``, ``double`` or ``late=SECONDS``.
        topics: whose messages.
    """

    order: str
    topics: tuple[str, ...]

    def begin(self, bench: Bench) -> int:
        """Tell the relay."""
        return [bench.relay(f"+{self.order} {topic}") for topic in self.topics][0]

    def end(self, bench: Bench) -> Ended:
        """Tell it that it is over."""
        return Ended([bench.relay(f"-{topic}") for topic in self.topics][0])


@dataclass
class SecondCommander:
    """Somebody else publishes commands, 500 times a second, until told to stop.

    Attributes:
        voltage: what it asks for (2,) [V].
        seconds: [s].
    """

    voltage: tuple[float, float]
    seconds: float
    _thread: threading.Thread | None = field(default=None, init=False)

    def begin(self, bench: Bench) -> int:
        """Right before its first command."""
        now = time.time_ns()
        self._thread = threading.Thread(target=bench.watcher.intrude, args=(self.seconds, self.voltage))
        self._thread.start()
        return now

    def end(self, bench: Bench) -> Ended:
        """Wait for its end."""
        assert self._thread is not None
        self._thread.join()
        return Ended(time.time_ns())


@dataclass(frozen=True)
class ClockSetBack:
    """The nodes' time goes back.

    Attributes:
        seconds: by so much; ahead where negative [s].
    """

    seconds: float

    def begin(self, bench: Bench) -> int:
        """Set it back; that stays so."""
        return bench.set_clock_back(self.seconds)

    def end(self, bench: Bench) -> Ended:
        """Nothing is to be undone."""
        return Ended(time.time_ns())


@dataclass
class DiskFull:
    """A recorder whose files may not grow any more."""

    _bag: Path = field(default=Path(), init=False)

    def begin(self, bench: Bench) -> int:
        """The moment from which on nothing more fits."""
        self._bag = bench.folder / "bag"
        bench.record(self._bag)
        bench.until(lambda: bench.watcher.latest("recorder: bag") is not None, _START, "a recorder")
        bench.wait(_RECORDING)
        size = max(file.stat().st_size for file in self._bag.iterdir())
        now = time.time_ns()
        # What a full disk is to a process: its writes fail.
        resource.prlimit(bench.processes.running["record"].popen.pid, resource.RLIMIT_FSIZE, (size, size))
        return now

    def end(self, bench: Bench) -> Ended:
        """It has ended by itself; its bag can be read."""
        process = bench.processes.running.pop("record")
        status = process.popen.wait(_START)
        now = time.time_ns()
        if status != 2:
            raise ProcessFailed(f"the recorder ended with status {status}: {process.last_words()}")
        try:
            kept = len(read_bag(self._bag))
        except BadInput as error:
            raise ProcessFailed(f"what was recorded cannot be read: {error}") from None
        return Ended(now, f"{kept} samples of the bag can be read")


@dataclass
class WrongRig:
    """A node is started again with the rig file of something else; with its own at the end.

    Attributes:
        node: its executable.
        changes: the file, as YAML that is laid over the pipeline's rig.
        runs: whether the node can run with it, and control comes back before somebody notices.
    """

    node: str
    changes: str
    runs: bool = True

    def begin(self, bench: Bench) -> int:
        """The end of the old one; where control comes back for a moment, that moment."""
        path = bench.folder / f"wrong_{self.node}.yaml"
        path.write_text(f"based_on: {bench.rig}\nname: something_else\n{self.changes}\n", encoding="utf-8")
        stopped = bench.kill(self.node)
        bench.wait(0.2)
        before = len(bench.watcher.statuses)
        started = time.time_ns()
        bench.start(self.node, {"rig": str(path)})
        if not self.runs:
            status = bench.processes.running.pop(self.node)
            if status.popen.wait(_START) != 2:
                raise ProcessFailed(f"{self.node} took a rig file that makes no sense")
            return stopped
        self._wait_for_it(bench, before)
        bench.wait(0.5)
        return valve_log.first_obeyed(bench.rows(), started) or stopped

    def end(self, bench: Bench) -> Ended:
        """Start it with its own rig file."""
        if self.runs:
            now, note = bench.kill(self.node), ""
        else:
            now, note = time.time_ns(), _last_words(bench.folder / f"{self.node}.log")
        bench.watcher.collect()  # what the old one said last is not the new one's
        before = len(bench.watcher.statuses)
        bench.start(self.node)
        self._wait_for_it(bench, before)
        return Ended(now, note)

    def _wait_for_it(self, bench: Bench, before: int) -> None:
        part = f"{self.node}: lifecycle"
        bench.until(lambda: any(s.part == part for s in bench.watcher.statuses[before:]), _START, f"{self.node} again")


def _last_words(log: Path) -> str:
    lines = [line for line in log.read_text(errors="replace").splitlines() if line.startswith("error:")]
    return lines[-1] if len(lines) == 1 else f"{len(lines)} lines of errors"


@dataclass
class Beside:
    """Another pipeline in another namespace of the same domain, whose controller is killed."""

    _killed: int = field(default=0, init=False)

    def begin(self, bench: Bench) -> int:
        """The moment of the kill."""
        second = bench.run_beside()
        self._killed = second.kill("controller")
        return self._killed

    def end(self, bench: Bench) -> Ended:
        """What the other one's valves did meanwhile.

        Raises:
            ProcessFailed: they did not become safe in time, or no status shows it.
        """
        second = bench.second
        assert second is not None
        now = time.time_ns()
        since = valve_log.safe_since(second.rows(), self._killed, now)
        status = second.watcher.latest("bridge: commands")
        if since is None or status is None or status.level == 0:
            raise ProcessFailed(
                "the pipeline beside it lost its controller, and its valves or diagnostics do not show it"
            )
        milliseconds = (since.time_ns - self._killed) * 1e-6
        second.__exit__()
        bench.second = None
        if milliseconds > LIMIT_MS:
            raise ProcessFailed(f"the valves of the pipeline beside it were safe after {milliseconds:.0f} ms only")
        return Ended(now, f"those of the other one are safe after {milliseconds:.0f} ms")
