"""CSV files and maps for the tests, written as a lab would write them."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml

from pam_antagonist.errors import BadInput
from pam_antagonist.recording import Recording
from pam_antagonist.recording.csv_import import read_csv
from pam_antagonist.recording.csv_map import load_map

MAP: dict[str, Any] = {
    "time": {"column": "t", "unit": "s"},
    "pressure_1": {"column": "p1", "unit": "kPa", "reference": "absolute"},
    "pressure_2": {"column": "p2", "unit": "kPa", "reference": "absolute"},
    "valve_1": {"column": "u1", "unit": "V"},
    "valve_2": {"column": "u2", "unit": "V"},
}
HEADER = ("t", "p1", "p2", "u1", "u2")
ROWS = ((0.0, 300, 500, 4.5, 5.5), (0.01, 310, 490, 4.6, 5.4), (0.02, 320, 480, 4.7, 5.3), (0.03, 330, 470, 4.8, 5.2))


class Lab:
    """A folder with one CSV file and its map."""

    def __init__(self, folder: Path) -> None:
        self.csv, self.map = folder / "trial.csv", folder / "map.yaml"
        self.text(table(HEADER, ROWS))
        self.entries()

    def text(self, text: str, encoding: str = "utf-8") -> Lab:
        """Write the CSV file as it is."""
        self.csv.write_bytes(text.encode(encoding))
        return self

    def rows(self, rows: Iterable[Sequence[Any]], header: Sequence[str] = HEADER) -> Lab:
        """Write the CSV file with commas."""
        return self.text(table(header, rows))

    def entries(self, **changes: Any) -> Lab:
        """Write the map: entries are laid over those of ``MAP``, None removes one."""
        content = copy.deepcopy(MAP)
        for name, entry in changes.items():
            if entry is None:
                content.pop(name, None)
            else:
                content[name] = dict(entry) if isinstance(entry, Mapping) else entry
        self.map.write_text(yaml.safe_dump(content, allow_unicode=True), encoding="utf-8")
        return self

    def read(self) -> Recording:
        return read_csv(self.csv, load_map(self.map))

    def refusal(self) -> str:
        """What is said instead of reading: one line that names the file it is about."""
        with pytest.raises(BadInput) as caught:
            self.read()
        text = str(caught.value)
        assert "\n" not in text
        assert str(self.csv) in text or str(self.map) in text
        return text


def table(header: Sequence[str], rows: Iterable[Sequence[Any]], delimiter: str = ",") -> str:
    return "".join(delimiter.join(map(str, row)) + "\n" for row in (header, *rows))
