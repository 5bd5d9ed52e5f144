"""A rig of data sheets has the laws that real joints have: braided muscles, closed centres, the weight of a limb."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from pam_antagonist.cli import new_rig
from pam_antagonist.errors import BadInput
from pam_antagonist.model.flow import mass_flow
from pam_antagonist.paths import config_dir
from pam_antagonist.rig import Rig, load_rig

NOMINAL = 0.25


WORDS = (
    "--name elbow --kind pulley --radius 20mm --muscle DMSP-20 --nominal-length 250mm --length 225mm --supply 6bar "
    "--drive valve --voltage 0:10 --inertia 0.03 --mass 1kg --shaft-radius 8mm --stop 40deg --sensor-range 10bar "
    "--sensor-bits 12 --rate 100"
)


def written(path: Path, words: str) -> Rig:
    assert new_rig.main(["--out", str(path), *WORDS.split(), *words.split()]) == 0
    return load_rig(path)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    return written(tmp_path_factory.mktemp("rigs") / "elbow.yaml", "--valve MPYE-5-M5")


@pytest.mark.parametrize(("words", "overlap"), [("", 0.5), ("--valve-centre open", 0.0)])
def test_a_valve_of_no_name_has_a_closed_centre_unless_told(words: str, overlap: float, tmp_path: Path) -> None:
    made = written(tmp_path / "rig.yaml", f"--valve own --valve-flow 50 {words}")
    assert made.valve_1.overlap == overlap and made.valve_1.curve.open_rate == (0.0, 1.0)
    # A closed centre holds a pressure, an open one does not.
    flow = mass_flow(0, 0.5, 3e5, made.parameters())
    assert (flow == 0.0) == (overlap == 0.5)


def test_a_limb_that_was_told_pulls_and_one_that_was_not_widens_the_interval(rig: Rig, tmp_path: Path) -> None:
    told = written(
        tmp_path / "rig.yaml", "--valve MPYE-5-M5 --limb-mass 1kg --limb-distance 15cm --limb-hanging=-60deg"
    )
    weight = told.effects["limb_weight"]
    assert weight["torque"] == pytest.approx(9.81 * 0.15, rel=1e-4)
    assert weight["hanging"] == pytest.approx(-math.pi / 3.0, rel=1e-4)
    unknown = "effects.load_torque.constant"
    assert "limb_weight" not in rig.effects
    # A body of this mass and inertia has its centre at most √(J/m) from the axis.
    assert rig.uncertainty[unknown] == pytest.approx(9.81 * math.sqrt(0.03 * 1.0), rel=1e-4)
    assert told.uncertainty[unknown] < 0.25 * rig.uncertainty[unknown]


def test_a_force_map_of_the_paper_still_needs_its_coefficients(rig: Rig, tmp_path: Path) -> None:
    text = (config_dir() / "rigs" / "shin2022.yaml").read_text("utf-8")
    (tmp_path / "half.yaml").write_text(text.replace("v2: -1.017e-3, ", "", 1), "utf-8")
    with pytest.raises(BadInput, match=r"muscle_1\.force\.v2 is missing: the linear force map needs it"):
        load_rig(tmp_path / "half.yaml")
    assert rig.muscle_1.force.v2 == 0.0, "another form does not"
