"""``import_csv``: a lab's file as a recording: CSV, MATLAB, numpy or Parquet."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pam_antagonist.paths import output_folder
from pam_antagonist.recording import Recording, write_bag
from pam_antagonist.recording.csv_import import notes, read_csv
from pam_antagonist.recording.csv_map import load_map
from pam_antagonist.recording.notes import issues_note, write_notes

_READING = 0.25
"""Share of the time of an import that reading text takes; the rest is writing the bag."""


def import_csv(
    file: str | Path, map: str | Path, out: str | Path | None = None, progress: Callable[[float], object] | None = None
) -> Recording:
    """Read a file with columns as a recording, as the command ``import_csv`` does.

    Args:
        file: CSV text, MATLAB, numpy or Parquet.
        map: a YAML file that says which column is what, or the name of a map of the package.
        out: folder of a new bag; None: no bag is written.
        progress: called with the share of the work that was done since the last call (0 to 1).

    Returns:
        The recording.

    Raises:
        BadInput: a file or a map that cannot be read, or values that are implausible in their unit.

    Example:
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> from pam_antagonist import import_csv
        >>> bars = "unit: bar, reference: absolute"
        >>> mapping = [
        ...     "time: {column: t, unit: s}",
        ...     *(f"pressure_{i}: {{column: p{i}, {bars}}}" for i in (1, 2)),
        ...     *(f"valve_{i}: {{column: u{i}, unit: V}}" for i in (1, 2)),
        ... ]
        >>> rows = ["t,p1,p2,u1,u2", *(f"{k / 100},4,{4 + k / 100},5,6" for k in range(50))]
        >>> with TemporaryDirectory() as folder:
        ...     _ = (Path(folder) / "map.yaml").write_text(chr(10).join(mapping))
        ...     _ = (Path(folder) / "trial.csv").write_text(chr(10).join(rows))
        ...     recording = import_csv(Path(folder) / "trial.csv", Path(folder) / "map.yaml")
        >>> len(recording)
        50
    """
    mapping, path = load_map(str(map)), Path(file)
    tell = progress or (lambda share: None)
    whole = path.stat().st_size if path.is_file() else 0
    reading = _READING if out is not None else 1.0
    recording = read_csv(path, mapping, progress=lambda size: tell(reading * size / whole))
    if out is not None:
        with output_folder(Path(out), make=False) as folder:
            write_bag(folder, recording, progress=lambda share: tell((1.0 - reading) * share))
            write_notes(folder, notes(path, mapping) | issues_note(recording.issues))
    return recording
