"""Convert a file with columns to a recording: a rosbag2 (MCAP) with the topics of a live joint for replay and identify.

The file is CSV text, MATLAB (.mat of both kinds), numpy (.npz) or Parquet.

A map, a short YAML file, says which column is what and in which unit; --example prints one that explains
itself. Pressures may be gauge or absolute, valves columns, constant or sealed. Values that are implausible in
their unit are refused with the unit that they look like. Missing cells stay missing.

examples:
  {run} import_csv --example > my_map.yaml          then change it to fit your file
  {run} import_csv trial_7.csv --map my_map.yaml --out trial_7
  {run} import_csv trial_8.mat --map my_map.yaml --out trial_8
  {run} import_csv data.mat --map sealed_joint_mat --out sealed
"""

from __future__ import annotations

import argparse
import re
import shlex
import textwrap
from pathlib import Path

import numpy as np

from pam_antagonist.api.import_csv import import_csv
from pam_antagonist.cli import common
from pam_antagonist.cli.progress import counted
from pam_antagonist.cli.recordings import span
from pam_antagonist.errors import BadInput
from pam_antagonist.program import typed
from pam_antagonist.recording import Recording
from pam_antagonist.recording.csv_map import CsvMap, example_text, load_map, map_names

_OF_A_RIG = re.compile(r"^(muscle_1|based_on):", re.MULTILINE)
_BEGIN, _MOST_FILES = 20_000, 50
"""Characters of a file in which an entry of a rig is looked for, and files of a folder that are looked at."""


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("import_csv", __doc__)
    out.option("file", "the file", Path, metavar="FILE", nargs="?")
    names = ", ".join(map_names())
    out.option("--map", f"a YAML file, or the name of a map of the package: {names}", metavar="MAP")
    out.option("--out", "folder of the bag; a new one", Path, metavar="BAG")
    out.flag("--example", "print a map that explains itself, and do nothing else")
    return out


def _main(arguments: argparse.Namespace) -> int:
    if arguments.example:
        print(example_text(), end="")
        return common.DONE
    _check_given(arguments)
    common.check_output(arguments.out)
    file, mapping = arguments.file, load_map(arguments.map)
    with counted(1.0, f"import {file.name}") as done:
        recording = import_csv(file, arguments.map, arguments.out, done)
    print(_summary(recording, mapping, arguments))
    return common.DONE


def _check_given(arguments: argparse.Namespace) -> None:
    given = {"FILE": arguments.file, "--map": arguments.map, "--out": arguments.out}
    missing = [name for name, value in given.items() if value is None]
    if missing:
        raise BadInput(
            f"{', '.join(missing)} missing (see {typed('import_csv --help')}; --example prints a map to begin with)"
        )


def _summary(recording: Recording, mapping: CsvMap, arguments: argparse.Namespace) -> str:
    pressure, voltage = recording.pressure, recording.voltage
    valves = [
        f"valve {number} {'sealed' if valve.sealed else span(voltage[:, number - 1], 1.0, 'V')}"
        for number, valve in enumerate(mapping.valves, 1)
        if mapping.drive == "valve"
    ]
    if recording.drive == "regulator":
        valves = [
            f"commanded pressure of regulator {n}: {span(voltage[:, n - 1], 1e-3, 'kPa')} absolute" for n in (1, 2)
        ]
    elif mapping.drive == "regulator":
        valves = ["pressure regulators: their commands are not in the file"]
    lines = [
        f"{arguments.out}: {len(recording)} samples, {recording.duration_s:.3f} s, one each "
        f"{recording.sample_period_s * 1e3:.4g} ms",
        f"  pressures {span(pressure[:, 0], 1e-3, 'kPa')} and {span(pressure[:, 1], 1e-3, 'kPa')} absolute",
        f"  {', '.join(valves)}",
        f"  angle {span(recording.angle, float(np.degrees(1.0)), 'deg')}, torque {span(recording.torque, 1.0, 'N m')}, "
        f"external torque {span(recording.external_torque, 1.0, 'N m')}",
    ]
    for name, signal in recording.signals.items():
        lines.append(f"  also {name}: {span(signal.values, 1.0, signal.unit)}")
    if recording.episode_ns is not None:
        lengths = [part.stop - part.start for part in recording.episodes]
        lines.append(f"  {len(lengths)} episodes of {min(lengths)} to {max(lengths)} samples")
    lines += [textwrap.fill(text, 100, initial_indent="! ", subsequent_indent="  ") for text in recording.issues]
    if mapping.sealed:
        lines.append(
            "the chambers of this joint are sealed: write valves: {sealed: true} into its rig file; the valve "
            "voltages in the bag have no meaning"
        )
    lines.append(common.next_command("check", [arguments.out], f"--rig {_rig_file(arguments.out)}"))
    return "\n".join(lines)


def _rig_file(bag: Path) -> str:
    """The one rig file here or beside a new bag, as it is typed; RIG where there are none or several."""
    found: dict[Path, Path] = {}
    for path in [file for folder in (Path(), bag.parent) for file in sorted(folder.glob("*.yaml"))[:_MOST_FILES]]:
        try:
            with path.open(encoding="utf-8", errors="replace") as stream:
                if _OF_A_RIG.search(stream.read(_BEGIN)):
                    found.setdefault(path.resolve(), path)
        except OSError:
            continue
    return shlex.quote(str(next(iter(found.values())))) if len(found) == 1 else "RIG"


main = common.command(parser, _main)
