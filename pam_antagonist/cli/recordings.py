"""What the commands share that learn from recordings: their arguments, reading the bags, the workers of a scheduler."""

from __future__ import annotations

import argparse
import importlib
import math
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pam_antagonist import __version__
from pam_antagonist.cli import common
from pam_antagonist.errors import BadInput
from pam_antagonist.optional import needs
from pam_antagonist.program import typed
from pam_antagonist.recording import corrections

if TYPE_CHECKING:
    from pam_antagonist.recording import Recording
    from pam_antagonist.report.result import Result
    from pam_antagonist.rig import Rig

_SCHEDULER_S = 10.0
"""[s] A scheduler that does not answer for so long is not there."""


def add_bags(parser: common.Parser) -> None:
    """Bags, rig, new folder, and whether the joint could move."""
    parser.shared("bags", "--rig", "--out", "--joint of a recording", "--lock-angle")


def add_names_and_report(parser: common.Parser) -> None:
    """Names of topics and joint, damaged bags, and what the report holds."""
    parser.shared("--topic", "--namespace", "--joint-name", "--recover")
    corrections.add_options(parser)
    parser.shared("--no-check", "--json", "--no-figures", "--open")


def begun(arguments: argparse.Namespace, parts: Sequence[str]) -> Rig:
    """The rig, after what can be refused before any work, and after what a first start compiles (``first_start``)."""
    from pam_antagonist.cli.first_start import compile_first
    from pam_antagonist.rig import load_rig

    check_page(arguments)
    common.lock_angle(arguments)
    rig = load_rig(arguments.rig, regulators=True)
    compile_first(parts, rig)
    return rig


def span(values: Any, scale: float, unit: str) -> str:
    """Least and largest value, in a unit."""
    if values is None:
        return "not in the file"
    return f"{np.nanmin(values) * scale:.4g} to {np.nanmax(values) * scale:.4g} {unit}"


def read_one(bag: Path, rig: Rig, arguments: argparse.Namespace, **how: Any) -> Recording:
    """A bag, read as by ``read_bag``, corrected as asked and checked; ``--no-check`` goes on although it is wrong."""
    from pam_antagonist.api.given import calibration
    from pam_antagonist.checks import SHORTEST, check_recording
    from pam_antagonist.recording import read_bag

    known = calibration(rig)
    given = corrections.from_options(arguments, known)
    own = corrections.from_options(arguments).options()
    try:
        recording = read_bag(bag, corrections=given, known=tuple(rig.signals), **how)
    except BadInput as exc:
        if own and _can_be_read(bag, known, how):
            raise BadInput(f"{exc}; it can be read without {' '.join(own)}: leave that out") from None
        raise
    if arguments.no_check or recording.duration_s < SHORTEST or recording.drive != rig.drive:
        return recording
    checked = check_recording(recording, rig, arguments.joint, arguments.lock_angle)
    if checked.wrong:
        if own:
            # As it was recorded, it tells which of the given corrections are wrong.
            raw = corrections.Corrections(align_clocks=given.align_clocks)
            recorded = read_bag(bag, corrections=raw, **how, judge=False)
            checked = check_recording(recorded, rig, arguments.joint, arguments.lock_angle, given)
        first = (*checked.wrong, *checked.findings)[0]
        raise BadInput(
            f"{bag}: {first.text}; {first.todo or 'correct that'}, or type --no-check to go on as it is "
            f"(see {typed('check --help')})"
        )
    return recording


def as_read(arguments: argparse.Namespace, fixes: corrections.Corrections | None = None) -> list[str]:
    """The options with which the bags are read as here, for the command that comes next.

    `fixes`: corrections; default: those that were typed.
    """
    out = (fixes or corrections.from_options(arguments)).options()
    out += [f"--joint {arguments.joint}"] if arguments.joint != "auto" else []
    out += [] if arguments.lock_angle is None else [f"--lock-angle {math.degrees(arguments.lock_angle):.6g}"]
    out += [f"--topic {shlex.quote(f'{name}={other}')}" for name, other in arguments.topic]
    named = {"--namespace": arguments.namespace, "--joint-name": arguments.joint_name}
    out += [f"{option} {shlex.quote(value)}" for option, value in named.items() if value is not None]
    flags = {"--recover": arguments.recover, "--no-check": getattr(arguments, "no_check", False)}
    return [*out, *(option for option, typed_it in flags.items() if typed_it)]


