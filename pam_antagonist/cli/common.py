"""What commands share: arguments, the way they end, and output folders that are whole or not there.

A command ends with status 0 (done), 2 (bad input or usage: one line on stderr, no traceback), 130 (interrupted) or 1
(anything else, which is a defect of this package: with a traceback).
"""

from __future__ import annotations

import argparse
import codecs
import contextlib
import math
import os
import re
import shlex
import signal
import sys
import traceback
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from typing_extensions import override

from pam_antagonist.errors import BadInput, NoResult
from pam_antagonist.numbers import number_of
from pam_antagonist.optional import available, install
from pam_antagonist.paths import check_makable, check_output, output_folder
from pam_antagonist.program import INTERRUPTED, SIGNALS, Interrupts, alone, escaped, piped, program, typed


def real(low: float, high: float, what: str = "a number", bounds: str = "") -> Callable[[str], float]:
    """Type of an argument that is a number between two bounds; what it is and its bounds in words, for the message."""

    def convert(text: str) -> float:
        value = number_of(text)
        if value is None or not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r}: expected {what}{bounds or f' from {low:g} to {high:g}'}")
        return value

    return convert


def whole(low: int, high: int) -> Callable[[str], int]:
    """Type of an argument that is a whole number between two bounds."""

    def convert(text: str) -> int:
        if not text.isdecimal() or not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(f"{text!r}: expected a whole number from {low} to {high}")
        return int(text)

    return convert


def degrees(text: str) -> float:
    """Degrees on the command line, radians within."""
    return math.radians(real(-90.0, 90.0, "an angle in degrees", ", -90 to 90")(text))


SEED = whole(0, 2**31 - 1)
"""Type of an argument that seeds a random generator."""
JOBS = whole(1, 64)
"""Type of an argument that is a number of threads or processes."""


__all__ = ["check_output", "output_folder"]  # beside what is defined here

DONE, FAILED, BAD_INPUT = 0, 1, 2


class Parser(argparse.ArgumentParser):
    """An argument parser whose complaints are one line, like those about any other input."""

    def __init__(self, name: str, about: str | None, epilog: str = "") -> None:
        """Make a parser from a command's docstring: what it does, then ``examples:``, which may stand apart as well.

        In the examples ``{run}`` stands for the words that start a command where this runs.
        """
        description, begin, examples = (about or "").partition("\nexamples:\n")
        super().__init__(
            prog=typed(name), description=description, epilog=(begin + examples + epilog).replace("{run}", program()),
            formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False,
        )  # fmt: skip
        self._negative_number_matcher = re.compile(r"-\.?\d")  # also of -5:5, -20kPa and -1e-3, which are no options

    def option(
        self,
        name: str,
        text: str,
        kind: Callable[[str], Any] | None = None,
        default: Any = None,
        metavar: str | None = None,
        **more: Any,
    ) -> None:
        """An option with a value, or an argument without dashes."""
        self.add_argument(name, help=text, type=kind or str, default=default, metavar=metavar, **more)

    def repeated(
        self, name: str, text: str, metavar: str | None, kind: Callable[[str], Any] | None = None, **more: Any
    ) -> None:
        """An option that may be given several times."""
        self.add_argument(name, action="append", default=[], type=kind or str, metavar=metavar, help=text, **more)

    def flag(self, name: str, text: str) -> None:
        """An option without a value."""
        self.add_argument(name, action="store_true", help=text)

    def shared(self, *names: str, **changes: Any) -> None:
        """Options that several commands have, from :data:`_SHARED`. `changes`: of what stands there."""
        for name in names:
            self.add_argument(name.split()[0], **{**_SHARED[name], **changes})
        if "--json" in names:
            self.set_defaults(writes_report_json=True)

    @override
    def error(self, message: str) -> NoReturn:
        raise BadInput(f"{message} (see {self.prog} --help)")


def _topic(text: str) -> tuple[str, str]:
    name, equals, other = text.partition("=")
    if not (name and equals and other.startswith("/")):
        raise argparse.ArgumentTypeError(f"{text!r}: expected NAME=/OTHER, such as pressure_1=/arm/p1")
    return name, other


