"""A hypothesis that another package adds: it is asked beside the effects and calibrations of the house, and may win."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from pam_antagonist.diagnosis import calibrations, diagnose, search

MINE = """
from dataclasses import replace

from pam_antagonist.diagnosis.hypotheses import Hypothesis, TriedCandidate
from pam_antagonist.inference.gauss_newton import refit


class SwappedValves(Hypothesis):
    def propose(self, now, number, work):
        if now.model.is_at_noise or "swapped_valves" in now.model.effects:
            return []
        swapped = tuple(
            replace(one, trial=replace(one.trial, voltage=one.trial.voltage[:, ::-1])) for one in now.model.experiments
        )
        fits = [refit(one, one.origin) for one in swapped]
        before = replace(now.model, experiments=swapped)
        return [TriedCandidate("swapped_valves", number, 0.0).fitted(now.first, before, fits, ["swapped_valves"])]

    def knows(self, name):
        return name == "swapped_valves"

    def sentence(self, name, muscle, values, sealed=False):
        return "the plugs of the valves are swapped"

    def instead(self, name):
        return "swapped plugs would explain the data as well"

    def experiment(self, name, found=None, sealed=False):
        return "move one valve alone"
"""
ENTRY_POINTS = "[pam_antagonist.hypotheses]\nswapped = mine:SwappedValves\n"


@pytest.fixture
def registered(tmp_path: Path, monkeypatch) -> Iterator[None]:
    (tmp_path / "mine.py").write_text(MINE, encoding="utf-8")
    about = tmp_path / "mine-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n", encoding="utf-8")
    (about / "entry_points.txt").write_text(ENTRY_POINTS, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    # All are scored; fewer fits of what is wrong save time.
    monkeypatch.setattr(search, "_REFITTED", 1)
    monkeypatch.setattr(calibrations, "_FITTED", 0)
    yield
    sys.modules.pop("mine", None)


@pytest.mark.thorough(18)
@pytest.mark.usefixtures("registered")
def test_a_hypothesis_of_another_package_wins_where_it_is_right(rig, recorded) -> None:
    sound = recorded(seconds=20.0)
    swapped = dataclasses.replace(sound, voltage=sound.voltage[:, ::-1].copy())
    found = diagnose([swapped], rig, joint="locked", jobs=1, profiles=False, estimator=False)
    assert found.verdict == "effect"
    assert [effect.name for effect in found.effects] == ["swapped_valves"]
    assert "The plugs of the valves are swapped" in found.sentence
    assert found.ranking[0].effect == "swapped_valves" and found.ranking[0].taken
