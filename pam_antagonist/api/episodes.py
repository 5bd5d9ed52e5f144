"""Results of ``identify`` and ``diagnose`` for a joint with pressure regulators in many short episodes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typing_extensions import override

from pam_antagonist.diagnosis.episodes import EpisodeDiagnosis
from pam_antagonist.diagnosis.episodes import diagnose as _diagnose
from pam_antagonist.errors import BadInput
from pam_antagonist.identification.episodes import EpisodesIdentified
from pam_antagonist.identification.episodes import identify as _identify
from pam_antagonist.inference.bootstrap import Interval
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.optional import needs
from pam_antagonist.output import output_folder
from pam_antagonist.recording import Recording, bag_name, recording_hash
from pam_antagonist.report import episodes as diagnosis_report
from pam_antagonist.report import html, terminal
from pam_antagonist.report import identify_episodes as identify_report
from pam_antagonist.rig import Rig
from pam_antagonist.rig.load import write_rig, write_unread
from pam_antagonist.shown import Shown

if TYPE_CHECKING:
    from pandas import DataFrame

Progress = Callable[[str], None] | None


def are_given(recordings: Sequence[Recording], rig: Rig) -> bool:
    """Whether these are many short episodes of a joint with pressure regulators."""
    return rig.drive == "regulator" and any(one.episode_ns is not None for one in recordings)


@dataclass(frozen=True, eq=False, repr=False)
class EpisodesIdentifyResult(Shown):
    """A rig that was identified from episodes.

    Attributes:
        found: the values with their intervals, and errors on whole held-out episodes.
        hashes: SHA-256 of the recording, a tuple of one.
    """

    rig: Rig
    found: EpisodesIdentified
    joint: PressureDriven
    hashes: tuple[str, ...]

    @override
    def _brief(self) -> str:
        return f"rig {self.rig.name} from the episodes of {self.joint.name}"

    @property
    def report(self) -> Mapping[str, Any]:
        """The numbers of ``report.json``."""
        return identify_report.numbers(self.found, self.hashes[0])

    @property
    def rejected(self) -> str:
        """Why the identified rig should not be used, in a sentence; empty if it may."""
        return identify_report.rejection(self.found)

    def summary(self) -> str:
        """The tables that the command prints."""
        return terminal.render(identify_report.summary(self.found, self.joint))

    def save(self, path: str | Path, figures: bool = True, overwrite: bool = False) -> Path:
        """Write ``rig.yaml``, ``report.html`` and ``report.json``; a rejected rig as ``rig_rejected.yaml``."""
        remark = f"By pam_antagonist identify, from rig {self.found.start.name} and {self.found.counts[0]} episodes of "
        with output_folder(Path(path), overwrite=overwrite) as folder:
            html.write(folder, identify_report.document(self.found, self.joint, self.hashes[0]), self.report)
            if self.rejected:
                write_unread(self.rig, folder / "rig_rejected.yaml", [f"{remark}{self.joint.name}.", self.rejected])
            else:
                write_rig(self.rig, folder / "rig.yaml", [f"{remark}{self.joint.name}."])
        return Path(path)

    def to_dataframe(self) -> DataFrame:
        """A row for each identified value: the value and its 95 % interval by episode (needs pandas)."""
        regulators = {} if self.found.regulators is None else self.found.regulators.values
        return _table({**self.found.values, **regulators})


@dataclass(frozen=True, eq=False, repr=False)
class EpisodesDiagnoseResult(Shown):
    """Effects that the model of a joint lacks, from episodes.

    Attributes:
        found: effects, errors on whole held-out episodes, and the drift.
        hashes: SHA-256 of the recordings, a whole held-out one last.
    """

    found: EpisodeDiagnosis
    joint: PressureDriven
    hashes: tuple[str, ...]

    @override
    def _brief(self) -> str:
        return f"{self.joint.name}: {self.sentence}"

    @property
    def report(self) -> Mapping[str, Any]:
        """The numbers of ``report.json``."""
        return diagnosis_report.numbers(self.found, self.joint, self.hashes)

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the detected effects, each with its signal if there is one."""
        return self.found.effects

    @property
    def sentence(self) -> str:
        """The result in words."""
        return diagnosis_report.verdict(self.found)

    @property
    def next_rig(self) -> str | None:
        """Name of the rig file to use; None: keep the one that there is."""
        return "rig_extended.yaml" if self.found.is_better else None

    @property
    def rig_extended(self) -> Rig:
        """The rig with the effects, and the further signals that they need."""
        values = self.joint.values(self.found.model)
        rig = moved(self.joint.rig, values)
        last = max((int(path[-1]) for path in values if "_by_signal." in path), default=0)
        signals = dict(list(self.joint.rig.signals.items())[:last])
        source = f"extended by close_loop from {self.joint.name}; started from: {self.joint.rig.source}"
        return rig.replaced(name=f"{self.joint.rig.name}_extended", source=source, signals=signals)

    def summary(self) -> str:
        """The tables that the command prints."""
        return terminal.render(diagnosis_report.summary(self.found, self.joint))

    def save(self, path: str | Path, figures: bool = True, overwrite: bool = False) -> Path:
        """Write ``report.html``, ``report.json`` and the extended rig (``rig_extended.yaml``), if it is better."""
        about = f"By pam_antagonist close_loop, from rig {self.joint.rig.name}. {self.sentence}"
        with output_folder(Path(path), overwrite=overwrite) as folder:
            html.write(
                folder, diagnosis_report.document(self.found, self.joint, self.hashes, figures), self.report
            )  # fmt: skip
            if self.next_rig is not None:
                write_rig(self.rig_extended, folder / self.next_rig, [about])
        return Path(path)

    def to_dataframe(self) -> DataFrame:
        """A row for each number of the extended model: its value and 95 % interval by episode (needs pandas)."""
        return _table(self.found.values)


