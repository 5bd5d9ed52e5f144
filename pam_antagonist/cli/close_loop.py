"""Trace what the model of a rig lacks to a physical effect, add it, and report the error before and after.

Give recordings of a joint that moves (free) and of one that is held (locked), with angle and torque measured. The
base parameters are recalibrated first, so that a wrong parameter is not called an effect; then each effect of the
catalogue is tested. The verdict is an effect, "none" or "unexplained". The end of each recording, or a separate
recording (--holdout), is held out: no fit uses it, and the result is judged on it. A rig whose valves are sealed needs
a recording of its joint driven to and fro by a known torque (docs/evidence/measured.md). A rig with pressure
regulators (drive: regulator) takes such recordings as well, or many short episodes in one recording (import_csv), of
which whole ones are held out.

Writes DIR/report.html, DIR/report.json and DIR/rig_extended.yaml, which every command and node takes (what depends on
further signals, --also, nodes and simulate leave out); of several recordings also DIR/rig_extended_1.yaml ..., each
with one recording's own values. A file is left out if it would be worse on held-out data than the rig given. The last
lines name the one file to use next (it may be DIR/rig_recalibrated.yaml, without effects), or say that you keep the
rig given.
Status: 0 done (whatever the verdict), 2 bad input (one line says what and where).

examples:
  {run} close_loop free_bag locked_bag --rig shin2022 --out found
  {run} close_loop free_bag locked_bag --rig my_rig.yaml --out found --resume
  {run} close_loop free_bag locked_bag --holdout another_bag --rig my_rig.yaml --out found
  {run} replay another_bag --rig found/rig_extended.yaml --out check
"""

from __future__ import annotations

import argparse
import hashlib
import re
import shlex
import shutil
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pam_antagonist import __version__
from pam_antagonist.cli import common
from pam_antagonist.cli import recordings as given
from pam_antagonist.cli.common import real
from pam_antagonist.cli.progress import phases
from pam_antagonist.errors import BadInput
from pam_antagonist.program import INTERRUPTED, typed
from pam_antagonist.recording import corrections

if TYPE_CHECKING:
    from pam_antagonist.diagnosis.hypotheses import ResumeFolder
    from pam_antagonist.recording import Recording
    from pam_antagonist.rig import Rig

_SHARE = 1.0 / 3.0


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("close_loop", __doc__)
    given.add_bags(out)
    out.repeated(
        "--holdout", "what is held out, so that no fit uses it: a share at the end of each recording (default: a "
        "third), or a whole recording (may be given several times)", "SHARE|BAG", _held_out,
    )  # fmt: skip
    out.repeated(
        "--also", "another recorded signal on which the joint may depend: a name below also/, or a topic; may be given "
        "several times; for rigs with drive: regulator", "SIGNAL",
    )  # fmt: skip
    out.shared("--jobs", "--dask")
    out.shared("--seed", help="seed of the random starts of fits (default: 0)")
    out.flag("--resume", "continue an interrupted run, which left its results in DIR.part")
    given.add_names_and_report(out)
    out.shared("--no-log")
    return out


def _held_out(text: str) -> float | Path:
    """A share, or a bag; a bag whose name is a number is given as ./0.3."""
    try:
        float(text)
    except ValueError:
        if re.fullmatch(r"0?,\d+", text):
            raise argparse.ArgumentTypeError(f"{text!r}: expected a share with a point, such as 0.3") from None
        return Path(text)
    return real(0.1, 0.5, "a share")(text)


