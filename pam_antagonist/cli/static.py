"""``static``: volume and force map of a muscle from CSV tables, with error bars, as a rig file."""

from __future__ import annotations

import argparse
from pathlib import Path

from pam_antagonist.cli import common
from pam_antagonist.errors import BadInput
from pam_antagonist.identification.static import StaticResult, work_out
from pam_antagonist.identification.static_table import QUANTITIES, Choice, read_force_map, read_volumes
from pam_antagonist.model import parameters as par
from pam_antagonist.program import typed
from pam_antagonist.recording.plausible import STANDARD_ATMOSPHERE
from pam_antagonist.report import terminal
from pam_antagonist.report.static import summary, write_report
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.load import write_rig

_DESCRIPTION = """\
Fit a muscle's volume and force map to static measurements.

The table of --volume holds length and volume, that of --force-map length, pressure and force. Units stand in the
columns' names (length_mm, volume_cm3, pressure_kPa_gauge, force_N) or are given with --column; a pressure is gauge or
absolute.
A column force_std_N or volume_std_cm3 is the standard deviation of each value. A force of 0 means a slack muscle.

Writes DIR/rig.yaml (the given rig with the fitted coefficients, their standard deviations as priors for identify),
DIR/report.html and DIR/report.json. Status: 0 done, 2 bad input (one line says what and where).
"""
_EXAMPLES = """\
examples:
  {run} static --volume cylinder.csv --force-map map.csv --rig my_rig.yaml --out result
  {run} static --force-map left.csv --muscle 1 --form sarosi --rig my_rig.yaml --out result
  {run} static --force-map map.csv --column length=L:mm --column pressure=p:bar:gauge --rig my_rig.yaml --out result
  {run} static --force-map one_muscle.csv --out result --report-only
"""


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("static", _DESCRIPTION, _EXAMPLES)
    out.add_argument("--volume", type=Path, metavar="FILE", help="CSV of length and volume")
    out.add_argument("--force-map", type=Path, metavar="FILE", help="CSV of length, pressure and force")
    out.add_argument(
        "--muscle",
        choices=("1", "2", "both"),
        default="both",
        help="muscle that gets the fitted coefficients (default: both get the same)",
    )
    out.add_argument(
        "--rig",
        metavar="RIG",
        help="a YAML file, or the name of a rig of the package; may be left out with --report-only",
    )
    out.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder for the results; a new one")
    out.add_argument(
        "--form",
        choices=par.FORCE_FORMS,
        help="form of the force map in rig.yaml (default: the rig's, and braided for muscles of a data sheet)",
    )
    out.add_argument(
        "--column", action="append", default=[], type=_column, metavar="QUANTITY=NAME[:UNIT[:gauge|absolute]]",
        help=f"column of a quantity ({', '.join(QUANTITIES)}, force_std, volume_std) if its name does not give it",
    )  # fmt: skip
    out.add_argument(
        "--pressure",
        choices=("gauge", "absolute"),
        default="",
        help="what the pressures are, where the column's name does not say it",
    )
    out.add_argument(
        "--slack-below", type=_newton, default=0.0, metavar="N",
        help="largest force that means a slack muscle, for sensors whose zero wanders [N] (default: 0)",
    )  # fmt: skip
    out.add_argument(
        "--length",
        type=float,
        metavar="L_0",
        help="muscle length at angle 0 [m], in place of the rig's geometry.length; without a rig the muscle's nominal "
        "length, without pressure and load",
    )
    out.add_argument(
        "--report-only", action="store_true", help="write no rig.yaml; then the muscle need not fit the rig"
    )
    common.add_json(out)
    out.add_argument("--no-figures", action="store_true", help="leave the figures out of report.html (2 MB less)")
    common.add_open(out)
    return out


