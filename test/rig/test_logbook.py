"""The log book: what is written, what is read of a damaged one, and what a trend is."""

from __future__ import annotations

import datetime
import json
import os
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist import BadInput, history, import_csv, load_rig, read_bag, simulate
from pam_antagonist.__main__ import main
from pam_antagonist.api.history import Limit, log
from pam_antagonist.inference.trend import trend
from pam_antagonist.recording import write_bag
from pam_antagonist.rig.file import write_rig
from pam_antagonist.rig.logbook import Entry, append, book_of, identity, measured

DAY = datetime.timedelta(days=1)
BEGIN = datetime.datetime(2026, 9, 1, tzinfo=datetime.timezone.utc)


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    """A rig file of its own."""
    file = tmp_path / "my_rig.yaml"
    file.write_text("based_on: shin2022\nname: my_rig\n", encoding="utf-8")
    return file


def entries(file: Path, loss: float, count: int = 8, seed: int = 3, spread: float = 0.3, std: float = 0.2) -> None:
    """Write a log book of a force of 50 N, of which a share is lost over seven weeks, evenly."""
    random, rig = np.random.default_rng(seed), load_rig(file)
    for k in range(count):
        value = 50.0 * (1.0 - loss * k / (count - 1)) + random.normal(0.0, spread) + random.normal(0.0, std)
        found = Entry(
            at=BEGIN + 49.0 / (count - 1) * k * DAY, command="identify", rig=identity(rig), verdict="identified",
            values=measured({"force of muscle 2": (value, std, "N")}),
        )  # fmt: skip
        append([book_of(file) or Path()], found)