def next_on_bags(
    arguments: argparse.Namespace, command: str, bags: Sequence[Path] | None, rig: str | Path,
    fixes: corrections.Corrections | None = None,
) -> str:  # fmt: skip
    """The command that usually comes next on recordings, complete.

    `bags`: None for one that no fit has seen: the only other one beside those that were given, where there is one.
    `fixes`: see :func:`as_read`.
    """
    named = _others(arguments.bags) if bags is None else bags
    words = command if named else f"{command} ANOTHER_BAG"
    return common.next_command(words, named, " ".join([f"--rig {rig} --out DIR", *as_read(arguments, fixes)]))


def _others(bags: Sequence[Path]) -> list[Path]:
    """The one bag that stands beside others; empty where there are none or several."""
    given, folders = {bag.resolve() for bag in bags}, dict.fromkeys(bag.parent for bag in bags)
    found = [path for folder in folders for path in sorted(folder.glob("*/metadata.yaml"))]
    beside = [path.parent for path in found if path.parent.resolve() not in given]
    return beside if len(beside) == 1 else []


def _can_be_read(bag: Path, known: corrections.Corrections, how: Mapping[str, Any]) -> bool:
    from pam_antagonist.recording import read_bag

    try:
        read_bag(bag, corrections=known, **how)
    except BadInput:
        return False
    return True


def read(arguments: argparse.Namespace, rig: Rig, further: Sequence[Path] = ()) -> list[Recording]:
    """The bags of :func:`add_bags`, and others behind them, corrected as asked and checked against the rig."""
    from pam_antagonist.recording import bag_hash

    how = {name: getattr(arguments, name) for name in ("namespace", "joint_name", "recover")}
    bags, also = [*arguments.bags, *further], getattr(arguments, "also", ())
    recordings = [read_one(bag, rig, arguments, topics=common.topics(arguments), also=also, **how) for bag in bags]
    hashes = [bag_hash(recording.path) for recording in recordings]
    for k, value in enumerate(hashes):
        if value in hashes[:k]:
            raise BadInput(f"{bags[k]}: the same recording as {bags[hashes.index(value)]}")
    return recordings


def damage(arguments: argparse.Namespace, recordings: Sequence[Recording]) -> list[str]:
    """With ``--recover``: what there is to say of each recording, since something is missing from it."""
    return [issue for recording in recordings for issue in recording.issues] if arguments.recover else []


def note_down(
    arguments: argparse.Namespace, command: str, recordings: Sequence[Recording], rig: Rig, result: object,
    written: Path | None = None,
) -> None:  # fmt: skip
    """Write a result into the rig's log book; where that fails a line says so, and the result is not lost."""
    if arguments.no_log:
        return
    from pam_antagonist.api.history import log

    try:
        log(command, arguments.rig, recordings, rig, result, written)
    except BadInput as error:
        print(f"warning: {error}", file=sys.stderr)


def check_page(arguments: argparse.Namespace) -> None:
    """Before any work of a command whose ``--out`` may be left out: can the page be written?"""
    if arguments.out is not None:
        common.check_output(arguments.out)
        common.only_available_figures(arguments)


def announce(arguments: argparse.Namespace, result: Result, rig: str | None, apart: bool = False) -> None:
    """Save a result, and say what it is and where rig and report are; without a rig, `apart` is an empty line.

    Without ``--out`` it is only said.
    """
    if arguments.out is None:
        print(result.summary())
        return
    result.save(arguments.out, figures=not arguments.no_figures)
    print(result.summary())
    if rig is not None or apart:
        print("" if rig is None else f"\nrig: {arguments.out / rig}")
    common.announce_report(arguments, arguments.out)


@contextmanager
def connected(address: str | None) -> Iterator[None]:
    """Everything inside that runs in parallel by joblib does so on the workers of a scheduler."""
    if address is None:
        yield
        return
    from joblib import parallel_config

    with needs("dask", "--dask"):
        import distributed
    try:
        client = distributed.Client(address, timeout=_SCHEDULER_S, set_as_default=True)
    except (OSError, TimeoutError, ValueError) as error:
        raise BadInput(
            f"--dask {address}: no scheduler answers there ({type(error).__name__}); expected an address such as "
            "tcp://host:8786"
        ) from None
    with client:
        found = client.run(_version)
        if not found:
            raise BadInput(f"--dask {address}: the scheduler has no workers; start one with: dask worker {address}")
        for worker, version in found.items():
            if version != __version__:
                raise BadInput(
                    f"--dask {address}: worker {worker} has {version or 'no pam_antagonist'}; expected pam_antagonist "
                    f"{__version__}, as here"
                )
        with parallel_config(backend="dask"):
            yield


def _version() -> str:
    """Version of the package where this runs; empty where there is none."""
    try:
        return str(importlib.import_module("pam_antagonist").__version__)
    except ImportError:
        return ""
