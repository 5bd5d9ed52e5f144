"""What a command finds: one thing, which terminal, page, ``report.json`` and Python show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from pam_antagonist.errors import BadInput
from pam_antagonist.optional import needs
from pam_antagonist.paths import output_folder
from pam_antagonist.report import html, terminal
from pam_antagonist.report.document import Document, figures_of
from pam_antagonist.shown import Shown
from pam_antagonist.strict_json import plain

if TYPE_CHECKING:
    import pandas

DataFrame: TypeAlias = "pandas.DataFrame"
"""Of pandas, which is loaded where somebody asks for a table."""


class Result(Shown):
    """A result: its subclass says what ``report.json``, terminal and page show, and which rig files there are."""

    def to_json(self) -> Mapping[str, Any]:
        """The content of ``report.json``."""
        raise NotImplementedError

    def document(self, figures: bool = True) -> Document:
        """What a page shows, and in short a terminal; False leaves the figures out."""
        raise NotImplementedError

    def write_rigs(self, folder: Path) -> None:
        """Write the rig files of the result, if it has any, into a folder that exists."""

    @cached_property
    def report(self) -> Any:
        """The content of ``report.json``, as numbers, texts, lists and dictionaries."""
        return plain(self.to_json())

    def summary(self) -> str:
        """The tables that the command prints."""
        return terminal.summary(self.document(figures=False))

    def save(self, path: str | Path, figures: bool = True, overwrite: bool = False) -> Path:
        """Write ``report.html``, ``report.json``, and the rig files that the command writes.

        Args:
            path: of a new folder.
            figures: False leaves the figures out of the page.
            overwrite: True replaces an earlier result there.

        Returns:
            The folder.

        Raises:
            BadInput: the folder exists, or cannot be written.
        """
        with output_folder(Path(path), overwrite=overwrite) as folder:
            self.write_rigs(folder)
            self.write(folder, figures)
        return Path(path)

    def write(self, folder: Path, figures: bool = True) -> None:
        """Write ``report.html`` and ``report.json`` into a folder that exists."""
        html.write(folder, self.document(figures), self.to_json())

    def plot(self, number: int = 0) -> Any:
        """A figure of the page as a ``plotly.graph_objects.Figure``, which a notebook shows (needs plotly).

        Args:
            number: of the figure on the page, from 0.

        Raises:
            BadInput: the page has no such figure.
        """
        figures = list(figures_of(self.document().blocks))
        if not 0 <= number < len(figures):
            has = f"{len(figures)} figures, expected 0 to {len(figures) - 1}" if figures else "no figure"
            raise BadInput(f"number {number!r}: this result has {has}")
        with needs("reports", "plot()"):
            from plotly.graph_objects import Figure as Plot
        plot = html.plot(figures[number])
        plot["layout"]["title"] = {"text": figures[number].title}
        return Plot(plot, skip_invalid=True)


def frame_of(rows: Any, columns: Sequence[str] | None = None, index: str = "") -> DataFrame:
    """A table of values for Python (needs pandas)."""
    with needs("import", "a data frame"):
        import pandas as pd
    frame = pd.DataFrame(rows, columns=columns)
    return frame.set_index(index) if index else frame
