"""A rig that is written can be read again, by people too."""

from __future__ import annotations

from pathlib import Path

import pytest

from pam_antagonist.rig import load_rig, rig_names
from pam_antagonist.rig.load import write_rig


@pytest.mark.parametrize("name", rig_names())
def test_what_is_written_is_what_was_there(name: str, tmp_path: Path) -> None:
    rig = load_rig(name, regulators=True)
    write_rig(rig, tmp_path / "rig.yaml", ["Made by a test.", ""])
    assert load_rig(tmp_path / "rig.yaml", regulators=True) == rig


def test_small_and_odd_numbers_survive(tmp_path: Path) -> None:
    rig = load_rig("shin2022")
    odd = rig.replaced(
        name="a: b # c",
        valve_1=rig.valve_1.replaced(inflow_area=5.000000000000001e-08),
        friction=rig.friction.replaced(muscle=1e16 / 3e4),
        joint=rig.joint.replaced(stop=None),
        priors={"friction.shaft": 1e-5},
    )
    write_rig(odd, tmp_path / "rig.yaml")
    again = load_rig(tmp_path / "rig.yaml")
    assert again == odd
    assert again.valve_1.inflow_area == 5.000000000000001e-08


def test_every_number_has_its_unit_beside_it(tmp_path: Path) -> None:
    write_rig(load_rig("shin2022"), tmp_path / "rig.yaml")
    lines = (tmp_path / "rig.yaml").read_text(encoding="utf-8").splitlines()
    section = ""
    for line in lines:
        if line and not line.startswith((" ", "#")):
            section = line.partition(":")[0]
        value = line.partition(": ")[2].partition("#")[0].strip()
        numeric = value.lstrip("[-").replace(".", "", 1)[:1].isdigit()
        if numeric and section not in ("uncertainty", "priors"):
            assert "#" in line, line


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text("mine", encoding="utf-8")
    with pytest.raises(FileExistsError):
        write_rig(load_rig("shin2022"), tmp_path / "rig.yaml")
    assert (tmp_path / "rig.yaml").read_text(encoding="utf-8") == "mine"
