"""Results of ``diagnose`` for a rig whose muscles have the force of a data sheet."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typing_extensions import override

from pam_antagonist.diagnosis.from_pressures import FoundFromPressures, Tried
from pam_antagonist.diagnosis.from_pressures import diagnose as _diagnose
from pam_antagonist.identification.filter_stage import Given
from pam_antagonist.identification.from_pressures import is_for
from pam_antagonist.optional import needs
from pam_antagonist.output import output_folder
from pam_antagonist.recording import recording_hash
from pam_antagonist.report import close_loop_from_pressures as diagnosis_pages
from pam_antagonist.report import html, terminal
from pam_antagonist.rig import Rig
from pam_antagonist.rig.load import refusal, write_rig
from pam_antagonist.shown import Shown

__all__ = ["PressuresDiagnoseResult", "diagnosed", "is_for"]

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, eq=False, repr=False)
class PressuresDiagnoseResult(Shown):
    """An effect that the model of a rig lacks, from measured pressures.

    Attributes:
        hashes: SHA-256 of the recordings.
    """

    start: Rig
    found: FoundFromPressures
    hashes: tuple[str, ...]

    @override
    def _brief(self) -> str:
        return f"{self.verdict}; {self.sentence}"

    @property
    def verdict(self) -> str:
        """``effect``, ``none`` or ``unexplained``."""
        return self.found.verdict

    @property
    def sentence(self) -> str:
        """The result in words."""
        return diagnosis_pages.sentence(self.found)

    @property
    def effects(self) -> tuple[Tried, ...]:
        """The detected effects."""
        return self.found.taken

    @property
    def ambiguous_with(self) -> tuple[str, ...]:
        """Effects that the recordings cannot tell from the detected ones."""
        return self.found.ambiguous_with

    @property
    def next_rig(self) -> str | None:
        """Name of the rig file to use; None: keep the one that there is."""
        best = self.found.proposed
        if best is None or refusal(best.rig):
            return None
        return "rig_extended.yaml" if best is self.found.extended else "rig_recalibrated.yaml"

    @property
    def rig_extended(self) -> Rig:
        """The rig to use: with the effects, recalibrated, or as configured, whichever is best on held-out data."""
        best = self.found.proposed
        if best is None:
            return self.start
        names = ", ".join(name for name, _ in best.fitted)
        source = " ".join(f"extended by close_loop from {names}; started from: {self.start.source.strip()}".split())
        name = f"{self.start.name.removesuffix('_identified')}_extended"
        return best.rig.replaced(name=name, source=source, identified=names)

    @property
    def report(self) -> Mapping[str, Any]:
        """The numbers of ``report.json``."""
        return diagnosis_pages.numbers(self.found, self.hashes, self.next_rig)

    def summary(self) -> str:
        """The tables that the command prints."""
        return terminal.render(diagnosis_pages.summary(self.found))

    def save(self, path: str | Path, figures: bool = True, overwrite: bool = False) -> Path:
        """Write ``report.html``, ``report.json`` and the proposed rig file (:attr:`next_rig`), if there is one."""
        about = textwrap.wrap(f"By pam_antagonist close_loop, from rig {self.start.name}. {self.sentence}", 110)
        with output_folder(Path(path), overwrite=overwrite) as folder:
            html.write(folder, diagnosis_pages.document(self.found, self.hashes, figures), self.report)
            if self.next_rig is not None:
                write_rig(self.rig_extended, folder / self.next_rig, about)
        return Path(path)

    def to_dataframe(self) -> DataFrame:
        """A row for each parameter of each detected effect (needs pandas)."""
        with needs("import", "a data frame"):
            import pandas as pd
        rows = [
            (item.name, item.muscle, name, value, std, unit, item.delta_bic)
            for item in self.found.taken
            for name, (value, std, unit) in item.parameters.items()
        ]
        return pd.DataFrame(rows, columns=["effect", "muscle", "parameter", "value", "std", "unit", "delta_bic"])


def diagnosed(
    recordings: Sequence[Given],
    rig: Rig,
    holdout: float,
    seed: int,
    jobs: int,
    progress: Callable[[str], None] | None,
    whole: int = 0,
) -> PressuresDiagnoseResult:
    """Find the effect that the model of a rig lacks, from measured pressures.

    Args:
        rig: with forces of the form ``braided``.
        whole: number of recordings at the end that are held out as a whole, in place of the share.
    """
    found = _diagnose(recordings, rig, holdout, seed, jobs, progress, whole)
    return PressuresDiagnoseResult(rig, found, tuple(recording_hash(one) for one, _, _ in recordings))
