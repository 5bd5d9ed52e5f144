"""Adding is short: a force law takes two files, a place of laws one row, a way of driving one class.

Hypothesis and verdict have other tests.
"""

from __future__ import annotations

import dataclasses
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

import pam_antagonist
from pam_antagonist.diagnosis import diagnose, law_search
from pam_antagonist.diagnosis.hypotheses import Work
from pam_antagonist.diagnosis.preparation import Group
from pam_antagonist.diagnosis.search import search
from pam_antagonist.diagnosis.splits import by_itself_or_in_turn
from pam_antagonist.inference.experiment import Experiment, Floats
from pam_antagonist.inference.free_parameters import Candidate, base_directions, candidates
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, make_trial
from pam_antagonist.inference.unknown import Unknown
from pam_antagonist.inference.valve_driven import TITLES
from pam_antagonist.model.drive import Inputs
from pam_antagonist.model.effects import CATALOGUE, places
from pam_antagonist.model.effects.places import SENSORS, Place
from pam_antagonist.paths import config_dir

SOURCE = Path(pam_antagonist.__file__).parent
FORM = {
    "model/force_forms.py": {
        '    "polynomial": ': (
            '    "exponential": ForceForm(_newtons(2, c2="-"), ("c1",), "", ("c1", "c2"), ("c2",)),\n'
        ),
    },
    "model/muscle.py": {
        "_UNIT_PRESSURE = 1e5": '_EXPONENTIAL = float(FORCE_FORMS.index("exponential"))\n',
        "    if form == _HILDEBRANDT:\n        area": (
            "    if form == _EXPONENTIAL:\n        return p[c] * q * exp(-p[c + 1] * k)\n"
        ),
        "    if form == _HILDEBRANDT:\n        slope": (
            "    if form == _EXPONENTIAL:\n        return p[c + 1] * p[c] * q * exp(-p[c + 1] * k) / p[LENGTH]\n"
        ),
    },
}
"""The law F = c1 q exp(-c2 k) of 1 - l/L_0 = k and P/100 kPa = q: what is put in, before which line, in two files."""
SCRIPT = """
import math
from pathlib import Path
from pam_antagonist.model import muscle
from pam_antagonist.rig import load_rig

own = "\\n".join(f"muscle_{i}: {{force: {{c1: 40.0, c2: 6.0}}}}" for i in (1, 2))
Path("own.yaml").write_text(f"based_on: shin2022\\nname: own\\nmodel: {{force: exponential}}\\n{own}\\n")
rig = load_rig("own.yaml")
p = rig.parameters("free")
for length, pressure in ((0.16, 3e5), (0.17, 5e5)):
    wanted = 40.0 * pressure / 1e5 * math.exp(-6.0 * (1.0 - length / rig.geometry.length))
    assert math.isclose(muscle.force(0, length, pressure, p), wanted, rel_tol=1e-12)
    low, high = (muscle.force(0, length + side, pressure, p) for side in (-1e-6, 1e-6))
    assert math.isclose(muscle.force_length_slope(0, length, pressure, p), (high - low) / 2e-6, rel_tol=1e-6)
print("adds up")
"""


@pytest.mark.slow(8)
def test_a_force_law_takes_two_files(tmp_path: Path) -> None:
    copied = tmp_path / "pam_antagonist"
    shutil.copytree(SOURCE, copied, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(config_dir(), tmp_path / "share" / "pam_antagonist" / "config")
    for name, insertions in FORM.items():
        text = (copied / name).read_text(encoding="utf-8")
        for before, new in insertions.items():
            assert text.count(before) == 1
            text = text.replace(before, new + before)
        (copied / name).write_text(text, encoding="utf-8")
    path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    surroundings = {**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], cwd=tmp_path, env=surroundings, capture_output=True, text=True, check=False
    )
    assert done.stdout.strip() == "adds up", done.stderr


@pytest.mark.slow(20)
def test_a_place_is_one_row(rig, recorded, monkeypatch) -> None:
    row = Place("the bracket of the torque meter", "N m", (), (), SENSORS, (), ("angle",), (), 1e-3, reads="torque")
    monkeypatch.setitem(places.TABLE, "bracket", row)
    sound = recorded(seconds=30.0, joint="free")
    bent = dataclasses.replace(sound, torque=sound.torque + 0.05 * np.sin(40.0 * sound.angle))
    model = diagnose([bent], rig, joint="free", jobs=1, profiles=False, estimator=False).recalibrated
    found = law_search.search(model, lambda words: None)
    assert found.places[0].name == "bracket"
    assert found.law is not None and found.law.where == "the bracket of the torque meter"
    wanted = 0.05 * np.sin(40.0 * np.array(found.law.nodes))
    assert np.abs(np.array(found.law.values) - wanted).max() < 0.015


HOOKS = {"joint_torque", "muscle_force", "contraction_force", "coulomb_torque"}
"""Where an effect acts on the joint: the air is given."""


class AlongPressures(Experiment):
    """A way of driving of one's own: the measured pressures are given, and the angle of a free joint is compared."""

    channels = (ANGLE,)
    titles = (TITLES[ANGLE],)
    runs_by_itself = True

    @property
    def directions(self) -> tuple[Unknown, ...]:
        return base_directions(self.rig)

    @property
    def noise(self) -> Floats:
        return np.array([self.trial.noise(ANGLE)])

    def candidates(self, taken: Mapping[str, float]) -> tuple[Candidate, ...]:
        return tuple(one for one in candidates(taken) if HOOKS & set(CATALOGUE[one.effect].hooks))

    def simulated_each(self, points: Sequence[Point], whole: bool = False) -> list[Floats]:
        trial = self.trial if whole else self.trial.part(0.0, self.fitted * self.trial.dt)
        pressure, angle = trial.measured[:, PRESSURE_1:], trial.measured[:1, ANGLE]
        along = Inputs.even(len(trial), trial.dt, trial.substeps, pressure=pressure)
        vectors = [self.parameters(point) for point in points]
        starts = [along.settled(angle, pressure[:1], p) for p in vectors]
        return [states[:, :4] for states, _ in along.driven_each(starts, vectors)]

    def states(self, point: Point) -> tuple[Floats, Floats]:
        states = self.simulated(point, whole=True)
        return states, np.zeros(len(states))


@pytest.mark.slow(8)
@pytest.mark.parametrize(("size", "wanted"), [(0.0, ()), (6.0, ("hysteresis",))])
def test_a_way_of_driving_is_one_class(rig, recorded, size: float, wanted: tuple[str, ...]) -> None:
    what = {"effect": "hysteresis", "form": "dahl", "size": size} if size else {}
    trial = make_trial(recorded(joint="free", **what), rig, "free", 0.0, "free")
    experiment = AlongPressures(rig, trial, len(trial) * 2 // 3 // 100 * 100)
    found = search(by_itself_or_in_turn(Group("joint", (experiment,), (0,))), Work())
    assert found.model.effects == wanted
