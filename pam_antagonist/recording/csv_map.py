"""Map of a CSV file's columns: a YAML file, checked."""

# pydantic 1 evaluates annotations on Python 3.10
# ruff: noqa: UP006, UP007, UP035, UP045

from __future__ import annotations

import codecs
import contextlib
import difflib
import re
from collections.abc import Iterator, Mapping
from datetime import datetime, timezone
from pathlib import Path
from typing import Dict, Literal, Optional, Tuple, Union

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, StrictFloat, StrictInt, StrictStr

from ..errors import BadInput
from ..paths import config_dir
from ..program import typed
from ..strict_yaml import Strict, read_mapping, validated
from .plausible import STANDARD_ATMOSPHERE, UNITS, Signal, canonical
from .topics import ALSO

Floats = NDArray[np.float64]
Name = Union[StrictInt, StrictStr]
Delimiter = Literal[",", ";", "|", "\t", "tab", "space"]
_SWITCHES = ("header", "sealed")
_LOWEST_ATMOSPHERE, _HIGHEST_ATMOSPHERE = 50e3, 120e3  # [Pa], as in rigs
_FIRST_DATE, _LAST_DATE = 946_684_800_000_000_000, 2_145_916_799_000_000_000  # [ns] 2000 to 2037
QUANTITIES = {
    "time": "time", "atmosphere": "pressure", "pressure_1": "pressure", "pressure_2": "pressure",
    "valve_1": "voltage", "valve_2": "voltage", "command_1": "pressure", "command_2": "pressure",
    "angle": "angle", "torque": "torque", "external_torque": "torque",
}  # fmt: skip
"""Entry of a map -> the quantity in ``UNITS`` that its unit belongs to."""
EXAMPLE = "example"
"""Name of the example map, whose comments explain all entries."""


class Layout(Strict):
    """How the file is written."""

    delimiter: Delimiter = Field(default=",", description="what stands between two cells")
    decimal: Literal[".", ","] = Field(default=".", description="what stands before the decimals")
    header: bool = Field(default=True, description="whether the first line names the columns")
    skip_lines: int = Field(default=0, ge=0, le=10_000, description="lines before the header")
    skip_after_header: int = Field(default=0, ge=0, le=10_000, description="lines between the header and the first row")
    comment: Optional[str] = Field(
        default="#",
        min_length=1,
        max_length=10,
        description="character with which comment lines begin, which are left out, or null",
    )
    encoding: str = Field(default="utf-8", description="how characters are encoded")
    missing: Tuple[Union[Name, StrictFloat], ...] = Field(default=(), description="cells that mean no value")

    @property
    def mark(self) -> str:
        """The character between two cells."""
        return {"tab": "\t", "space": " "}.get(self.delimiter, self.delimiter)


class Time(Strict):
    """A column, or a rate."""

    column: Optional[Name] = Field(None, description="name of the column, or its number from 1")
    unit: Optional[str] = Field(None, description="unit of that column")
    date: Optional[str] = Field(
        None, description="day, or day and time, of the first row, where the column does not count from 1970"
    )
    rate: Optional[float] = Field(None, ge=2.0, le=50_000.0, description="rows a second, without a column [Hz]")
    resample: Optional[float] = Field(
        None, ge=2.0, le=50_000.0, description="rate of an even grid to put the rows on [Hz]"
    )
    begin: float = Field(0.0, ge=0.0, description="seconds at the beginning that are left out")
    end: Optional[float] = Field(
        None, gt=0.0, description="seconds after the first row from which on all rows are left out"
    )
    out_of_order: Literal["refuse", "drop"] = Field(
        "refuse", description="what to do about rows that are not later than those before them"
    )

    @property
    def date_ns(self) -> Optional[int]:
        """Stamp of the date [ns]; None without one. A time without a zone is UTC."""
        if self.date is None:
            return None
        when = datetime.fromisoformat(self.date)
        return round((when if when.tzinfo else when.replace(tzinfo=timezone.utc)).timestamp()) * 1_000_000_000


class Column(Strict):
    """A column with a number in it: value = scale * cell + offset, in the unit."""

    column: Name = Field(description="name of the column, or its number from 1")
    unit: str = Field(description="unit of scale * cell + offset")
    scale: float = Field(1.0, description="factor, before the unit; -1 turns the sign")
    offset: float = Field(0.0, description="what is added after the factor, in the unit")


