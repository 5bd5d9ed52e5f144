"""Every command on small recordings with all that may be wrong in them: none crashes, and none says what is not so.

The first ten are part of every run. ``SWEEP_COUNT`` and ``SWEEP_SEED`` draw more cases, and others:
``SWEEP_SEED=7 SWEEP_COUNT=500``.
"""

from __future__ import annotations

import json
import os
import re
import warnings
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from sweep_cases import Case, cases, made, words, write_rigs

from pam_antagonist import load_rig
from pam_antagonist.__main__ import COMMANDS
from pam_antagonist.errors import BadInput
from pam_antagonist.rig import Rig

COUNT, SEED = (int(os.environ.get(name, default)) for name, default in (("SWEEP_COUNT", "45"), ("SWEEP_SEED", "1")))

BLAMED = re.compile(r"(--[a-z][a-z-]*)(?: [^:\s]+)?: ")
"""An option that an error gives as its reason."""
NO_NUMBER = re.compile(r"(?<![\w-])(nan|inf|-inf|infinity|without bound)(?![\w-])", re.IGNORECASE)
RESULTS = "rmse_deg", "rmse_nm", "rmse_pa", "max_deg", "max_nm", "max_pa", "nis_mean", "value", "identified"
"""Keys of report.json whose numbers were asked for: JSON has null where one is not finite."""
ALWAYS = 10
CASES = [
    pytest.param(case, marks=pytest.mark.slow(3) if k < ALWAYS else pytest.mark.thorough(3), id=str(case))
    for k, case in enumerate(cases(COUNT, SEED))
]


@pytest.fixture(scope="module")
def rigs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Rig]:
    return write_rigs(tmp_path_factory.mktemp("rigs"))


@pytest.mark.parametrize("case", CASES)
def test_no_command_crashes_or_says_what_is_not_so(
    case: Case, rigs: dict[str, Rig], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    files = made(case, rigs, tmp_path)
    complaints: list[str] = []
    for name, arguments in words(case, files, tmp_path):
        capfd.readouterr()
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("default")
            module, function = COMMANDS[name].target.split(":")
            status = getattr(import_module(module), function)(arguments)
        out, err = capfd.readouterr()
        found = [f"a warning of a library: {item.filename}: {item.message}" for item in warned]
        found += [*_of_words(status, out, err, arguments), *_of_files(status, tmp_path / name)]
        if found:
            complaints.append("\n  ".join([f"{name} {' '.join(arguments)}: status {status}", *found]))
    assert not complaints, "\n".join(complaints)


def _of_words(status: int, out: str, err: str, arguments: list[str]) -> Iterator[str]:
    """What is wrong with what a command printed."""
    both = out + err
    if "Traceback" in both or "defect of pam_antagonist" in both:
        yield f"crashed: {err[-1200:]}"
    if re.search(r"\b\w*Warning: ", both):
        yield f"a warning of a library: {both}"
    if status not in (0, 1, 2):
        yield "status is none of 0, 1, 2"
    errors = [line for line in err.splitlines() if line.startswith("error: ")]
    # check says what is wrong in its table, and ends with 2 as well; a rig that is rejected is a result, with a report.
    told = "✗" in out if status == 2 else out.lstrip().startswith("Do not use this rig: ")
    if status == 0 and errors:
        yield f"an error with status 0: {errors}"
    elif status and not told and (len(errors) != 1 or not err.endswith(f"{errors[0]}\n")):
        yield f"not one line says what is wrong: {err[-800:]}"
    if re.search(r"\.replaced: ", both):
        yield f"a value of the program's own is given as bad input: {both[-800:]}"
    for line in errors:
        yield from (f"{option} was never typed: {line}" for option in BLAMED.findall(line) if option not in arguments)
    for named in re.findall(r" --rig (\S+\.yaml)\b", out) if status == 0 else ():
        if not Path(named).is_file():
            yield f"the next command needs {named}, which is not there"
    if status == 0 and (number := NO_NUMBER.search(both)):
        yield f"{number[0]} is no number: {both[max(0, number.start() - 200) : number.end() + 100]}"


def _of_files(status: int, folder: Path) -> Iterator[str]:
    """What is wrong with what a command wrote."""
    if status == 2 and folder.exists():
        yield f"status 2, and files all the same: {sorted(path.name for path in folder.iterdir())}"
    for path in sorted(set(folder.glob("*.yaml")) - {folder / "rig_rejected.yaml"}):
        try:
            load_rig(path, regulators=True)
        except BadInput as error:
            yield f"a rig file that the reader refuses: {error}"
    if status == 0 and (report := folder / "report.json").is_file():
        content = json.loads(report.read_text(encoding="utf-8"), parse_constant=pytest.fail)
        yield from (f"no number in the report: {place}" for place in _missing(content))
        yield from (f"no number in the report: {text}" for text in texts(content) if NO_NUMBER.search(text))


def test_no_stored_report_has_a_sentence_with_a_number_that_is_none() -> None:
    reports = sorted((Path(__file__).parents[1] / "golden").glob("*.json"))
    said = [text for path in reports for text in texts(json.loads(path.read_text(encoding="utf-8")))]
    assert len(reports) > 4 and len(said) > 100
    assert [text for text in said if NO_NUMBER.search(text)] == []


def texts(content: Any) -> Iterator[str]:
    """All sentences of a report."""
    if isinstance(content, str):
        yield content
    elif isinstance(content, dict | list):
        for item in content.values() if isinstance(content, dict) else content:
            yield from texts(item)


def _missing(content: Any, place: str = "") -> Iterator[str]:
    """Places of results that are no numbers."""
    if isinstance(content, dict):
        for key, value in content.items():
            if key in RESULTS and None in (value if isinstance(value, list) else [value]):
                yield f"{place}.{key}"
            yield from _missing(value, f"{place}.{key}")
    elif isinstance(content, list):
        for k, item in enumerate(content):
            yield from _missing(item, f"{place}[{k}]")
