"""One row for each force law: the coefficients that a row names are those of the equation."""

from __future__ import annotations

import typing

import numpy as np
import pytest

from pam_antagonist.model import muscle
from pam_antagonist.model import parameters as par
from pam_antagonist.model.force_forms import FORMS
from pam_antagonist.rig.schema import ModelForm

LENGTH, PRESSURE = 0.17, 400e3
USUAL = {
    "linear": {"v1": 3e-3, "v2": -4e-4, "w1": 800.0, "w2": -150.0},
    "hildebrandt": dict(zip((f"c{k}" for k in range(1, 8)), (5.0, -8.0, 3.0, 12.0, 20.0, -15.0, 4.0), strict=True)),
    "sarosi": dict(zip((f"c{k}" for k in range(1, 7)), (40.0, -12.0, -4.0, 30.0, -8.0, 3.0), strict=True)),
    "polynomial": dict(zip((f"c{k}" for k in range(1, 7)), (5.0, -8.0, 3.0, 12.0, 20.0, -15.0), strict=True)),
    "braided": {"c1": 60.0, "c2": 4.0, "c3": 20.0, "c4": 60.0, "c5": 0.007, "c6": 0.18, "c7": 1.0},
}


def force(name: str, values: dict[str, float]) -> float:
    p = np.zeros(par.SIZE)
    p[par.LENGTH], p[par.ATMOSPHERE], p[par.FORCE_FORM] = 0.185, 101325.0, float(par.FORCE_FORMS.index(name))
    for key, value in values.items():
        p[par.INDEX[f"muscle_1.force.{key}"]] = value
    return float(muscle.force(0, LENGTH, PRESSURE, p))


def test_a_rig_file_knows_every_form_and_no_other() -> None:
    assert typing.get_args(ModelForm.model_fields["force"].annotation) == tuple(FORMS)


@pytest.mark.parametrize("name", FORMS)
def test_a_row_says_what_its_coefficients_do(name: str) -> None:
    form, usual = FORMS[name], USUAL[name]
    assert set(usual) == set(form.units)
    alone = force(name, usual)
    for key, value in usual.items():
        up, down = (force(name, {**usual, key: value * (1.0 + way)}) - alone for way in (1e-3, -1e-3))
        assert up != 0.0, key
        linear = abs(up + down) < 1e-9 * max(abs(up), abs(alone))
        assert linear == (key not in form.bent) or (name == "braided" and abs(up + down) < 1e-2 * abs(up))
    if name != "braided":
        scaled = {**usual, **{key: 1.1 * usual[key] for key in form.gains if key in usual}}
        assert force(name, scaled) == pytest.approx(1.1 * alone, rel=1e-9)
    assert {form.offset, *form.positive, *form.gains, *form.bent} <= set(form.units)
    assert not form.nominal or form.nominal in form.units
