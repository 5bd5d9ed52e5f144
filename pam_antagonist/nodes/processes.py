"""Nodes as separate processes: start, watch and stop them; arguments of the launch files (without ROS)."""

from __future__ import annotations

import atexit
import difflib
import json
import os
import random
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pam_antagonist.program import started

PARENT_VARIABLE = "PAM_ANTAGONIST_PARENT"
"""Environment variable with the id of the parent process; a node ends with it, even if the parent is killed."""

PRIORITY_VARIABLE = "PAM_ANTAGONIST_PRIORITY"
"""Environment variable with the real-time priority (1 to 99) that a node requests; 0: none."""

_START_LIMIT = 300.0  # [s] longest time to start, including compiling on a busy machine
_KILL_AFTER = 5.0  # [s] time for a process to end before it is killed
_DOMAINS = 100  # their ports are below the ephemeral ports of Linux
_FIRST_PORT, _PORTS_A_DOMAIN, _PARTICIPANTS = 7410, 250, 20
_STOP = re.compile(r"^\[ERROR\] \[(?P<time>[0-9.]+)\] \[[^\]]*\]: stopped: (?P<reason>.*)$", re.MULTILINE)
"""A stop for safety, as the nodes log it."""
_PRIORITY, _RECORDER_PRIORITY = 2, 1  # of the real-time scheduler; the recorder has long queues


class ProcessFailed(Exception):
    """A process ended unexpectedly. The message is its last output, in one line."""


@dataclass
class Process:
    """A running executable."""

    name: str
    popen: subprocess.Popen[bytes]
    log: Path

    def last_words(self) -> str:
        """The line that tells why the process ended: the last ``error:`` line, otherwise the last line."""
        try:
            lines = [line.strip() for line in self.log.read_text(errors="replace").splitlines() if line.strip()]
        except OSError:
            lines = []
        errors = [line for line in lines if line.startswith("error:")]
        words = (errors or lines or ["it said nothing"])[-1]
        return words.removeprefix("error:").strip()


def free_domain() -> int:
    """An unused ROS domain on this machine; two pipelines in one domain would receive each other's messages.

    It is kept until this process asks again: nodes take a second to open their ports, and others look for a domain too.
    """
    domains = list(range(1, _DOMAINS + 1))
    random.shuffle(domains)
    for domain in domains:
        if not _busy(domain) and _kept(domain):
            return domain
    raise ProcessFailed(f"each of the ROS domains 1 to {_DOMAINS} is in use on this machine; set ROS_DOMAIN_ID")


_KEPT: dict[int, socket.socket] = {}
"""The last domain that this process was given, and a name on this machine that stands for it."""


@atexit.register
def _let_go() -> None:
    while _KEPT:
        _KEPT.popitem()[1].close()


def _kept(domain: int) -> bool:
    """Keep a domain by a name that ends with the process, even if it is killed; False: another process has it."""
    if domain not in _KEPT:
        name = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            name.bind(f"\0pam_antagonist domain {domain}")
        except OSError:
            name.close()
            return False
        _let_go()  # by now the nodes of the last one have their ports, or have ended
        _KEPT[domain] = name
    return True


def busy_domains() -> list[int]:
    """ROS domains in which nodes of this machine seem to be, by their ports."""
    return [domain for domain in range(_DOMAINS + 1) if _busy(domain)]


def _busy(domain: int) -> bool:
    # Ports of the participants of a domain (RTPS, section 9.6.1.1). The first participants may have left again.
    ports = (_FIRST_PORT + _PORTS_A_DOMAIN * domain + 2 * k for k in range(_PARTICIPANTS))
    return not all(map(_unused, ports))


