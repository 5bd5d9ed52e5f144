"""Fit a muscle's volume and force map to static measurements.

The table of --volume holds length and volume, that of --force-map length, pressure and force. Units stand in the
columns' names (length_mm, volume_cm3, pressure_kPa_gauge, force_N) or are given with --column; a pressure is gauge or
absolute.
A column force_std_N or volume_std_cm3 is the standard deviation of each value. A force of 0 means a slack muscle.

Writes DIR/rig.yaml (the given rig with the fitted coefficients, their standard deviations as priors for identify),
DIR/report.html and DIR/report.json. Status: 0 done, 2 bad input (one line says what and where).

examples:
  {run} static --volume cylinder.csv --force-map map.csv --rig my_rig.yaml --out result
  {run} static --force-map left.csv --muscle 1 --form sarosi --rig my_rig.yaml --out result
  {run} static --force-map map.csv --column length=L:mm --column pressure=p:bar:gauge --rig my_rig.yaml --out result
  {run} static --force-map one_muscle.csv --out result --report-only
"""

from __future__ import annotations

import argparse
from pathlib import Path

from pam_antagonist.api.static import StaticResult, static
from pam_antagonist.cli import common
from pam_antagonist.cli.common import real
from pam_antagonist.cli.recordings import announce, check_page
from pam_antagonist.errors import BadInput
from pam_antagonist.identification.static_table import QUANTITIES, Choice
from pam_antagonist.model import parameters as par
from pam_antagonist.program import typed


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("static", __doc__)
    out.option("--volume", "CSV of length and volume", Path, metavar="FILE")
    out.option("--force-map", "CSV of length, pressure and force", Path, metavar="FILE")
    muscle = "muscle that gets the fitted coefficients (default: both get the same)"
    out.option("--muscle", muscle, default="both", choices=("1", "2", "both"))
    rig = "a YAML file, or the name of a rig of the package; may be left out with --report-only"
    out.shared("--rig", help=rig, required=False)
    out.shared("--out", help="folder for the results; a new one")
    form = "form of the force map in rig.yaml (default: the rig's, and braided for muscles of a data sheet)"
    out.option("--form", form, choices=par.FORCE_FORMS)
    column = f"column of a quantity ({', '.join(QUANTITIES)}, force_std, volume_std) if its name does not give it"
    out.repeated("--column", column, "QUANTITY=NAME[:UNIT[:gauge|absolute]]", _column)
    reference = "what the pressures are, where the column's name does not say it"
    out.option("--pressure", reference, default="", choices=("gauge", "absolute"))
    slack = "largest force that means a slack muscle, for sensors whose zero wanders [N] (default: 0)"
    out.option("--slack-below", slack, real(0.0, 1e4, "a force in N", ", 0 or more"), 0.0, "N")
    out.option(
        "--length", "muscle length at angle 0 [m], in place of the rig's geometry.length; without a rig the muscle's "
        "nominal length, without pressure and load", float, metavar="L_0",
    )  # fmt: skip
    out.flag("--report-only", "write no rig.yaml; then the muscle need not fit the rig")
    out.shared("--json", "--no-figures", "--open")
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


def _run(arguments: argparse.Namespace) -> int:
    check_page(arguments)
    result = _worked_out(arguments)
    announce(arguments, result, None if result.fitted is None else "rig.yaml", apart=True)
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
    if arguments.length is not None and not 0.02 < arguments.length < 2.0:
        raise BadInput(f"--length {arguments.length:g} m: expected the muscle's length at angle 0, 0.02 to 2 m")
    muscles = (1, 2) if arguments.muscle == "both" else (int(arguments.muscle),)
    return static(
        arguments.rig, arguments.volume, arguments.force_map, muscles=muscles, form=arguments.form or "",
        columns=columns, pressure=arguments.pressure, slack_below=arguments.slack_below, length=arguments.length,
        report_only=arguments.report_only,
    )  # fmt: skip


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


main = common.command(parser, _run)