_FLAG = {"action": "store_true"}
_SHARED: dict[str, dict[str, Any]] = {
    "bags": {"help": "rosbag2: its folder, or an .mcap or .db3 file", "type": Path, "metavar": "BAG", "nargs": "+"},
    "--rig": {"help": "a YAML file, or the name of a rig of the package", "metavar": "RIG", "required": True},
    "--out": {"help": "folder for the result; a new one", "type": Path, "metavar": "DIR", "required": True},
    "--seed": {"help": "seed of all random numbers (default: 0)", "type": SEED, "default": 0},
    "--jobs": {"help": "threads (default: 2)", "type": JOBS, "default": 2, "metavar": "N"},
    "--joint": {"help": "may the joint move? (default: free)", "default": "free", "choices": ("free", "locked")},
    "--joint of a recording": {
        "help": "could the joint move? (default: auto, from the measured angle)", "default": "auto",
        "choices": ("auto", "free", "locked"),
    },
    "--lock-angle": {"help": "angle at which a locked joint is held [deg]", "type": degrees, "metavar": "DEG"},
    "--mismatch": {
        "help": "relative deviation of the simulated joint's parameters from the rig file (default: 0.01)",
        "type": float, "default": 0.01, "metavar": "X",
    },
    "--no-noise": {"help": "exact sensors", **_FLAG},
    "--topic": {
        "help": "the topic NAME (pressure_1, valve_state, ...) is /OTHER in the bag; may be given several times",
        "type": _topic, "metavar": "NAME=/OTHER", "action": "append", "default": [],
    },
    "--namespace": {"help": "namespace of the rig, where a bag holds several", "metavar": "/NS"},
    "--joint-name": {"help": "joint in measured/joint_states, where it holds several", "metavar": "NAME"},
    "--recover": {"help": "if the bag is damaged, read what is left of it", **_FLAG},
    "--no-check": {"help": "use a recording although the check says that it is wrong", **_FLAG},
    "--json": {
        "help": "write the content of report.json to this file as well; with -, it goes to standard output and the "
        "tables go to standard error", "metavar": "FILE",
    },
    "--no-log": {"help": "write nothing into the log book of the rig (see history)", **_FLAG},
    "--no-figures": {"help": "leave the figures out of report.html (2 MB less)", **_FLAG},
    "--open": {"help": "show report.html in the browser afterwards", **_FLAG},
    "--dask": {
        "help": "fit on the workers of this Dask scheduler, such as tcp://10.0.0.5:8786 (needs pam_antagonist[dask])",
        "metavar": "ADDRESS",
    },
}  # fmt: skip
"""Options that several commands have, as ``add_argument`` takes them."""


def run(
    parser: Callable[[], Parser], command: Callable[[argparse.Namespace], int], argv: Sequence[str] | None = None
) -> int:
    """Read a command's arguments, do its work, and give what ``--json`` asks for.

    `argv`: arguments without the program's name; default: those of the process. The work finds them as ``words``.
    """

    def work() -> int:
        words = sys.argv[1:] if argv is None else list(argv)
        arguments = parser().parse_args(words, argparse.Namespace(words=words))
        _check_writable(arguments)
        if "writes_report_json" not in arguments:
            return command(arguments)
        with json_alone(arguments.json):
            status = command(arguments)
        report: Path = arguments.out / "report.json"
        # A command that failed or was interrupted wrote none.
        if arguments.json is not None and report.is_file():
            give_json(arguments.json, report.read_text(encoding="utf-8"))
        return status

    return ended(work) if argv is not None else alone(lambda: ended(work))


def _check_writable(arguments: argparse.Namespace) -> None:
    """Refuse what ``--out``, ``--json`` and ``--save`` name and cannot be written, before minutes of work."""
    for option in ("out", "json", "save"):
        given = getattr(arguments, option, None)
        path = Path("-" if given is None else given)
        if str(path) == "-":
            continue
        try:
            if path.exists():  # whether it may exist is up to the command
                if not os.access(path, os.W_OK):
                    raise BadInput(f"--{option} {path}: cannot be written to")
            else:
                check_makable(path)
                if option == "json" and not path.absolute().parent.is_dir():
                    raise BadInput(f"--json {path}: there is no folder {path.parent}")
        except (OSError, ValueError) as error:
            raise BadInput(f"--{option} {path}: cannot be made: {getattr(error, 'strerror', None) or error}") from None


