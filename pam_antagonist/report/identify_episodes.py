"""The report of ``identify`` on a regulator-driven joint of many short episodes.

With it, what the report of ``close_loop`` on such a joint says as well: values in words, and remarks on units.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from typing_extensions import override

from pam_antagonist.identification.episode_filter import EpisodeFilter
from pam_antagonist.identification.episodes import EpisodesIdentified, is_fair
from pam_antagonist.identification.held_out import do_not_use
from pam_antagonist.identification.identified import ParameterEntry
from pam_antagonist.identification.regulators import RegulatorsFound
from pam_antagonist.inference.bootstrap import Interval
from pam_antagonist.inference.free_parameters import EFFECT_PARAMETERS
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.model.parameters import INDEX
from pam_antagonist.program import versions
from pam_antagonist.report.document import Document, Findings, Statement, Table, note, page, warn
from pam_antagonist.report.result import DataFrame, Result, frame_of
from pam_antagonist.report_keys import IDENTIFY, with_all_keys
from pam_antagonist.rig import Rig
from pam_antagonist.rig.file import write_rig, write_unread
from pam_antagonist.rig.units import assumption, readable, unit_of
from pam_antagonist.shown import MISSING, number, percent

_OTHER_SCALE = 0.03
"""Largest difference of a gain from 1; with more, commands and measured pressures are not on one scale."""
ABOUT = "A joint driven by pressure regulators, in many short recordings."
BY_SIGNAL = {
    "friction_by_signal": "friction that grows with",
    "load_by_signal": "a torque that depends on",
    "strength_by_signal": "strength of the muscles that depends on",
}


def interval(value: Interval | None, digits: int = 3) -> str:
    """A value with its interval, as text."""
    if value is None:
        return MISSING
    if not value.is_known:
        return f"{number(value.value, digits)} (not determined)"
    return f"{number(value.value, digits)} ({number(value.low, digits)} to {number(value.high, digits)})"


def times(factor: float, value: Interval) -> Interval:
    """An interval times a factor."""
    return Interval(*(factor * part for part in value))


def unit(rig: Rig, name: str) -> tuple[str, float]:
    """Unit in which a value is shown, and factor from the rig file's unit; torques may be per inertia."""
    per_inertia = rig.units.force == "per_inertia"
    lever, inertia = rig.geometry.radius, rig.joint.inertia
    if name.endswith("at the middle length"):
        return ("rad/s² a bar", 1e5 * lever / inertia) if per_inertia else ("cm²", 1e4)
    known = unit_of(rig, name)
    if known == "1/SI":
        return "% a bar", 1e7
    if not per_inertia:
        return readable(known).name, readable(known).scale
    by_inertia = {
        "N m/rad": ("1/s²", 1.0), "N m s/rad": ("1/s", 1.0), "N m": ("rad/s²", 1.0), "N m/Pa": ("rad/s² a bar", 1e5),
        "N m/SI": ("rad/s² a bar", 1e5), "N": ("rad/s²", lever),
    }  # fmt: skip
    shown, factor = by_inertia.get(known, (known, inertia))
    return shown, factor / inertia


def value_name(rig: Rig, name: str) -> str:
    """Name of a value in a report."""
    title, item = name.removeprefix("effects."), EFFECT_PARAMETERS.get(name)
    if item is None or item.signal is None:
        return title
    return f"{title.partition('.')[0]}, {list(rig.signals)[item.signal - 1]}"


def shown(rig: Rig, name: str, value: Interval, digits: int = 3) -> tuple[str, str, str]:
    """A number of the model as a report has it: its name, the value with its interval, and the unit."""
    written, factor = unit(rig, name)
    return value_name(rig, name), interval(times(factor, value), digits), written


def removes(value: Interval) -> str:
    """How much of the error an effect removes, in words."""
    low, high = percent(value.low), percent(value.high)
    return f"removes {percent(value.value)} of the squared error of unseen episodes ({low} to {high})"


def about_episodes(fitted: int, later: int, between: int) -> str:
    """How errors of episodes were computed, by the numbers of episodes."""
    return (
        f"Free runs of whole episodes from their first row; {fitted} episodes may be fitted, {later} later and "
        f"{between} interleaved ones are held out"
    )


def intervals_frame(values: Mapping[str, Interval]) -> DataFrame:
    """A row for each value: it, and its interval."""
    rows = [(name, *value) for name, value in values.items()]
    return frame_of(rows, ("value_of", "value", "low", "high"), "value_of")


def filter_notes(filtered: EpisodeFilter | None) -> tuple[Statement, ...]:
    """What the rig's filter does on later episodes."""
    return () if filtered is None else (note(filtered.sentence),)


def units_findings(joint: PressureDriven) -> tuple[Statement, ...]:
    """Findings about a rig that was fitted to the episodes before, unknown units, and episodes that were left out."""
    out, units = [], joint.rig.units
    if not is_fair(joint):
        out.append(warn(
            f"The comparison with the rig file as configured is not fair: the values of {joint.rig.name} are from this "
            "recording, so the error of that file may be one of a fit. Compare the files on another recording."
        ))  # fmt: skip
    if units.force == "per_inertia":
        out.append(note(
            "Forces are known per inertia only: torque, areas and stiffness are not known in their own units."
        ))  # fmt: skip
    if units.pressure == "unknown":
        out.append(note("The unit of the recorded pressures is not known: gain and offset in the rig file are assumed, "
                        "and so is every bar in this report."))  # fmt: skip
    if joint.left_out:
        out.append(warn(
            f"{joint.left_out} episodes are too short, or lack pressures, signals or the first angle: left out."
        ))  # fmt: skip
    return tuple(out)


