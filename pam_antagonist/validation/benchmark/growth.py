"""How processor time and memory of the offline commands grow with the data."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from pathlib import Path

from pam_antagonist.validation.benchmark.figure import Figure, at_most
from pam_antagonist.validation.benchmark.spent import Spent, spent, spent_on

_COMMANDS = ("replay", "identify", "close_loop")
_MEMORY = 4.0
"""[GB] Half an hour is to fit into it."""


def measure(rig: str, minutes: Sequence[int], recordings: Sequence[int]) -> list[Figure]:
    """Each command over a free and a locked recording of each length, then over some numbers of recordings of a minute.

    Each figure is how often the command's processor time has doubled where the data have doubled: the exponent between
    the two sizes, 1 where it grows as the data do.

    Args:
        rig: name or path.
        minutes: lengths of the recordings [min], increasing.
        recordings: how many of them, increasing.

    Raises:
        BadInput: a command failed.
    """
    figures = []
    with tempfile.TemporaryDirectory(prefix="pam_benchmark_") as name:
        folder = Path(name)
        lengths = {length: [recorded(rig, folder, length, seed) for seed in (1, 2)] for length in minutes}
        several = [recorded(rig, folder, 1, seed) for seed in range(1, max(recordings) + 1)]
        spent_on("close_loop", several[:2], rig, folder / "first")
        for command in _COMMANDS:
            by_length = {
                length: spent_on(
                    command, bags[:1] if command == "replay" else bags, rig, folder / f"{command}_{length}"
                )
                for length, bags in lengths.items()
            }
            figures += _growth(command, "minutes", by_length)
            if command != "replay":
                by_number = {
                    count: spent_on(command, several[:count], rig, folder / f"{command}_of_{count}")
                    for count in recordings
                }
                figures += _growth(command, "recordings", by_number)
    return figures


def recorded(rig: str, folder: Path, minutes: int, seed: int) -> Path:
    """A simulated recording, every other one of a locked joint, all of one rig.

    Args:
        rig: name or path.
        folder: where it is written, if it is not there.
        minutes: its length [min].
        seed: of its noise and voltages; the joint is locked where it is even.
    """
    bag = folder / f"bag_{minutes}_{seed}"
    if not bag.exists():
        joint = "locked" if seed % 2 == 0 else "free"
        spent(
            "simulate", "--rig", rig, "--out", str(bag), "--duration", str(60 * minutes), "--profile", "steps",
            "--joint", joint, "--seed", str(seed),
        )  # fmt: skip
    return bag


def _growth(command: str, of: str, measured: dict[int, Spent]) -> list[Figure]:
    """The exponent between the smallest and the largest, and the memory of the largest."""
    small, large = min(measured), max(measured)
    parts = {f"cpu_s_{size}": run.cpu_s for size, run in measured.items()}
    memory = {f"peak_mb_{size}": run.peak_mb for size, run in measured.items()}
    figures = []
    if large > small:
        exponent = math.log(measured[large].cpu_s / measured[small].cpu_s) / math.log(large / small)
        meaning = f"exponent with which the processor time of {command} grows from {small} to {large} {of}"
        figures.append(at_most(f"{command}_by_{of}", meaning, exponent, 1.0, "", parts))
    meaning = f"most memory of {command} at {large} {of}"
    peak = max(memory.values()) / 1e3
    figures.append(at_most(f"{command}_memory_by_{of}", meaning, peak, _MEMORY, "GB", memory))
    return figures