def command(parser: Callable[[], Parser], work: Callable[[argparse.Namespace], int]) -> Callable[..., int]:
    """``main`` of a command: takes the words after its name, by default those of the process; gives the exit status."""
    return lambda argv=None: run(parser, work, argv)


def ended(work: Callable[[], int]) -> int:
    """Turn what goes wrong in some work into an exit status."""
    return piped(lambda: _ended(work))


def _ended(work: Callable[[], int]) -> int:
    try:
        with _terminable():
            return work()
    except BadInput as error:
        # One line, whatever a file name may contain.
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return FAILED if isinstance(error, NoResult) else BAD_INPUT
    except KeyboardInterrupt:
        return _interrupted()
    except BrokenPipeError:
        raise
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else (DONE if end.code is None else FAILED)
    except Exception as error:
        # A compiled function during which the signal came fails, with it as the cause.
        if isinstance(error, SystemError) and isinstance(error.__cause__, KeyboardInterrupt):
            return _interrupted()
        traceback.print_exc(limit=-6)
        print("error: this is a defect of pam_antagonist, not of your input", file=sys.stderr)
        return FAILED


def _interrupted() -> int:
    print("interrupted: nothing was written", file=sys.stderr)
    return INTERRUPTED


@contextmanager
def _terminable() -> Iterator[None]:
    """Let SIGTERM end a command as Ctrl-C does, so that it cleans up."""
    before = [(number, signal.getsignal(number)) for number in SIGNALS]
    own = any(isinstance(handler, Interrupts) for _, handler in before)
    try:
        if own:
            Interrupts(INTERRUPTED, raises=True).install()
        else:
            signal.signal(signal.SIGTERM, signal.default_int_handler)
    except ValueError:  # not in the main thread: whoever runs us there handles signals
        yield
        return
    try:
        yield
    finally:
        for number, handler in before:
            signal.signal(number, handler)


def lock_angle(arguments: argparse.Namespace) -> float | None:
    """The angle of a locked joint [rad], None where none was given."""
    if arguments.lock_angle is not None and arguments.joint != "locked":
        raise BadInput("--lock-angle: only a joint that is locked has one; give --joint locked as well")
    value: float | None = arguments.lock_angle
    return value


def topics(arguments: argparse.Namespace) -> dict[str, str]:
    """The topics that were given other names."""
    chosen: dict[str, str] = {}
    for name, other in arguments.topic:
        if name in chosen:
            raise BadInput(f"--topic {name}: given twice, as {chosen[name]} and {other}")
        chosen[name] = other
    return chosen


def announce_report(arguments: argparse.Namespace, folder: Path) -> None:
    """Say where the report is, and show it in the browser if ``--open`` asks for that."""
    page = folder / "report.html"
    print(f"report: {page} and report.json")
    if arguments.open:
        webbrowser.open(page.absolute().as_uri())


def next_command(words: str, bags: Sequence[Path] = (), rest: str = "") -> str:
    """The command that usually comes next, on a line of its own."""
    return f"next:\n{typed(' '.join(part for part in (words, shlex.join(map(str, bags)), rest) if part))}"


def json_alone(where: str | None) -> contextlib.AbstractContextManager[object]:
    """Standard output for JSON alone, where ``--json`` is -: what is printed meanwhile goes to standard error."""
    return contextlib.redirect_stdout(sys.stderr) if where == "-" else contextlib.nullcontext()


def give_json(where: str, text: str) -> None:
    """Write JSON where ``--json`` says."""
    if where == "-":
        unicode = codecs.lookup(sys.stdout.encoding or "utf-8").name.startswith("utf")
        sys.stdout.write(text if unicode else escaped(text))
    else:
        write_text(Path(where), text)


def write_text(path: Path, text: str) -> None:
    """Write a file that was asked for; what is there is replaced."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror}") from None


def only_available_figures(arguments: argparse.Namespace) -> None:
    """Where the library of a page's figures is missing, say so and go on as with ``--no-figures``."""
    if not (arguments.no_figures or available("plotly")):
        print(f"report.html gets no figures: plotly is not installed; to get it: {install('reports')}", file=sys.stderr)
        arguments.no_figures = True