def _unused(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as trial:
        try:
            trial.bind(("", port))
        except OSError:
            return False
    return True


def ros_arguments(parameters: Mapping[str, object], remappings: Mapping[str, str]) -> list[str]:
    """Command line for a node. `remappings`: from -> to, such as ``__ns`` -> ``/pam``."""
    arguments = ["--ros-args"]
    for name, value in parameters.items():
        arguments += ["-p", f"{name}:={_yaml(value)}"]
    for source, target in remappings.items():
        arguments += ["-r", f"{source}:={target}"]
    return arguments


def _yaml(value: object) -> str:
    """A value as YAML, of which JSON is a part; numbers of a list are written as floats."""
    value = [float(item) for item in value] if isinstance(value, (list, tuple)) else value
    return json.dumps(value, ensure_ascii=False)


class Processes:
    """A group of executables of this package that start and end together.

    Use it as a context manager: at its end all processes are stopped, in the order of their start. They have a session
    of their own, so that only the caller gets Ctrl-C, and they end when the caller is killed. If permitted, they run
    under the real-time scheduler.

    `logs`: existing folder for the log files, one for each process.
    """

    def __init__(self, logs: Path) -> None:
        self._logs = logs
        self.running: dict[str, Process] = {}

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(
        self,
        name: str,
        arguments: Sequence[str] = (),
        environment: Mapping[str, str] | None = None,
        module: str = "pam_antagonist",
    ) -> Process:
        """Start an executable. `name`: of the executable, such as ``plant``; the first argument of the module."""
        log = self._logs / f"{name}.log"
        priority = _RECORDER_PRIORITY if name == "record" else _PRIORITY
        usual = {PRIORITY_VARIABLE: str(priority)}  # the user's own setting comes first
        env = {**usual, **os.environ, PARENT_VARIABLE: str(os.getpid()), **(environment or {})}
        with log.open("wb") as output:
            popen = subprocess.Popen(
                started(module, name, *arguments),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=env,
                start_new_session=True,
            )
        process = self.running[name] = Process(name, popen, log)
        return process

    def check(self) -> None:
        """Make sure that all processes run."""
        for process in self.running.values():
            if process.popen.poll() is not None:
                status = process.popen.returncode
                raise ProcessFailed(f"{process.name} ended with status {status}: {process.last_words()}")

    def stopped(self) -> str:
        """Why a node has stopped the joint for safety, by the logs; the first reason, empty if none has."""
        found = (stop for log in self._logs.glob("*.log") for stop in _stops(log))
        return min(found, default=(0.0, ""))[1]

    def wait(self, missing: Callable[[], str]) -> None:
        """Wait until nothing is missing."""
        begin = time.monotonic()
        while what := missing():
            self.check()
            if time.monotonic() - begin > _START_LIMIT:
                raise ProcessFailed(f"no command came within {_START_LIMIT:g} s of the start: {what}")
            time.sleep(0.01)

    def stop(self, *names: str) -> dict[str, int]:
        """End processes one after the other and wait for each; kill those that do not end.

        `names`: processes to end, in this order; none: all, in the order of their start.
        """
        statuses = {}
        for name in names or tuple(self.running):
            process = self.running.pop(name)
            statuses[name] = _end(process.popen)
        return statuses


def _stops(log: Path) -> Iterator[tuple[float, str]]:
    """Times of a log's stops for safety, and their reasons in words."""
    try:
        text = log.read_text(errors="replace")
    except OSError:
        return
    for found in _STOP.finditer(text):
        yield float(found["time"]), f"{log.stem}: {found['reason'].strip()}"


def _end(popen: subprocess.Popen[bytes]) -> int:
    """End a process by SIGINT, then by SIGKILL."""
    deadline = time.monotonic() + _KILL_AFTER
    if popen.poll() is None:
        popen.send_signal(signal.SIGINT)
    while True:
        try:
            return popen.wait(max(0.1, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            popen.kill()
        except KeyboardInterrupt:
            continue  # a second Ctrl-C must not leave a process behind


RESPAWN_DELAY = 2.0
"""[s] Delay before an ended node is started again."""
STOP_TIME = "15"
"""[s] Time for a node to end after Ctrl-C before launch kills it, on a machine that is busy compiling."""
_SWITCHES = ("use_sim_time", "autostart")


def refuse_unknown(file: str, given: Sequence[str], known: Sequence[str]) -> None:
    """Refuse unknown arguments of a launch file, which launch would silently ignore.

    An included launch file is not checked, because the arguments belong to the including file.

    `given`: arguments, such as ``rig:=my_rig``.
    """
    if file not in {Path(word).name for word in sys.argv[1:]}:
        return
    for word in given:
        name, is_argument, _ = word.partition(":=")
        if is_argument and name not in known:
            close = difflib.get_close_matches(name, known, 1)
            hint = f"did you mean {close[0]}?" if close else f"expected one of {', '.join(known)}"
            raise ValueError(f"{word}: unknown argument; {hint}")


def value_of(name: str, text: str) -> str | bool:
    """Value of a parameter that was given as an argument: a bool for switches, otherwise the text."""
    if name not in _SWITCHES:
        return text
    if text.lower() not in ("true", "false"):
        raise ValueError(f"{name}:={text}: expected true or false")
    return text.lower() == "true"
