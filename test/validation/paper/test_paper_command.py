"""The command: what it writes, what it refuses."""

from __future__ import annotations

import json
import re
import shutil
from html import unescape
from pathlib import Path

import pytest

from validation.paper import page
from validation.paper.command import main

QUICK = ["static", "influence"]


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("paper")
    arguments = ["--out", str(folder / "out"), "--seeds", "3", "--seed", "7", "--jobs", "1", "--only", *QUICK]
    assert main([*arguments, "--docs", str(folder / "paper.md")]) == 0
    return folder


def test_report_and_tables_are_written(report: Path) -> None:
    assert sorted(path.name for path in (report / "out").iterdir()) == ["report.html", "report.json"]
    document = json.loads((report / "out/report.json").read_text(encoding="utf-8"))
    assert list(document["experiments"]) == QUICK
    assert document["virtual_rig"]["seeds"] == [7, 8, 9]
    for entry in document["experiments"].values():
        for row in entry["beside_the_paper"]:
            assert row["difference"].endswith("."), f"{row['what']}: a sentence on the difference"
    static = document["experiments"]["static"]["numbers"]
    assert len(static["of_seed"]) == 3
    assert len({entry["muscle_1"]["declared_error_n"] for entry in static["of_seed"]}) == 3, "one rig a seed"


def test_a_measured_force_map_is_fitted_by_leaving_lengths_out(tmp_path: Path) -> None:
    # A map of Hildebrandt's form, slack where it would push: that form alone predicts lengths it has not seen.
    rows = ["length_m,pressure_Pa_gauge,force_N"]
    for k in (0.0, 0.04, 0.08, 0.12, 0.16, 0.2, 0.24):
        for q in (1.0, 2.0, 3.0, 4.0, 5.0, 6.0):
            force = (200.0 - 900.0 * k + 700.0 * k**2) * q - 60.0 - 500.0 * k + 3000.0 * k**2 - 9000.0 * k**3
            rows.append(f"{0.3 * (1.0 - k):.6f},{1e5 * q:g},{max(force, 0.0):.6f}")
    (tmp_path / "map.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    arguments = ["--only", "compare_torque", "--seeds", "1", "--jobs", "1", "--force-map", str(tmp_path / "map.csv")]
    assert main(["--out", str(tmp_path / "out"), *arguments]) == 0
    numbers = json.loads((tmp_path / "out/report.json").read_text(encoding="utf-8"))["experiments"]["compare_torque"][
        "numbers"
    ]
    real = numbers["real_map"]
    left_out = {form: real[form]["left_out_rmse_n"] for form in ("linear", "hildebrandt", "sarosi", "polynomial")}
    assert left_out.pop("hildebrandt") < 0.01
    assert min(left_out.values()) > 1.0
    # On the virtual rig, whose muscles are linear, the forms that hold the linear one find it.
    ratios = [numbers["of_seed"][0][form]["default"]["ratio"] for form in ("linear", "hildebrandt", "polynomial")]
    assert max(ratios) < 0.02


def test_markdown_has_the_numbers_beside_the_paper_and_the_report_every_table(report: Path) -> None:
    text = (report / "paper.md").read_text(encoding="utf-8")
    assert text.startswith(page.MARK)
    assert "## Static characteristics" in text and "## Proposition 1" in text
    assert "| Force error of the fitted map" in text and "p_v1" not in text
    assert "muscle 1, p_v1" in (report / "out/report.html").read_text(encoding="utf-8")


def test_markdown_shows_every_figure_where_the_page_has_it(report: Path) -> None:
    assert sorted(path.name for path in report.iterdir()) == ["out", "paper", "paper.md"]
    text = (report / "paper.md").read_text(encoding="utf-8")
    shown = re.findall(r"^!\[(.+)\]\((.+)\)$", text, re.MULTILINE)
    assert [place for *_, place in shown] == [
        "paper/static_1.png",
        "paper/static_2.png",
        *(f"paper/influence_{k}.png" for k in range(1, 5)),
    ]
    assert text.count("![") == len(shown)
    assert {path.name for path in (report / "paper").iterdir()} == {Path(place).name for *_, place in shown}
    html = (report / "out/report.html").read_text(encoding="utf-8")
    captions = [unescape(text) for text in re.findall(r"<figcaption>(.+?)</figcaption>", html)]
    assert [title for title, *_ in shown] == captions
    assert text.index("influence_1.png") > text.index("## Proposition 1") > text.index("static_2.png")
    for file in (report / "paper").iterdir():
        content = file.read_bytes()
        assert content.startswith(b"\x89PNG") and 5_000 < len(content) < 120_000, file


def test_docs_that_would_write_over_others_are_refused_before_anything_runs(
    report: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(report / "paper.md", tmp_path)
    (tmp_path / "paper").mkdir()
    (tmp_path / "paper/static_9.png").write_bytes(b"mine")
    (tmp_path / "plain").write_text("", encoding="utf-8")
    for given, says in (("paper.md", "static_9.png"), ("bare", "bare"), ("plain.md", "plain"), ("no/such.md", "no")):
        arguments = ["--only", "static", "--seeds", "1", "--docs", str(tmp_path / given)]
        assert main(["--out", str(tmp_path / "out"), *arguments]) == 2, given
        error = capsys.readouterr().err
        assert says in error and error.count("\n") == 1
        assert not (tmp_path / "out").exists()
    assert (tmp_path / "paper/static_9.png").read_bytes() == b"mine"
