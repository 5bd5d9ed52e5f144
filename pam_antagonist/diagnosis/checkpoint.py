"""Finished candidates on disk, so that an interrupted diagnosis goes on where it was."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.point import Point

_SETTINGS = "settings.json"


@dataclass(frozen=True, eq=False)
class Kept:
    """A finished refit."""

    point: Point
    blocks_per_error: float  # what the fit counted, see :class:`~pam_antagonist.inference.likelihood.Scale`
    gain: float  # evidence for it after its first descent, which decides whether it is fitted from other starts


@dataclass(frozen=True)
class Checkpoint:
    """A folder with one small file for each refitted candidate; without a folder, nothing is kept."""

    folder: Path | None = None

    def claim(self, settings: Mapping[str, Any]) -> None:
        """Make the folder that of one run: of these recordings, this rig and these settings.

        `settings`: whatever a candidate depends on, as plain values; ``report.json`` holds them likewise.
        """
        if self.folder is None:
            return
        path = self.folder / _SETTINGS
        if path.is_file():
            try:
                earlier = json.loads(path.read_text(encoding="utf-8"))
            except ValueError:
                earlier = {}
            other = [name for name, value in settings.items() if earlier.get(name) != json.loads(json.dumps(value))]
            if other:
                raise BadInput(
                    f"{self.folder}: left by a run with another {other[0]}; expected the same recordings, rig and "
                    "settings to go on with, or remove it"
                )
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(dict(settings), indent=2) + "\n", encoding="utf-8")

    def finished(self) -> int:
        """How many refits are kept."""
        if self.folder is None or not self.folder.is_dir():
            return 0
        return sum(1 for path in self.folder.glob("*.json") if path.name != _SETTINGS)

    def load(self, key: str) -> Kept | None:
        """A finished refit, None where there is none that can be read."""
        if self.folder is None or not (self.folder / f"{key}.json").is_file():
            return None
        try:
            found = json.loads((self.folder / f"{key}.json").read_text(encoding="utf-8"))
            effects = {str(name): float(value) for name, value in found["effects"].items()}
            point = Point(np.array(found["theta"], dtype=np.float64), effects)
            return Kept(point, float(found["blocks_per_error"]), float(found["gain"]))
        except (ValueError, KeyError, TypeError, AttributeError):
            return None

    def save(self, key: str, kept: Kept) -> None:
        """Keep a finished refit."""
        if self.folder is None:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        point = kept.point
        content = {
            "theta": point.theta.tolist(),
            "effects": dict(point.effects),
            "blocks_per_error": kept.blocks_per_error,
            "gain": kept.gain,
        }
        partial = self.folder / f"{key}.part"
        partial.write_text(json.dumps(content), encoding="utf-8")
        partial.replace(self.folder / f"{key}.json")


def key_of(experiment: Experiment, parts: Sequence[str]) -> str:
    """Name of a refit: what was fitted, on what, from which model."""
    digest = hashlib.sha256()
    digest.update(np.ascontiguousarray(experiment.trial.measured).tobytes())
    digest.update(np.ascontiguousarray(experiment.trial.given).tobytes())
    digest.update(f"{experiment.rig!r} {experiment.fitted} {experiment.held_parts} {experiment.seed} ".encode())
    digest.update(f"{sorted(experiment.spans.items())} {experiment.span} ".encode())
    digest.update(f"{type(experiment).__name__} ".encode())
    digest.update(f"{experiment.trial.joint} {experiment.trial.lock_angle} {'/'.join(parts)}".encode())
    return digest.hexdigest()[:24]
