"""``identify``: a rig's parameters, noise and tuning from its recordings."""

from __future__ import annotations

import argparse
import datetime
import sys
from collections.abc import Sequence
from pathlib import Path

from pam_antagonist.cli import common
from pam_antagonist.cli import recordings as given
from pam_antagonist.errors import BadInput
from pam_antagonist.identification.sealed import STEPS as SEALED_STEPS
from pam_antagonist.identification.sealed import identify_sealed
from pam_antagonist.identification.session import Identified, Options, identify, steps
from pam_antagonist.recording import Recording, bag_hash, bag_name
from pam_antagonist.recording.joint import JointCondition, joint_condition
from pam_antagonist.recording.notes import sealed_muscles
from pam_antagonist.report import identify as numbers
from pam_antagonist.report import identify_sealed as sealed
from pam_antagonist.report import terminal
from pam_antagonist.report.held_out import judge
from pam_antagonist.report.identify_document import summary, write_report
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.write import write_rig

_DESCRIPTION = """\
Identify a rig from its recordings: parameters with error bars, sensor noise, filter tuning.

Give recordings of a joint that moves (free) and of one that is held (locked), with angle and torque measured
where you can. The end of each is not fitted but kept to judge the result by.

Writes DIR/rig.yaml, which every command and node takes, DIR/report.html and DIR/report.json; of several
recordings also DIR/rig_1.yaml, rig_2.yaml ..., each with one recording's own values.
Status: 0 done, 2 bad input (one line says what and where).
"""
_EXAMPLES = """\
examples:
  {run} identify free_bag locked_bag --rig shin2022 --out identified
  {run} identify my_bag --rig my_rig.yaml --out identified --freeze muscle_1.force --freeze muscle_2.force
  {run} identify my_bag --rig my_rig.yaml --out identified --free joint.stiffness --starts 4 --seed 7
  {run} identify sealed_bag --rig sealed_joint --out identified     (valves.sealed: true in the rig file)
  {run} replay another_bag --rig identified/rig.yaml --out check
"""
_Given = tuple[Recording, JointCondition, str]


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("identify", _DESCRIPTION, _EXAMPLES)
    given.add_bags(out)
    out.add_argument(
        "--free", action="append", default=[], metavar="NAME",
        help="a parameter (supply.pressure), or the beginning of its name, that may move as well; may be repeated",
    )  # fmt: skip
    out.add_argument(
        "--freeze", action="append", default=[], metavar="NAME",
        help="a parameter, or the beginning of its name, that stays as configured; may be repeated",
    )  # fmt: skip
    out.add_argument(
        "--holdout", type=given.share(0.05, 0.8), default=1.0 / 3.0, metavar="SHARE",
        help="share at the end of each recording that is kept to judge the result (default: a third)",
    )  # fmt: skip
    out.add_argument("--starts", type=given.count, default=1, metavar="N", help="starts of the refinement (default: 1)")
    out.add_argument("--seed", type=given.seed, default=0, help="of further starts (default: 0)")
    out.add_argument("--jobs", type=given.count, default=2, metavar="N", help="threads (default: 2)")
    given.add_names_and_report(out)
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the command; the result is its exit status."""
    return common.run(_main, argv)


def _main(argv: Sequence[str] | None) -> int:
    arguments = parser().parse_args(argv)
    common.check_output(arguments.out)
    common.only_available_figures(arguments)
    rig = load_rig(arguments.rig)
    common.lock_angle(arguments)
    recordings = _read(arguments, rig)
    if rig.valves.sealed:
        return _sealed(arguments, rig, recordings)
    for recording, _, name in recordings:
        if sealed_muscles(recording.path):
            raise BadInput(
                f"{name}: its muscles were sealed, as the bag says, but rig {rig.name} lets air through its valves; "
                "expected a rig file with valves.sealed: true, such as config/rigs/sealed_joint.yaml"
            )
    options = Options(
        tuple(arguments.free),
        tuple(arguments.freeze),
        arguments.holdout,
        arguments.starts,
        arguments.seed,
        arguments.jobs,
    )
    with common.progress(steps(options) + 2 * len(recordings), "identify", "steps") as bar:

        def progress(text: str) -> None:
            bar.set_description(f"identify: {text}")
            bar.update(1)

        found = identify(recordings, rig, options, progress)
        judged = judge(recordings, numbers.rigs_of(found), found.held_from, progress)
    report = numbers.report(recordings, found, judged)
    with common.output_folder(arguments.out) as folder:
        _write_rigs(folder, found, recordings)
        write_report(folder, report, found, judged, with_figures=not arguments.no_figures)
    print(terminal.render(summary(report)))
    given.announce_output(arguments)
    return common.DONE


def _sealed(arguments: argparse.Namespace, rig: Rig, recordings: Sequence[_Given]) -> int:
    """The same for a joint whose muscles are sealed: other steps, fewer parameters."""
    for name in ("free", "freeze"):
        if getattr(arguments, name):
            raise BadInput(f"--{name}: the parameters of a sealed joint that can be identified are fixed; leave it out")
    for _, state, name in recordings:
        if state.condition != "free":
            raise BadInput(
                f"{name}: the joint is {state.condition}; expected a sealed joint that an external torque moves"
            )
    named = [(recording, name) for recording, _, name in recordings]
    with common.progress(SEALED_STEPS, "identify", "steps") as bar:

        def progress(text: str) -> None:
            bar.set_description(f"identify: {text}")
            bar.update(1)

        found = identify_sealed(named, rig, arguments.holdout, progress)
    rigs: dict[str, Rig] = {"as_configured": found.start, "identified": found.rig}
    judged = judge(recordings, [rigs] * len(recordings), found.held_from)
    report = sealed.report(found, judged)
    with common.output_folder(arguments.out) as folder:
        about = [*_about(rig, arguments.seed), *_fitted(recordings, found.held_from)]
        source = f"identified from {', '.join(name for _, name in named)}; started from: {rig.source.strip()}"
        write_rig(_named(found.rig, rig.name, source), folder / "rig.yaml", about)
        sealed.write_report(folder, report, judged, with_figures=not arguments.no_figures)
    print(terminal.render(sealed.summary(report)))
    given.announce_output(arguments)
    return common.DONE


def _about(rig: Rig, seed: int) -> list[str]:
    when = datetime.datetime.now(datetime.timezone.utc).strftime("%Y-%m-%d %H:%M UTC")
    return [f"Identified on {when} by pam_antagonist identify, from rig {rig.name}, seed {seed}."]


def _fitted(recordings: Sequence[_Given], held_from: Sequence[float]) -> list[str]:
    return [
        "Recordings (the part that was fitted, joint, SHA-256):",
        *(
            f"  {name}: first {until:.1f} s, {state.condition}, {bag_hash(recording.path)}"
            for (recording, state, name), until in zip(recordings, held_from, strict=True)
        ),
    ]


def _read(arguments: argparse.Namespace, rig: Rig) -> list[_Given]:
    recordings = given.read(arguments, rig)
    damage = given.damage(arguments, recordings)
    if damage:
        print(terminal.warnings(damage))
    return [
        (recording, joint_condition(recording, arguments.joint, arguments.lock_angle), bag_name(bag))
        for recording, bag in zip(recordings, arguments.bags, strict=True)
    ]


def _write_rigs(folder: Path, found: Identified, recordings: Sequence[_Given]) -> None:
    about = [
        *_about(found.start, found.options.seed),
        *_fitted(recordings, found.held_from),
        "Standard errors stand in report.json; the directions below are what of them moves the estimate.",
    ]
    source = (
        f"identified from {', '.join(name for _, _, name in recordings)}; started from: {found.start.source.strip()}"
    )
    write_rig(_named(found.tuned.rig, found.start.name, source), folder / "rig.yaml", about)
    if len(recordings) > 1:
        for index, (_, _, name) in enumerate(recordings):
            own = _named(found.own[index], found.start.name, f"{source}; with the values of {name} alone")
            remark = f"The values of {name} alone, which deviate a little from the common ones in rig.yaml."
            write_rig(own, folder / f"rig_{index + 1}.yaml", [*about, remark])


def _named(rig: Rig, name: str, source: str) -> Rig:
    plain = name.removesuffix("_identified")
    return rig.replaced(name=f"{plain}_identified", source=" ".join(source.split()))


if __name__ == "__main__":
    sys.exit(main())