class Angle(Column):
    """An encoder."""

    wraps: Optional[float] = Field(
        None, gt=0.0, description="of an absolute encoder: after how much it begins again, in the unit, such as 360"
    )


class Pressure(Column):
    """A muscle's pressure."""

    reference: Literal["gauge", "absolute"] = Field(description="whether 0 is the atmosphere or the vacuum")


class Asked(Pressure):
    """What a pressure regulator was asked for."""

    holds: Literal["until_row", "from_row"] = Field(
        "until_row", description="whether a row's command held up to the row's time, or from then on"
    )


class Further(Column):
    """A signal beside the joint's own: another joint's pressure or angle, a temperature."""

    reference: Optional[Literal["gauge", "absolute"]] = Field(
        None, description="of a pressure: whether 0 is the atmosphere or the vacuum"
    )

    @property
    def quantity(self) -> str:
        """The quantity in ``UNITS`` that the unit belongs to; empty where a bag cannot hold such a signal."""
        return next((name for name in ("pressure", "angle", "temperature") if self.unit in UNITS[name]), "")


class StatedAtmosphere(Strict):
    """What a gauge pressure counts from."""

    pressure: float = Field(description="absolute pressure of the surroundings, in the unit")
    unit: str


class ValveColumn(Strict):
    """A column, or one voltage for the whole file; ``sealed`` says that no air passes."""

    column: Optional[Name] = Field(None, description="name of the column, or its number from 1")
    constant: Optional[float] = Field(None, description="constant voltage, in the unit")
    sealed: bool = Field(False, description="whether the chamber is closed, so that no air passes")
    unit: str
    scale: float = Field(1.0, description="factor, before the unit")
    offset: float = Field(0.0, description="what is added after the factor, in the unit")
    holds: Literal["until_row", "from_row"] = Field(
        "until_row", description="whether a row's voltage was on the valve up to the row's time, or from then on"
    )


class CsvMap(Strict):
    """The columns of one kind of CSV file. Read one with :func:`load_map`."""

    file: Layout = Layout()
    time: Time
    atmosphere: Optional[StatedAtmosphere] = None
    pressure_1: Pressure
    pressure_2: Pressure
    valve_1: Optional[ValveColumn] = None
    valve_2: Optional[ValveColumn] = None
    drive: Literal["valve", "regulator"] = Field(
        "valve", description="what drove the joint: valves by a voltage, or pressure regulators"
    )
    command_1: Optional[Asked] = None
    command_2: Optional[Asked] = None
    episode: Optional[Name] = Field(
        None, description="column that changes where an episode begins, before which nothing is known"
    )
    also: Dict[str, Further] = Field({}, description="further signals, by name")
    angle: Optional[Angle] = None
    torque: Optional[Column] = None
    external_torque: Optional[Column] = None

    @property
    def valves(self) -> tuple[ValveColumn, ValveColumn]:
        """Both valves; for a joint with pressure regulators constant placeholders of 0 V."""
        none = ValveColumn(column=None, constant=0.0, sealed=False, unit="V", scale=1.0, offset=0.0, holds="until_row")
        return self.valve_1 or none, self.valve_2 or none

    @property
    def sealed(self) -> tuple[int, ...]:
        """Numbers of the muscles whose chambers are sealed."""
        return tuple(number for number, valve in enumerate(self.valves, 1) if valve.sealed)

    def measured(self) -> dict[str, Column]:
        """The columns of the validation signals in the map: angle, torque, external_torque."""
        known = {"angle": self.angle, "torque": self.torque, "external_torque": self.external_torque}
        return {name: column for name, column in known.items() if column is not None}

    def entries(self) -> dict[str, Column | ValveColumn]:
        """Quantity -> entry with a unit and a scale, for all that the map has but time and atmosphere."""
        names = ("pressure_1", "pressure_2", "valve_1", "valve_2", "command_1", "command_2", *self.measured())
        known = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        return known | {f"{ALSO}{name}": entry for name, entry in self.also.items()}

    def columns(self) -> dict[str, Name]:
        """Quantity -> column, for everything that is read from the file."""
        given = {"time": self.time.column, **{name: entry.column for name, entry in self.entries().items()}}
        found = {name: column for name, column in given.items() if column is not None}
        return found if self.episode is None else found | {"episode": self.episode}

    def holds_on(self, name: str) -> bool:
        """Whether a row's command held from the row on."""
        return getattr(self.entries()[name], "holds", "until_row") == "from_row"

    def signal(self, name: str, label: str, values: Floats) -> Signal:
        """Numbers of an entry, with its unit."""
        entry = self.entries()[name]
        quantity = entry.quantity if isinstance(entry, Further) else QUANTITIES[name]
        reference, air = getattr(entry, "reference", None) or "absolute", self.atmosphere
        # Without gauge pressures the atmosphere is only needed to judge.
        atmosphere = STANDARD_ATMOSPHERE if air is None else air.pressure * UNITS["pressure"][air.unit]
        return Signal(label, quantity, values, entry.unit, reference, atmosphere, mapped=True, stated=air is not None)


