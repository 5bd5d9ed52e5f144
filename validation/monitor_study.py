"""Let the monitor watch simulated joints under sensor-less control, faster than real time.

The joints move by steps or rest, with pressures alone or with an encoder. First nothing is wrong for hours. Then each
effect that can come begins after 90 s of a run of its own.

A joint's parameters differ from the rig file by a percent. A size of n noises moves the pressure or the angle that it
moves most by n standard deviations of a sample, root mean square over a minute of the moving joint under the same
voltages. Found: when the search would begin, the effect is the first finding, or one that cannot be told from it.
With --search each of them is carried out, as the node does: then false alarms are findings that it confirms, and a
fault is found if it is confirmed. DIR keeps each seed's outcome; the same command again goes on.

examples:
  {run} monitor_study --out DIR --hours 10 --seeds 2
  {run} monitor_study --out DIR --rig bench --hours 2 --seeds 1 --docs figures.md
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from pam_antagonist.cli import common
from pam_antagonist.cli.monitor import search as searched
from pam_antagonist.cli.progress import counted
from pam_antagonist.diagnosis.monitor import Alarms, Conclusion, Monitor
from pam_antagonist.diagnosis.monitor_blocks import WINDOW, MonitorFinding, alike
from pam_antagonist.errors import BadInput
from pam_antagonist.report.document import Table
from pam_antagonist.rig import Encoder, Rig, load_rig
from pam_antagonist.rig.file import write_rig
from validation import frame
from validation.monitored import Fault, Joint, Samples, faults, size_of
from validation.rigs.rehearsed import DESCRIBED, written

NOISES = (4.0, 8.0, 16.0)
_MINUTES = 20
WAYS = [(moving, encoder) for moving in (True, False) for encoder in (False, True)]
_ENCODER = Encoder(std=5e-4, step=0.0, offset=0.0)
_WARM_UP, _LONGEST = 90, 120
"""[s] Before a fault, and after it."""
_NOTHING: dict[str, Any] = {"verdict": "none", "effects": [], "calibration": [], "ambiguous_with": []}
_TAIL = 0.1
"""Share of the largest minutes from which the tail of the evidence is taken."""


def _words(moving: bool, encoder: bool = False) -> str:
    return ("moving" if moving else "at rest") + (", encoder" if encoder else "")


def rig_of(name: str, folder: Path) -> Rig:
    """A rig with an encoder; one of ``rehearse_new_rigs`` as if its values were identified to a percent."""
    if name not in DESCRIBED:
        rig = load_rig(name, regulators=True)
    else:
        path = folder / f"{name}.yaml"
        rig = load_rig(path, regulators=True) if path.exists() else written(name, path)
        rig = rig.replaced(priors={}, uncertainty={}, directions={})
    return rig if rig.encoder is not None else rig.replaced(encoder=_ENCODER)


class Watched:
    """A joint, its two monitors, and what a node would do with what they say."""

    def __init__(self, rig: Rig, seed: int, moving: bool, searches: Path | None) -> None:
        self.joint = Joint(rig, seed, moving)
        self.monitors = Monitor(rig), Monitor(rig, encoder=True)
        self.alarms = Alarms(), Alarms(encoder=True)
        self.joint.run(1)  # compiles
        self.seconds, self.searches, self._kept = [0.0, 0.0], searches, deque[Samples](maxlen=WINDOW)

    def second(self) -> list[list[MonitorFinding]]:
        """What each monitor finds after the next second."""
        samples = self.joint.run(1)
        self._kept.append(samples)
        for k, monitor in enumerate(self.monitors):
            begun = time.process_time()
            monitor.add(*samples[:3], samples.angle if k else None)
            self.seconds[k] += time.process_time() - begun
        return [monitor.findings for monitor in self.monitors]

    def due(self, k: int) -> bool:
        """Whether a node would search now."""
        return self.alarms[k].due(self.monitors[k].findings, int(self._kept[-1].stamps[-1]), self.joint.time)

    def conclude(self, k: int) -> Conclusion | None:
        """What a node would say after its search; None: nothing, as without searches."""
        found: Mapping[str, Any] | None = _NOTHING
        if self.searches is not None:
            with tempfile.TemporaryDirectory() as folder, suppress(BadInput):
                found = None
                found = searched(self._order(k, Path(folder)))
        said = self.alarms[k].concluded(self.monitors[k].findings, found, self.joint.time)
        if said is not None and said.confirmed:
            self.monitors[k].blocks.accept(said.finding)
        return said

    def _order(self, k: int, folder: Path) -> dict[str, Any]:
        angle = (np.concatenate([one.angle if k else np.full(len(one.angle), np.nan) for one in self._kept]),)
        stamps, pressure, voltage = (np.concatenate([one[column] for one in self._kept]) for column in range(3))
        np.savez(folder / "buffer.npz", stamps=stamps, rows=np.column_stack([pressure, voltage, *angle]))
        begin = self.monitors[k].findings[0].onset_ns
        return {
            "buffer": str(folder / "buffer.npz"), "rig": str(self.searches), "begin_ns": begin, "folder": "",
            "log": False, "namespace": "/pam", "joint": "free", "lock_angle": 0.0,
        }  # fmt: skip


def nothing(rig: Rig, seed: int, moving: bool, searches: Path | None, minutes: int) -> dict[str, Any]:
    """A joint with nothing wrong: the largest evidence of each minute, and each search [s, suspect, what is said]."""
    watched = Watched(rig, seed, moving, searches)
    largest: list[list[float]] = [[0.0] * minutes, [0.0] * minutes]
    alarms: list[list[Any]] = [[], []]
    for second in range(60 * minutes):
        for k, findings in enumerate(watched.second()):
            evidence = findings[0].evidence if findings else 0.0
            largest[k][second // 60] = max(largest[k][second // 60], evidence)
            if watched.due(k):
                suspect, said = findings[0].watched.label, watched.conclude(k)
                alarms[k].append((second, suspect, *_in_short(said)))
    return {"minutes": minutes, "largest": largest, "alarms": alarms, "processor_s": watched.seconds}


def trials(
    rig: Rig, seed: int, moving: bool, searches: Path | None, sizes: Sequence[tuple[Fault, float, float]]
) -> list[dict[str, Any]]:
    """What each fault does to the same joint, in a process of its own; faults without a size are left out."""
    watched = Watched(rig, seed, moving, searches)
    calm = {0, 1}
    for _ in range(_WARM_UP):
        watched.second()
        # A monitor that alarms before the fault cannot be judged by it; such alarms count in the hours of nothing.
        calm -= {k for k in calm if watched.due(k)}
    done = []
    with counted(len(sizes), f"seed {seed}, {_words(moving)}") as advance:
        for fault, noises, size in sizes:
            found = _forked(partial(_trial, watched, fault, size, calm)) if calm else []
            done += [{"fault": fault.label, "noises": noises, "size": size, **one} for one in found]
            advance(1)
    return done


def _trial(watched: Watched, fault: Fault, size: float, calm: set[int]) -> list[dict[str, Any]]:
    joint = watched.joint
    joint.change(fault.applied(joint.p, size))
    joint.misread = size * fault.misread
    out: list[dict[str, Any]] = [{"encoder": k == 1, "delay_s": None, "found": False} for k in (0, 1)]
    waiting = set(calm)
    for second in range(1, _LONGEST + 1):
        watched.second()
        for k in [k for k in waiting if watched.due(k)]:
            findings = watched.monitors[k].findings
            out[k] |= {"delay_s": second, "first": findings[0].watched.label, "found": _named(fault, findings)}
            if watched.searches:
                said = watched.conclude(k)
                right = said is not None and said.confirmed and _is(fault, said.finding.watched)
                out[k] |= {"said": _in_short(said), "found": right}
            waiting.discard(k)
        if not waiting:
            break
    return [out[k] for k in sorted(calm)]


def _in_short(said: Conclusion | None) -> tuple[str, str]:
    """Whether a search found something, and what."""
    if said is None:
        return "nothing", ""
    return "confirmed" if said.confirmed else "suspected", said.sentence


def _is(fault: Fault, item: Any) -> bool:
    return (item.name, item.muscle) == (fault.name, fault.muscle)


def _named(fault: Fault, findings: list[MonitorFinding]) -> bool:
    label = f"{fault.name} {fault.muscle}" if fault.muscle else fault.name
    return _is(fault, findings[0].watched) or label in alike(findings)


def _forked(work: Callable[[], Any]) -> Any:
    context = get_context("fork")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=lambda: there.send(work()))
    process.start()
    there.close()  # else a child that ends in an error is waited for without end
    out = here.recv()
    process.join()
    return out


def _shares(trials: Sequence[dict[str, Any]]) -> Iterator[tuple[str, list[list[dict[str, Any]]]]]:
    """Each way in which joints are watched, in words, and its trials by noises."""
    for moving, encoder in WAYS:
        mine = [one for one in trials if (one["moving"], one["encoder"]) == (moving, encoder)]
        yield _words(moving, encoder), [[one for one in mine if one["noises"] == noises] for noises in NOISES]


def _delays(trials: Sequence[dict[str, Any]]) -> list[float]:
    return [one["delay_s"] for one in trials if one["delay_s"] is not None]


def detection(done: Sequence[dict[str, Any]]) -> Table:
    """Share found and median delay, by fault."""

    def cell(trials: Sequence[dict[str, Any]]) -> str:
        late = f" ({np.median(_delays(trials)):.0f} s)" if _delays(trials) else ""
        return f"{sum(one['found'] for one in trials)}/{len(trials)}{late}" if trials else "–"

    rows = []
    for fault in dict.fromkeys(one["fault"] for one in done):
        mine = [one for one in done if one["fault"] == fault]
        rows.append((fault, *(" · ".join(map(cell, each)) for _, each in _shares(mine))))
    heads = ("fault", *(_words(*way) for way in WAYS))
    return Table(heads, tuple(rows), "found of tried, and median delay of an alarm, at 4 · 8 · 16 noises")


def begun(done: Sequence[dict[str, Any]]) -> Table:
    """How many searches begin, how late, and how many faults the evidence names, over all faults."""
    rows = []
    for words, each in _shares(done):
        counts = (f"{len(_delays(trials))}/{len(trials)}" for trials in each)
        medians = (f"{np.median(_delays(trials)):.0f}" if _delays(trials) else "–" for trials in each)
        named = (f"{sum(one['found'] for one in trials)}" for trials in each)
        rows.append((words, *(" · ".join(cells) for cells in (counts, medians, named))))
    heads = ("4 · 8 · 16 noises", "a search begins", "after, median [s]", "named")
    return Table(heads, tuple(rows) if done else (), "all faults together")


def alarms(hours: Sequence[dict[str, Any]]) -> Table:
    """What is found with nothing wrong, and the tail of the evidence."""
    rows = []
    for moving, encoder in WAYS:
        mine = [one for one in hours if one["moving"] == moving]
        total = sum(one["minutes"] for one in mine) / 60.0
        if not total:
            continue
        outcomes = [alarm[2] for one in mine for alarm in one["alarms"][encoder]]
        count = outcomes.count("confirmed")
        low, high = (chi2.ppf(0.025, 2 * count) if count else 0.0), chi2.ppf(0.975, 2 * count + 2)
        cost = sum(one["processor_s"][encoder] for one in mine) / (3600.0 * total)
        rows.append((
            _words(moving, encoder), f"{total:.1f}", str(len(outcomes)), str(outcomes.count("suspected")),
            str(count), f"{low / 2 / total:.2g} to {high / 2 / total:.2g}",
            f"{once_in(np.concatenate([one['largest'][encoder] for one in mine]), 6000.0):.1f}", f"{cost:.1%}",
        ))  # fmt: skip
    heads = ("joint", "hours", "searches", "suspected", "found", "found in an hour, 95 %", "evidence once in 100 h",
             "of a core")  # fmt: skip
    return Table(heads, tuple(rows), "nothing wrong")


def once_in(largest: np.ndarray, minutes: float) -> float:
    """Evidence that one of so many minutes reaches, by the exponential tail of the largest values of minutes."""
    ordered = np.sort(largest)
    count = max(2, round(_TAIL * len(ordered)))
    base = float(ordered[-min(count, len(ordered))])
    return base + float(np.mean(ordered[-count:] - base)) * math.log(minutes * count / len(ordered))


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("monitor_study", __doc__)
    out.option("--out", "folder of the outcomes; may exist", Path, metavar="DIR", required=True)
    out.option("--rig", "a rig, or one of rehearse_new_rigs (default: shin2022)", str, "shin2022", "RIG")
    text = "with nothing wrong, moving and at rest each, a joint for 20 minutes (default: 4)"
    out.option("--hours", text, common.whole(0, 10_000), 4, "H")
    text = "joints that get every effect, moving and at rest (default: 2)"
    out.option("--seeds", text, common.whole(0, 10_000), 2, "N")
    out.option("--first-seed", "(default: 1)", common.SEED, 1, "S")
    out.option("--only", "only effects whose name contains this (default: all)", str, "", "TEXT")
    out.flag("--search", "carry out the searches, each of a minute or two of processor time")
    frame.add_docs(out)
    return out


def _main(arguments: argparse.Namespace) -> int:
    folder = frame.made(arguments.out)
    rig, first = rig_of(arguments.rig, folder), arguments.first_seed
    searches = None
    if arguments.search:
        searches = folder / "rig_file.yaml"
        if not searches.exists():
            write_rig(rig, searches)
    minute = Joint(rig, 0, True, 0.0).run(60) if arguments.seeds else None
    sizes = [
        (fault, noises, size)
        for fault in (faults(rig) if minute else ())
        if arguments.only in fault.label
        for noises in NOISES
        if minute and (size := size_of(fault, noises, rig, minute)) is not None
    ]

    def kept(what: str, seed: int, moving: bool, work: Callable[..., Any], more: object) -> Any:
        parts = what, _words(moving), str(seed), "" if searches is None else "searched"
        path = folder / f"{'_'.join(filter(None, parts)).replace(' ', '_')}.json"
        return frame.kept(path, lambda: work(rig, seed, moving, searches, more))

    joints, seeds = range(first, first + round(60 / _MINUTES * arguments.hours)), range(first, first + arguments.seeds)
    ways = [(seed, moving) for seed in range(first, max(joints.stop, seeds.stop)) for moving in (True, False)]
    quiet, found = [], []
    for seed, moving in ways:
        if seed in joints:
            quiet.append({"moving": moving, **kept("nothing", seed, moving, nothing, _MINUTES)})
        for noises in NOISES if seed in seeds else ():
            more = [one for one in sizes if one[1] == noises]
            name = f"{arguments.only}_faults_{noises:g}".lstrip("_")
            found += [{"moving": moving, **one} for one in kept(name, seed, moving, trials, more)]
    frame.show([alarms(quiet), detection(found), begun(found)], arguments)
    return common.DONE


main = common.command(parser, _main)