def identified(
    recordings: Sequence[Recording], rig: Rig, free: Sequence[str], holdout: float, jobs: int, progress: Progress
) -> EpisodesIdentifyResult:
    """Identify mechanics and regulators.

    Args:
        free: parameters that the caller chose to free or to hold; must be empty, because the choice is fixed.
    """
    if len(recordings) > 1:
        raise BadInput("several recordings, one of them with many episodes: expected the recording of episodes alone")
    if free:
        raise BadInput(f"{free[0]}: which parameters are fitted to episodes cannot be chosen; leave it out")
    joint = PressureDriven.of(recordings[0], rig, jobs=jobs)
    found = _identify(joint, holdout, progress or _silent)
    source = f"identified from {bag_name(recordings[0].path)}; started from: {rig.source.strip()}"
    named = found.rig.replaced(name=f"{rig.name}_identified", source=" ".join(source.split()))
    return EpisodesIdentifyResult(named, found, joint, (recording_hash(recordings[0]),))


def diagnosed(
    fitted: Sequence[Recording], kept: Sequence[Recording], rig: Rig, also: Sequence[str], holdout: float, jobs: int,
    progress: Progress,
) -> EpisodesDiagnoseResult:  # fmt: skip
    """Find the effects that the model lacks.

    Args:
        holdout: share of the episodes that is held out at the end, if no recording is held out.
    """
    if len(fitted) > 1 or len(kept) > 1:
        raise BadInput(f"rig {rig.name} has pressure regulators: expected one recording, and one to hold out at most")
    first = PressureDriven.of(fitted[0], rig, also, jobs)
    later = PressureDriven.of(kept[0], first.rig, jobs=jobs) if kept else None
    found = _diagnose(first, holdout, later, progress or _silent)
    return EpisodesDiagnoseResult(found, first, tuple(recording_hash(one) for one in (*fitted, *kept)))


def _silent(_text: str) -> None:
    """Ignore progress."""


def _table(values: Mapping[str, Interval]) -> DataFrame:
    with needs("import", "a data frame"):
        import pandas as pd
    rows = [(name, *value) for name, value in values.items()]
    return pd.DataFrame(rows, columns=["value_of", "value", "low", "high"]).set_index("value_of")