def map_names() -> list[str]:
    """Names of the maps that come with the package, without the example."""
    return sorted(path.stem for path in (config_dir() / "maps").glob("*.yaml") if path.stem != EXAMPLE)


def example_text() -> str:
    """Text of the example map, with comments on all entries."""
    return (config_dir() / "maps" / f"{EXAMPLE}.yaml").read_text(encoding="utf-8")


def load_map(name_or_path: str | Path) -> CsvMap:
    """Read and check a map.

    `name_or_path`: the path of a YAML file, or the name of one in ``config/maps`` (``sealed_joint``).
    """
    path = _locate(str(name_or_path))
    content = read_mapping(path, "map", typed("import_csv --example"))
    found = _in_known_units(str(path), validated(CsvMap, content, str(path), _SWITCHES))
    for complaint in _contradictions(found):
        raise BadInput(f"{path}: {complaint}")
    return found


def _locate(name: str) -> Path:
    path = Path(name)
    if path.suffix in (".yaml", ".yml"):
        return path
    if name not in map_names():
        close = difflib.get_close_matches(name, map_names(), 1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        raise BadInput(f"unknown map {name!r}: expected a .yaml file or one of {', '.join(map_names())}{hint}")
    return config_dir() / "maps" / f"{name}.yaml"


def _contradictions(mapping: CsvMap) -> Iterator[str]:
    """Contradictions between entries, which the schema cannot check."""
    regulated = mapping.drive == "regulator"
    yield from _time_contradictions(mapping.time, mapping.episode is not None)
    for name, valve in (("valve_1", mapping.valve_1), ("valve_2", mapping.valve_2)):
        if regulated and valve is not None:
            yield f"{name} is given, but the joint has pressure regulators (drive: regulator): expected no valves"
        elif valve is not None:
            yield from _valve_contradictions(name, valve)
        elif not regulated:
            yield f"{name} is missing; for a joint with pressure regulators in place of valves, give drive: regulator"
    yield from _further_contradictions(mapping.also)
    entries = mapping.entries()
    for name, one in entries.items():
        if one.scale == 0.0:
            yield f"{name.replace('/', '.')}.scale is 0: expected the factor between cells and values"
    if (mapping.command_1 is None) != (mapping.command_2 is None):
        yield "command_1 and command_2: expected both, or neither"
    if mapping.command_1 is not None and not regulated:
        yield "command_1 is given, but the joint has valves; for pressure regulators give drive: regulator"
    gauges = [name.replace("/", ".") for name, one in entries.items() if getattr(one, "reference", None) == "gauge"]
    if gauges and mapping.atmosphere is None:
        yield (
            f"atmosphere is missing: {gauges[0]} is gauge pressure, and bags hold absolute pressure; write "
            "atmosphere: {pressure: 101.325, unit: kPa}, or what a barometer shows"
        )
    yield from _columns_twice(mapping)
    yield from _file_contradictions(mapping)
    if (air := mapping.atmosphere) is not None:
        pascal = air.pressure * UNITS["pressure"][air.unit]
        if not _LOWEST_ATMOSPHERE <= pascal <= _HIGHEST_ATMOSPHERE:
            yield (
                f"atmosphere.pressure is {air.pressure:g} {air.unit} = {pascal:g} Pa, expected {_LOWEST_ATMOSPHERE:g} "
                f"to {_HIGHEST_ATMOSPHERE:g} Pa absolute; at sea level it is 101325 Pa"
            )


def _time_contradictions(time: Time, has_episodes: bool) -> Iterator[str]:
    if (time.column is None) == (time.rate is None):
        yield "time: expected either column (with its unit) or rate"
    if time.column is not None and time.unit is None:
        yield f"time.unit is missing: expected one of {', '.join(UNITS['time'])}"
    try:
        stamp_ns = time.date_ns
    except ValueError:
        stamp_ns = 0
    if stamp_ns is not None and not _FIRST_DATE <= stamp_ns <= _LAST_DATE:
        yield f"time.date is {time.date!r}: expected a day such as 2026-11-28, or 2026-11-28 14:30, from 2000 to 2037"
    if has_episodes and (time.resample is not None or time.begin or time.end is not None):
        yield "time: expected no resample, begin or end in a file of episodes"


def _further_contradictions(also: Mapping[str, Further]) -> Iterator[str]:
    for name, entry in also.items():
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
            yield f"also.{name}: expected a name of letters, digits and _ that begins with a letter"
        if (entry.reference is not None) != (entry.quantity == "pressure"):
            yield f"also.{name}.reference: expected gauge or absolute of a pressure, and of nothing else"


def _valve_contradictions(name: str, valve: ValveColumn) -> Iterator[str]:
    if valve.sealed and (valve.column is not None or valve.constant is None):
        yield (
            f"{name} is sealed: expected constant, the voltage to write for it (that at which the valve is "
            "closed, or 0 where there is no valve), and no column"
        )
    if (valve.column is None) == (valve.constant is None):
        yield f"{name}: expected either column or constant"
    if valve.constant is not None and (valve.scale, valve.offset, valve.holds) != (1.0, 0.0, "until_row"):
        yield f"{name} is constant: expected no scale, offset or holds"


def _file_contradictions(mapping: CsvMap) -> Iterator[str]:
    if not mapping.file.header:
        if mapping.file.skip_after_header:
            yield "file.skip_after_header is given, but the file has no header: expected file.skip_lines"
        for name, column in mapping.columns().items():
            if isinstance(column, str):
                yield f"{name}.column is {column!r}, but the file has no header: expected the column's number, from 1"
    try:
        codecs.lookup(mapping.file.encoding)
    except (LookupError, ValueError):  # ValueError: a name with a zero byte
        given = mapping.file.encoding[:40]
        yield f"file.encoding: unknown encoding {given!r}, expected such as utf-8, cp1252 or utf-16"


def _columns_twice(mapping: CsvMap) -> Iterator[str]:
    """Columns that two quantities name. One signal may drive both valves; anything else is a mistake."""
    seen: dict[Name, str] = {}
    for name, column in mapping.columns().items():
        if isinstance(column, int) and column < 1:
            yield f"{name}.column is {column}: columns are counted from 1"
        if column in seen and {name, seen[column]} != {"valve_1", "valve_2"}:
            yield f"{name} and {seen[column]} are the same column, {column!r}"
        seen[column] = name


def _in_known_units(path: str, mapping: CsvMap) -> CsvMap:
    """The same map with every unit spelt as in ``UNITS``."""
    changed = {}
    for name, quantity in QUANTITIES.items():
        entry = getattr(mapping, name)
        if entry is not None and entry.unit is not None:
            changed[name] = entry.replaced(unit=canonical(f"{path}: {name}.unit", quantity, entry.unit))
    further = {}
    for name, entry in mapping.also.items():
        spelt = {}
        for quantity in ("pressure", "angle", "temperature"):
            with contextlib.suppress(BadInput):
                spelt["unit"] = canonical(path, quantity, entry.unit)
        if not spelt:
            raise BadInput(
                f"{path}: also.{name}.unit: unknown unit {entry.unit[:40]!r}, expected one of a pressure, angle or degC"
            )
        further[name] = entry.replaced(**spelt)
    return mapping.replaced(**changed, also=further)