def _column(text: str) -> tuple[str, Choice]:
    quantity, equals, rest = text.partition("=")
    known = (*QUANTITIES, "force_std", "volume_std")
    if not (equals and rest) or quantity not in known:
        raise argparse.ArgumentTypeError(
            f"{text!r}: expected QUANTITY=NAME[:UNIT], the quantity one of {', '.join(known)}"
        )
    name, *more = rest.rsplit(":", 2) if rest.count(":") >= 2 else rest.split(":")
    unit, reference = (*more, "", "")[:2]
    if reference not in ("", "gauge", "absolute") or (reference and quantity != "pressure"):
        raise argparse.ArgumentTypeError(
            f"{text!r}: {reference!r} after the unit, expected gauge or absolute, of a pressure"
        )
    return quantity, Choice(name, unit, reference)


def _newton(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < 1e4:
        raise argparse.ArgumentTypeError(f"{text!r}: expected a force in N, 0 or more")
    return value


def main(argv: list[str] | None = None) -> int:
    """Run the command; the result is its exit status."""
    return common.run(parser, _run, argv)


def _run(arguments: argparse.Namespace) -> int:
    common.check_output(arguments.out)
    common.only_available_figures(arguments)
    result = _worked_out(arguments)
    with common.output_folder(arguments.out) as folder:
        if result.fitted is not None:
            write_rig(result.fitted, folder / "rig.yaml", _remarks(result, result.fitted))
        write_report(folder, result, with_figures=not arguments.no_figures)
    print(f"{terminal.render(summary(result))}\n")
    if result.fitted is not None:
        print(f"rig: {arguments.out / 'rig.yaml'}")
    common.announce_report(arguments, arguments.out)
    if result.fitted is not None:
        print(common.next_command("identify", (), f"BAG --rig {arguments.out / 'rig.yaml'} --out DIR"))
    return common.DONE


def _worked_out(arguments: argparse.Namespace) -> StaticResult:
    if arguments.volume is None and arguments.force_map is None:
        raise BadInput(
            f"nothing to fit: expected --volume FILE, --force-map FILE or both (see {typed('static --help')})"
        )
    if arguments.form and arguments.force_map is None:
        raise BadInput("--form: chooses the form of a force map; expected --force-map FILE as well")
    columns = _columns(arguments)
    if arguments.rig is None and not arguments.report_only:
        raise BadInput("--rig: expected a rig file, or --report-only for a muscle without a rig")
    length = 0.0
    if arguments.length is not None:
        length = arguments.length
        if not 0.02 < length < 2.0:
            raise BadInput(f"--length {length:g} m: expected the muscle's length at angle 0, 0.02 to 2 m")
    rig = None if arguments.rig is None else load_rig(arguments.rig, regulators=True)
    volumes = force_map = None
    if arguments.volume is not None:
        volumes = read_volumes(arguments.volume, columns)
    if arguments.force_map is not None:
        force_map = read_force_map(
            arguments.force_map,
            STANDARD_ATMOSPHERE if rig is None else rig.atmosphere.pressure,
            columns,
            arguments.pressure,
            arguments.slack_below,
        )
    muscles = (1, 2) if arguments.muscle == "both" else (int(arguments.muscle),)
    return work_out(rig, volumes, force_map, muscles, arguments.form or "", length, arguments.report_only)


def _columns(arguments: argparse.Namespace) -> dict[str, Choice]:
    """Columns by quantity."""
    chosen: dict[str, Choice] = {}
    for quantity, choice in arguments.column:
        if quantity in chosen:
            raise BadInput(f"--column {quantity}: given twice, as {chosen[quantity].column!r} and {choice.column!r}")
        needs = {"volume": "volume", "force": "force_map", "pressure": "force_map"}.get(quantity.removesuffix("_std"))
        if needs and getattr(arguments, needs) is None:
            raise BadInput(
                f"--column {quantity}: names a column of --{needs.replace('_', '-')}; expected "
                f"--{needs.replace('_', '-')} FILE as well"
            )
        chosen[quantity] = choice
    return chosen


def _remarks(result: StaticResult, rig: Rig) -> list[str]:
    tables = [table.name for table in result.tables]
    whose = " and ".join(str(number) for number in result.muscles)
    lines = [f"Rig {rig.name} with static fits of muscle {whose} from {' and '.join(tables)}; their errors: priors."]
    return lines + [f"! {text}" for text in result.warnings]
