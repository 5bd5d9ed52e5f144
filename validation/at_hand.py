"""The recordings at hand, which other people or other simulators made: what a laboratory knows of each, and types.

They are no part of this package; ``folder`` is the one that holds ``rig_a``, ``rig_a_lab``, ``strangers`` and
``measured``. Files that are no bags are imported by the commands that a user would type.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pam_antagonist.cli import import_csv, new_rig
from pam_antagonist.errors import BadInput
from pam_antagonist.strict_yaml import load_bounded

STRANGERS = ("wrist", "elbow", "bench")
ARM_SIGNALS = ("joint1_p1", "joint1_p2")
"""The next joint's pressures."""


@dataclass(frozen=True)
class Joint:
    """Recordings of one joint."""

    name: str  # of the case
    rig: str  # name or file of the rig as its laboratory describes it
    recordings: tuple[Path, ...]  # bags that may be fitted
    held_out: tuple[Path, ...] = ()  # bags that are kept to judge by; none where the end of each recording is
    also: tuple[str, ...] = ()  # further signals that may be causes
    # verdict and effects that the recordings' authors expect; None where nobody knows
    truth: tuple[str, ...] | None = None


_RIG_A: dict[str, tuple[str, ...]] = {
    "rig_a/nominal": (),
    "rig_a/case_hysteresis": ("hysteresis",),
    "rig_a/case_leak": ("leak",),
    "rig_a/case_valve_offset": ("valve_offset",),
    "rig_a/case_creep": ("creep",),
    "rig_a/case_other": ("exchange",),
    "rig_a_lab/stribeck": ("friction",),
    "rig_a_lab/supply_droop": ("supply_droop",),
    "rig_a_lab/warm_up": ("warm_up",),
    "rig_a_lab/encoder_zero": (),
    "rig_a_lab/measured_late": (),
    "rig_a_lab/leak_250hz": ("leak",),
    "rig_a_lab/valve_play": ("valve_play",),
    "rig_a_lab/late_leak": ("leak",),
    "rig_a_lab/leak_and_creep": ("leak", "creep"),
    "rig_a_lab/two_rigs": ("friction",),
}
"""Pairs of rig A, free and locked, and what is in them; an exchange of air is in no catalogue."""
_STRANGE = {"wrist": ("hysteresis",), "elbow": ("supply_droop",), "bench": ("hysteresis",)}
NAMES = (*_RIG_A, *(f"strangers/{name}" for name in STRANGERS), "measured/sealed_joint", "measured/pamy_joint0")


def joint(name: str, folder: Path, scratch: Path) -> Joint:
    """A joint of ``NAMES``, its files imported into a scratch folder."""
    if not (folder / name).is_dir():
        raise BadInput(f"{folder / name}: not found; expected the folder of the recordings at hand before /{name}")
    if name in _RIG_A:
        return Joint(name, "shin2022", (folder / name / "free", folder / name / "locked"), truth=_RIG_A[name])
    kind = Path(name).name
    if name.startswith("strangers/"):
        return _stranger(kind, folder / name, scratch)
    _typed(import_csv.main, [str(folder / name / f"{kind}.csv"), "--map", kind, "--out", str(scratch / kind)])
    if kind == "sealed_joint":
        return Joint(name, kind, (scratch / kind,))
    return Joint(name, "regulator_joint", (scratch / kind,), also=ARM_SIGNALS)


def _stranger(kind: str, folder: Path, scratch: Path) -> Joint:
    knows = load_bounded((folder / "knows.yaml").read_text(encoding="utf-8"))
    rig = scratch / f"{kind}.yaml"
    _typed(new_rig.main, ["--out", str(rig), *(str(word) for word in knows["new_rig"])])
    bags: dict[str, list[Path]] = {"fit": [], "held_out": []}
    for file, entry in knows["recordings"].items():
        if entry["use"] in bags:
            bag = scratch / Path(file).stem
            _typed(import_csv.main, [str(folder / file), "--map", str(folder / entry["map"]), "--out", str(bag)])
            bags[entry["use"]].append(bag)
    return Joint(f"strangers/{kind}", str(rig), tuple(bags["fit"]), tuple(bags["held_out"]), truth=_STRANGE[kind])


def _typed(command: object, words: Sequence[str]) -> None:
    said = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
        status = command(list(words))  # type: ignore[operator]
    if status:
        raise BadInput(said.getvalue().strip().splitlines()[-1].removeprefix("error: "))