def _run(arguments: argparse.Namespace) -> int:
    from pam_antagonist.api.given import calibration
    from pam_antagonist.api.ways import EPISODES, way
    from pam_antagonist.cli.first_start import FITS

    rig = given.begun(arguments, FITS)
    share, bags = _split(arguments.holdout)
    recordings = given.read(arguments, rig, bags)
    kind = way(recordings, rig)
    kind.refuse("diagnose", {
        name: getattr(arguments, name) for name in ("joint", "lock_angle", "seed", "also", "resume", "dask")
    }, "--")  # fmt: skip
    if kind is EPISODES:
        found = _diagnosed(arguments, rig, recordings, share)
        given.announce(arguments, found, found.next_rig)
        _note_down(arguments, recordings, rig, found)
        return common.DONE
    found = _resumable(arguments, rig, share, recordings)
    corrected = corrections.from_options(arguments, calibration(rig))
    damage = given.damage(arguments, recordings)
    found = replace(found, warnings=(*damage, *found.warnings), typed=corrected)
    given.announce(arguments, found, found.next_rig)
    _note_down(arguments, recordings, rig, found)
    shutil.rmtree(_kept(arguments), ignore_errors=True)
    if (proposed := found.choice.proposed) is not None:
        own = None if found.held else arguments.bags if proposed.number is None else [arguments.bags[proposed.number]]
        print(given.next_on_bags(arguments, "replay", own, arguments.out / proposed.name))
    return common.DONE


def _kept(arguments: argparse.Namespace) -> Path:
    """Folder of what an interrupted run has finished."""
    folder: Path = arguments.out.parent / f"{arguments.out.name}.part"
    return folder


def _resumable(arguments: argparse.Namespace, rig: Rig, share: float, recordings: list[Recording]) -> Any:
    """Diagnose a joint, and keep what is finished where that is interrupted."""
    from pam_antagonist.diagnosis.hypotheses import ResumeFolder
    from pam_antagonist.recording import bag_hash, bag_name

    kept = _kept(arguments)
    if kept.exists() and not arguments.resume:
        raise BadInput(f"{kept}: left by an interrupted run; give --resume to go on with it, or remove it")
    hashes = [bag_hash(recording.path) for recording in recordings]
    holdout = [bag_name(recording.path) for recording in recordings[len(arguments.bags) :]] or share
    store = ResumeFolder(kept.absolute())
    store.claim({
        # What finished candidates depend on.
        "recordings": hashes,
        "rig": hashlib.sha256(repr(rig).encode()).hexdigest(),
        "holdout": holdout,
        "joint": [arguments.joint, arguments.lock_angle],
        "seed": arguments.seed,
        "version": __version__,
    })  # fmt: skip
    try:
        with given.connected(arguments.dask):
            return _diagnosed(arguments, rig, recordings, share, store)
    except KeyboardInterrupt:
        again = [*(word for word in arguments.words if word != "--resume"), "--resume"]
        print(
            f"interrupted: {store.finished()} finished refits are kept in {store.folder}; to go on with them:\n"
            f"  {typed('close_loop')} {shlex.join(again)}",
            file=sys.stderr,
        )
        raise SystemExit(INTERRUPTED) from None
    except BadInput:
        if not store.finished():
            shutil.rmtree(kept, ignore_errors=True)
        raise


def _note_down(arguments: argparse.Namespace, recordings: Sequence[Recording], rig: Rig, result: Any) -> None:
    written = None if result.next_rig is None else arguments.out / result.next_rig
    given.note_down(arguments, "close_loop", recordings, rig, result, written)


def _diagnosed(
    arguments: argparse.Namespace, rig: Rig, recordings: Sequence[Recording], share: float,
    store: ResumeFolder | None = None,
) -> Any:  # fmt: skip
    from pam_antagonist.api.diagnose import diagnose

    count = len(arguments.bags)
    with phases("close_loop") as progress:
        return diagnose(
            recordings[:count], rig, joint=arguments.joint, lock_angle=arguments.lock_angle, holdout=share,
            held_out=recordings[count:], jobs=arguments.jobs, seed=arguments.seed, progress=progress, store=store,
            also=arguments.also,
        )  # fmt: skip


def _split(holdout: Sequence[float | Path]) -> tuple[float, list[Path]]:
    """Share and bags of ``--holdout``."""
    shares = [item for item in holdout if isinstance(item, float)]
    bags = [item for item in holdout if isinstance(item, Path)]
    if len(shares) > 1 or (shares and bags):
        raise BadInput("--holdout: expected one share, or recordings, not several shares or both")
    return (shares[0] if shares else _SHARE), bags


main = common.command(parser, _run)