def _errors(identified: EpisodesIdentified) -> Table:
    rows = tuple((name, interval(later), interval(between)) for name, (later, between) in identified.errors.items())
    header = ("RMSE of the angle [°], 95 % interval by episode", "later", "interleaved")
    return Table(header, rows, about_episodes(*identified.counts))


def regulators_table(regulators: RegulatorsFound, rig: Rig) -> Table:
    """Identified values of both regulators."""
    rows = []
    for name, value in regulators.values.items():
        row = (name.removeprefix("effects."), *shown(rig, name, value)[1:])
        if name.rpartition(".")[2].startswith("frequency"):
            row = (row[0], interval(times(0.5 / math.pi, value)), "Hz")
        rows.append(row)
    return Table(
        ("Value of the regulators", "95 % interval by episode", "Unit"), tuple(rows),
        "From commands to measured pressures, free runs of whole episodes with the joint's measured motion",
    )  # fmt: skip


def regulators_sentences(regulators: RegulatorsFound) -> tuple[str, ...]:
    """Findings about the regulators in sentences."""
    errors = " and ".join(number(1e-3 * value) for value in regulators.errors)
    commands = " and ".join(number(1e-3 * value) for value in regulators.command_errors)
    out = [
        f"On later episodes the regulators' pressures differ from the measured ones by {errors} kPa, the commands "
        f"themselves by {commands} kPa (RMS of muscle 1 and 2). The resonance is {number(regulators.resonance)}."
    ]
    for name in dict.fromkeys(item.name for item in regulators.tried):
        item = [one for one in regulators.tried if one.name == name][-1]
        assert item.removed is not None
        out.append(
            f"The {item.name} is {'identified' if item.taken else 'left as configured'}: freeing it "
            f"{removes(item.removed)}."
        )
    for k, gain in enumerate(regulators.gains, 1):
        if abs(gain - 1.0) > _OTHER_SCALE:
            out.append(
                f"Pressure {k} follows its command with a gain of {number(gain)}, the model has 1: expected both on "
                "one scale."
            )
    return tuple(out)


@dataclass(frozen=True, eq=False, repr=False)
class EpisodesIdentifyResult(Result):
    """A rig that was identified from episodes."""

    rig: Rig
    found: EpisodesIdentified  # the values with their intervals, and errors on whole held-out episodes
    joint: PressureDriven
    hashes: tuple[str, ...]  # SHA-256 of the recording, a tuple of one
    filtered: EpisodeFilter | None = None  # the rig's filter; None without commands

    @override
    def _brief(self) -> str:
        return f"rig {self.rig.name} from the episodes of {self.joint.name}"

    @property
    def rejected(self) -> str:
        """Why the identified rig should not be used, in a sentence; empty if it may."""
        return self.found.rejected

    @override
    def to_json(self) -> dict[str, Any]:
        start = self.found.start
        return with_all_keys(IDENTIFY, {
            "parameters": [
                ParameterEntry.of_interval(name, start, start.value(name), value)._asdict()
                for name, value in self.found.values.items()
                if name in INDEX
            ],
            "recordings": [{"name": self.joint.name, "sha256": value} for value in self.hashes],
            "warnings": [item.text for item in units_findings(self.joint) if item.status == "warn"],
            "settings": {"rig": start.name},
            "software": versions(),
            "assumption": assumption(start, identified=True),
            **self.found.to_json(),
            "filter": None if self.filtered is None else self.filtered.to_json(),
            "recordings_sha256": self.hashes,
            "rejected": self.rejected,
        })  # fmt: skip

    @override
    def document(self, figures: bool = True) -> Document:
        found = self.found
        later, between = (item.value for item in found.errors["identified"])
        before = found.errors["as configured"][0].value
        said = (
            f"Identified from {found.counts[0]} episodes: the error of the angle on later episodes is "
            f"{number(later)}°, on interleaved ones {number(between)}°; the rig file as configured errs by "
            f"{number(before)}° on the later ones."
        )
        remarks: list[Statement] = []
        if later > before and is_fair(self.joint):
            remarks.append(warn("On later episodes the rig as configured has the smaller error: the joint drifts, or "
                                "it moved too little to be identified."))  # fmt: skip
        if found.regulators is None:
            remarks.append(note("No commands were recorded: the regulators stay as configured."))
        else:
            remarks += map(note, regulators_sentences(found.regulators))
        rows = tuple(shown(found.rig, name, value) for name, value in found.values.items())
        values = Table(("Value", "95 % interval by episode", "Unit"), rows, "Identified values")
        tables = () if found.regulators is None else (regulators_table(found.regulators, found.rig),)
        return page(
            "Identified joint", self.joint.name,
            (
                Findings((*remarks, *units_findings(self.joint), *filter_notes(self.filtered))), _errors(found),
                values, *tables,
            ),
            "identify of episodes", [("Rig", found.start.name), ("Recording", self.hashes[0])], ABOUT,
            do_not_use(self.rejected) if self.rejected else said,
        )  # fmt: skip

    def to_dataframe(self) -> DataFrame:
        """A row for each identified value: the value and its 95 % interval by episode (needs pandas)."""
        regulators = {} if self.found.regulators is None else self.found.regulators.values
        return intervals_frame({**self.found.values, **regulators})

    @override
    def write_rigs(self, folder: Path) -> None:
        episodes = f"{self.found.counts[0]} episodes of {self.joint.name}."
        remark = f"By pam_antagonist identify, from rig {self.found.start.name} and {episodes}"
        if self.rejected:
            write_unread(self.rig, folder / "rig_rejected.yaml", [remark, self.rejected])
        else:
            write_rig(self.rig, folder / "rig.yaml", [remark])
