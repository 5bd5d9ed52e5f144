"""A rig of data sheets gets the laws that real joints have, with the numbers of the same data sheets."""

from __future__ import annotations

import numpy as np
import pytest

from pam_antagonist.cli import new_rig
from pam_antagonist.model import muscle
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.new import is_from_data_sheet, with_base_laws
from pam_antagonist.rig.parts import muscle_parts

NOMINAL, LENGTH = 0.25, 0.225


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    path = tmp_path_factory.mktemp("rigs") / "elbow.yaml"
    words = (
        "--name elbow --kind pulley --radius 20mm --muscle DMSP-20 --nominal-length 250mm --length 225mm --supply 6bar "
        "--drive valve --valve MPYE-5-M5 --voltage 0:10 --inertia 0.03 --mass 1kg --shaft-radius 8mm --stop 40deg "
        "--sensor-range 10bar --sensor-bits 12 --rate 100"
    )
    assert new_rig.main(["--out", str(path), *words.split()]) == 0
    return load_rig(path)


def test_the_force_is_that_of_the_data_sheet(rig: Rig) -> None:
    part, p = muscle_parts()["DMSP-20"], with_base_laws(rig).parameters()
    outside = rig.atmosphere.pressure
    assert muscle.force(0, NOMINAL, outside + part.pressure, p) == pytest.approx(part.force, rel=0.10)
    contracted = NOMINAL * (1.0 - part.contraction)
    assert muscle.force(0, contracted, outside + part.pressure, p) < 0.02 * part.force
    # The linear map is the same where both were taken from the data sheet.
    lengths = np.linspace(0.21, 0.245, 5)
    pair = [[muscle.force(1, length, outside + 4e5, q) for length in lengths] for q in (p, rig.parameters())]
    assert np.allclose(*pair, atol=0.15 * part.force)


def test_a_valve_with_a_guessed_curve_gets_a_closed_centre(rig: Rig) -> None:
    made = with_base_laws(rig)
    assert made.valve_1.overlap == 0.5 and made.valve_1.curve.open_rate == (0.0, 1.0)
    assert made.valve_1.inflow_area == rig.valve_1.inflow_area


def test_a_rig_that_was_identified_or_is_not_of_a_data_sheet_stays(rig: Rig) -> None:
    assert is_from_data_sheet(rig)
    assert not is_from_data_sheet(rig.replaced(identified="free_bag"))
    assert not is_from_data_sheet(with_base_laws(rig))
    assert not is_from_data_sheet(load_rig("shin2022"))