def test_a_loss_is_found_with_its_size_and_its_date(rig_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    entries(rig_file, 0.07)
    (course,) = history(rig_file).changed
    change, std = course.change
    assert abs(change + 3.5) < 3.0 * std < 1.5
    best, earliest, latest = course.forecast or (0.0, 0.0, 0.0)
    assert 49.0 < earliest < best < latest
    assert earliest < 140.0 < latest  # 20 % at 1 % a week
    assert main(["history", str(rig_file), "--limit", "force of muscle 2=45"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Muscle 2 has lost" in said
    assert "in 7 weeks; if that goes on, it reaches 45.0 N on 2026-1" in said


def test_without_a_change_trends_are_as_rare_as_claimed_and_intervals_as_wide() -> None:
    random = np.random.default_rng(7)
    time, std, rounds = np.linspace(0.0, 49.0, 7), np.full(7, 0.2), 600
    lines = [trend(time, 50.0 + random.normal(0.0, 0.4, 7) + random.normal(0.0, std), std) for _ in range(rounds)]
    false = np.mean([line.p < 0.05 for line in lines])
    assert 0.02 < false < 0.075  # 5 %, with three standard errors of 600 rounds
    spreads = np.array([line.spread for line in lines])
    assert abs(np.sqrt(np.mean(spreads**2)) - 0.4) < 0.06


@pytest.mark.slow(4)
def test_identify_writes_the_log_book_beside_both_rig_files(rig_file: Path, tmp_path: Path) -> None:
    worn = load_rig(rig_file)
    for name in ("v1", "v2"):
        worn = worn.with_value(f"muscle_2.force.{name}", 0.95 * getattr(worn.muscle_2.force, name))
    recording = simulate(worn, duration=8.0, seed=2)
    write_bag(tmp_path / "bag", recording)
    words = ["identify", str(tmp_path / "bag"), "--rig", str(rig_file), "--no-figures"]
    frozen = ["--freeze", "muscle_1", "--freeze", "gas"]
    assert main([*words, *frozen, "--out", str(tmp_path / "a"), "--no-log"]) == 0
    assert book_of(rig_file) and not (book_of(rig_file) or rig_file).exists()
    assert main([*words, *frozen, "--out", str(tmp_path / "b")]) == 0
    first = history(rig_file).book.entries
    assert first == history(tmp_path / "b" / "rig.yaml").book.entries
    (entry,) = first
    found, force = entry.values["force of muscle 2"], worn.muscle_2.force
    at_rest = force.v1 * worn.geometry.length + force.v2  # m², of the pressure's part of the linear map
    pressure = 4.0e5 - worn.atmosphere.pressure
    assert found.std is not None and found.std < 1.0
    assert abs(found.value - at_rest * pressure) < 4.0 * found.std
    # Found again in both files, it counts once.
    assert len(history(rig_file, logs=[tmp_path / "b" / "rig.yaml"]).book.entries) == 1


def test_identified_and_configured_files_are_one_history(rig_file: Path, tmp_path: Path) -> None:
    """Also where identification has moved a value farther than the files of one rig may differ, and twice."""
    names, rigs = ["my_rig.yaml", "identified.yaml", "again.yaml"], [load_rig(rig_file)]
    for name, pressure in zip(names[1:], (650e3, 590e3), strict=True):
        rigs.append(rigs[0].with_value("supply.pressure", pressure))
        write_rig(rigs[-1], tmp_path / name)
    recording = simulate(rigs[0], duration=1.0)
    for k in (0, 1):
        log(
            "identify", tmp_path / names[k], [recording.slice(0.5 * k, 1.0)], rigs[k], object(), tmp_path / names[k + 1]
        )
    for name, count in zip(names, (1, 2, 2), strict=True):
        found = history(tmp_path / name).book
        assert len(found.entries) == count and not found.notes, name
    other = rigs[0].with_value("geometry.radius", 0.034)
    log("check", tmp_path / names[2], [recording], other, object())
    assert "line 3 is of another rig (geometry.radius" in history(tmp_path / names[2]).book.notes[0]


@pytest.mark.parametrize(
    ("time", "expected"),
    [
        ("{rate: 100}", "2026-05-06 07:08"),  # when the file was written
        ("{rate: 100, date: 2026-03-04}", "2026-03-04 00:00"),
        ("{column: t, unit: s, date: 2026-03-04 05:06}", "2026-03-04 05:06"),
        ("{column: t, unit: s, date: '2026-03-04T05:06+02:00'}", "2026-03-04 03:06"),
    ],
)
def test_an_import_has_the_date_of_its_map_or_of_its_file(
    rig_file: Path, tmp_path: Path, time: str, expected: str
) -> None:
    text = "".join(f"{k / 100},{3 + k / 100},4,5,5\n" for k in range(50))
    (tmp_path / "trial.csv").write_text(f"t,p1,p2,u1,u2\n{text}", encoding="utf-8")
    written = datetime.datetime(2026, 5, 6, 7, 8, tzinfo=datetime.timezone.utc).timestamp()
    os.utime(tmp_path / "trial.csv", (written, written))
    entries = [f"pressure_{i}: {{column: p{i}, unit: bar, reference: absolute}}" for i in (1, 2)]
    entries += [f"valve_{i}: {{column: u{i}, unit: V}}" for i in (1, 2)]
    (tmp_path / "map.yaml").write_text("\n".join([f"time: {time}", *entries]), encoding="utf-8")
    recording = import_csv(tmp_path / "trial.csv", tmp_path / "map.yaml", tmp_path / "bag")
    for one in (recording, read_bag(tmp_path / "bag")):
        log("check", rig_file, [one], load_rig(rig_file), object())
        (book_of(rig_file) or Path()).rename(tmp_path / "before.jsonl")
        found = history(rig_file, logs=[tmp_path / "before.jsonl"]).book.entries
        assert [f"{entry.when:%Y-%m-%d %H:%M}" for entry in found] == [expected]


def test_damaged_lines_and_lines_of_another_rig_are_named_and_left_out(rig_file: Path, tmp_path: Path) -> None:
    entries(rig_file, 0.07)
    book = book_of(rig_file) or Path()
    other = load_rig("shin2022").with_value("geometry.radius", 0.034)
    append([book], Entry(at=BEGIN, command="check", rig=identity(other)))
    with book.open("ab") as file:
        file.write(b'\xff\x00 {"at": "2026')
    before = book.read_bytes()
    found = history(rig_file)
    assert len(found.book.entries) == 8
    assert len(found.changed) == 1
    assert any("line 10 cannot be read and is left out" in text for text in found.book.notes)
    assert any("line 9 is of another rig (geometry.radius 0.034 m" in text for text in found.book.notes)
    assert book.read_bytes() == before
    # The next entry begins a line of its own.
    append([book], Entry(at=BEGIN + 60 * DAY, command="check", rig=identity(load_rig(rig_file))))
    assert len(history(rig_file).book.entries) == 9


def test_what_is_missing_is_said(rig_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, said in (
        ([str(rig_file)], "no log book"),
        (["shin2022"], "rigs of the package have none"),
        ([str(rig_file), "--limit", "force"], "expected NAME=VALUE"),
    ):
        assert main(["history", *words]) == 2
        assert said in capsys.readouterr().err
    entries(rig_file, 0.07)
    with pytest.raises(BadInput, match="did you mean 'force of muscle 2'"):
        history(rig_file, limits={"force of muscle 3": Limit(0.8, True)})


def test_the_page_and_the_report(rig_file: Path, tmp_path: Path) -> None:
    entries(rig_file, 0.07)
    history(rig_file).save(tmp_path / "life")
    report = json.loads((tmp_path / "life" / "report.json").read_text(encoding="utf-8"))
    course = report["values"]["force of muscle 2"]
    assert course["changed"] and len(course["value"]) == 8
    assert course["limit"] == pytest.approx(0.8 * course["value"][0])
    assert course["limit_reached"]["earliest"] < course["limit_reached"]["best"] < course["limit_reached"]["latest"]
    assert "Muscle 2 has lost" in (tmp_path / "life" / "report.html").read_text(encoding="utf-8")


def test_the_result_stays_where_the_log_book_cannot_be_written(tmp_path: Path, rig_file: Path) -> None:
    book = book_of(rig_file) or Path()
    book.mkdir()
    recording = simulate("shin2022", duration=1.0)
    with pytest.raises(BadInput, match="the log book cannot be written"):
        log("check", rig_file, [recording], load_rig(rig_file), object())
