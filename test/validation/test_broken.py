"""The behaviours that ``./run broken`` breaks are ones that the code has, and a broken one is mended again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from pam_antagonist.errors import BadInput
from validation import broken


def test_twenty_behaviours_stand_in_the_code_once() -> None:
    found = broken.behaviours()
    assert len(found) == len({item.what for item in found}) == 20
    assert all((broken.ROOT / test).exists() for item in found for test in item.tests)
    assert all(item.old != item.new for item in found)


def test_a_text_that_is_gone_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table = tmp_path / "table.yaml"
    table.write_text("- {what: nothing, file: README.md, old: not in there, new: x, tests: [test]}\n", "utf-8")
    monkeypatch.setattr(broken, "TABLE", table)
    with pytest.raises(BadInput, match="nothing: its text is 0 times in README.md, expected once"):
        broken.behaviours()


@pytest.mark.parametrize(
    ("failing", "by"),
    [("first", "gate"), ("all", "gate"), ("thorough", "--all"), ("none", "")],
)
def test_it_is_looked_for_beside_it_then_everywhere_and_mended(
    failing: str, by: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    item = broken.behaviours()[0]
    monkeypatch.setattr(broken.subprocess, "run", _listing(broken.subprocess.run, item.file))
    copy = broken.Copy(tmp_path)
    file = copy.root / item.file
    whole = file.read_text("utf-8")
    order = {"first": 1, "all": 2, "thorough": 3, "none": 4}
    asked: list[tuple[str, Sequence[str]]] = []

    def fails(marks: str, tests: Sequence[str], workers: bool) -> str:
        asked.append((marks, tests))
        if tests == ["test_x"]:  # once more, mended
            assert file.read_text("utf-8") == whole
            return ""
        assert item.new in file.read_text("utf-8") and item.old not in file.read_text("utf-8")
        return "test_x" if len(asked) == order[failing] else ""

    monkeypatch.setattr(copy, "fails", fails)
    outcome = copy.noticed(item)
    assert (outcome["by"], outcome["test"]) == (by, "test_x" if by else "")
    assert [tests for _, tests in asked] == [item.tests, (), ()][: order[failing]] + [["test_x"]] * bool(by)
    assert file.read_text("utf-8") == whole


def test_a_test_that_fails_with_nothing_broken_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    item = broken.behaviours()[0]
    monkeypatch.setattr(broken.subprocess, "run", _listing(broken.subprocess.run, item.file))
    copy = broken.Copy(tmp_path)
    monkeypatch.setattr(copy, "fails", lambda marks, tests, workers: "test_x")
    with pytest.raises(BadInput, match="test_x fails with nothing broken as well"):
        copy.noticed(item)


def _listing(real, file: str):
    """Of the files that git knows, only one: the copy of a whole checkout takes a second."""

    def run(command, **options):
        done = real(command, **options)
        if command[:2] == ["git", "ls-files"]:
            done.stdout = f"{file}\0".encode()
        return done

    return run
