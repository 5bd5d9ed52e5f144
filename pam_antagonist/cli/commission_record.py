"""What of a commissioning is done: kept in its folder, so that the same command goes on."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

from pam_antagonist.errors import BadInput


class Record:
    """The steps of a commissioning that were tried, and the folders of their results.

    Attributes:
        steps: of each step by its name: whether it is ``done``, what it ``said``, and what else it found.
    """

    def __init__(self, out: Path, rig: str) -> None:
        self._out, self._rig = out, rig
        self.steps: dict[str, dict[str, Any]] = {}
        state = out / "state.json"
        if out.exists() and not state.exists():
            raise BadInput(f"{out}: exists, but commission did not write it; expected the name of a new folder")
        if state.exists():
            try:
                content = json.loads(state.read_text(encoding="utf-8"))
                begun_for, self.steps = content.get("rig"), dict(content["steps"])
            except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
                raise BadInput(f"{state}: cannot be read: {error}; expected what commission wrote") from None
            if begun_for != rig:
                raise BadInput(f"{out}: was begun with --rig {begun_for}, not {rig}; give that rig, or another --out")
        out.mkdir(parents=True, exist_ok=True)
        self.keep()

    def keep(self) -> None:
        """Write it. In one go: an interruption must not cost the steps that are done."""
        new = self._out / "state.json.new"
        new.write_text(json.dumps({"rig": self._rig, "steps": self.steps}, indent=1) + "\n", encoding="utf-8")
        new.replace(self._out / "state.json")

    def attempt(self, name: str) -> Path:
        """A new folder for an attempt of a step."""
        number = 1
        while (folder := self._out / f"{name}_{number}").exists():
            number += 1
        folder.mkdir()
        return folder

    def result(self, name: str) -> Path:
        """A result's folder, which is not there: what an attempt left that was interrupted is removed."""
        folder = self._out / name
        if folder.exists():
            shutil.rmtree(folder)
        return folder

    def bags(self) -> list[Path]:
        """The recordings of the steps."""
        return [self._out / step["bag"] for step in self.steps.values() if "bag" in step]
