"""``commission``: what it refuses."""

from __future__ import annotations

import json

from pam_antagonist.cli import commission, commission_steps
from pam_antagonist.nodes.processes import ProcessFailed


def test_a_folder_of_something_else_stays_as_it_is(tmp_path, capsys):
    assert commission.main(["--rig", "shin2022", "--out", str(tmp_path), "--unattended"]) == 2
    assert "but commission did not write it" in capsys.readouterr().err
    (tmp_path / "state.json").write_text(json.dumps({"rig": "another", "steps": {}}))
    assert commission.main(["--rig", "shin2022", "--out", str(tmp_path), "--unattended"]) == 2
    assert "was begun with --rig another" in capsys.readouterr().err
    (tmp_path / "state.json").write_text("no json")
    assert commission.main(["--rig", "shin2022", "--out", str(tmp_path), "--unattended"]) == 2
    assert "state.json" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["state.json"]


def test_the_report_of_a_run_that_failed_says_so_first(tmp_path, capsys, monkeypatch):
    def drive(*_: object) -> None:
        raise ProcessFailed("plant ended with status 2: the supply is off")

    monkeypatch.setattr(commission_steps, "drive", drive)
    out = tmp_path / "new"
    arguments = ["--rig", "shin2022", "--out", str(out), "--unattended", "--source", "rehearsal"]
    assert commission.main(arguments) == 1
    assert "the supply is off" in capsys.readouterr().err
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "All is done" not in page
    first = page.index("<p", page.index("<h1"))
    assert "Step wiring failed: plant ended with status 2: the supply is off." in page[first : first + 300]
    assert "Not begun: free, locked, identify" in page
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert not report["steps"][0]["done"] and "gains" in report["left"]
