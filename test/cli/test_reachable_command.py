"""``reachable``: what a joint can reach, as a table and as a page."""

from __future__ import annotations

import json

import pytest

from pam_antagonist.cli.reachable import main


@pytest.mark.thorough(6)
def test_the_table_and_the_page_hold_the_set(tmp_path, capsys):
    out = tmp_path / "reach"
    assert main(["--rig", "shin2022", "--out", str(out)]) == 0
    text = capsys.readouterr().out
    assert "it rests at -2" in text and "softest" in text
    report = json.loads((out / "report.json").read_text())
    assert report["angles"][0] < -0.34 and report["angles"][1] > 0.34
    assert all(a <= b + 1e-9 for a, b in zip(report["softest"], report["stiffest"], strict=True))
    assert report["softest"][60] < 4.0 and report["stiffest"][60] > 10.0
    assert "Angle and stiffness" in (out / "report.html").read_text()


def test_narrower_bounds_reach_less(capsys):
    assert main(["--rig", "shin2022", "--lowest-pressure", "300e3", "--supply-margin", "100e3"]) == 0
    assert "300 to 610 kPa" in capsys.readouterr().out
