"""Decision rules and what is kept on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.diagnosis import quality, rules
from pam_antagonist.diagnosis.advice import experiments_that_tell
from pam_antagonist.diagnosis.select import Model, Trial
from pam_antagonist.diagnosis.store import Kept, Store
from pam_antagonist.inference.experiment import Point

NO_MODEL = Model((), ())


def trial(number: int, bic: float, held: float, foretold: float = 20.0, share: float | None = None) -> Trial:
    return Trial("leak", number, bic, bic, foretold, (held, held), NO_MODEL, None, held if share is None else share)


def test_evidence_without_held_out_gain_is_not_enough() -> None:
    assert rules.worth(trial(1, 50.0, 0.8))
    assert not rules.worth(trial(1, 50.0, 0.04))
    assert not rules.worth(trial(1, 50.0, 0.8, foretold=1.0))
    assert not rules.worth(trial(1, 1.0, 0.8))
    assert not rules.worth(Trial("leak", 1, 50.0))


def test_what_hardly_pays_where_it_was_fitted_must_foretell_the_more() -> None:
    assert rules.worth(trial(1, 4.0, 0.8, foretold=8.0))
    assert not rules.worth(trial(1, 4.0, 0.8, foretold=7.0))
    assert not rules.worth(trial(1, 9.0, 0.8, foretold=4.0))


def test_a_second_effect_may_be_small_beside_the_first_but_must_be_certain() -> None:
    assert rules.worth(trial(2, 9.0, 0.25))
    assert not rules.worth(trial(2, 9.0, 0.25, foretold=-4.0))
    assert not rules.worth(trial(2, 1.0, 0.9))
    assert not rules.worth(trial(2, 9.0, 0.1))


def test_what_foretells_little_beside_something_unknown_must_be_the_more_certain() -> None:
    assert rules.worth(trial(1, 30.0, 0.4, foretold=4.0))
    assert not rules.worth(trial(1, 19.0, 0.4, foretold=4.0))
    assert not rules.worth(trial(1, 90.0, 0.4, foretold=1.0))


def test_a_further_effect_is_judged_by_both_parts_together() -> None:
    assert rules.worth(trial(2, 24.0, -0.1, foretold=10.0, share=0.3))
    assert not rules.worth(trial(2, 24.0, 0.3, foretold=10.0, share=0.1))
    assert not rules.worth(trial(1, 24.0, -0.1, foretold=10.0, share=0.3))


@pytest.mark.parametrize(
    ("share", "quiet", "explains", "in_part"),
    [
        (0.9, False, True, False),
        (0.5, False, True, True),
        (0.3, False, False, True),
        (-0.5, False, False, True),
        (0.3, True, True, False),
    ],
)
def test_effects_are_the_explanation_of_what_they_take_away(monkeypatch, share, quiet, explains, in_part) -> None:
    monkeypatch.setattr(rules, "share_of_all", lambda experiments, base, model: share)
    monkeypatch.setattr(rules, "at_noise", lambda experiments, model: quiet)
    assert rules.explains((), NO_MODEL, Model(("friction",), ())) is explains
    assert rules.explains_in_part((), NO_MODEL, Model(("friction",), ())) is in_part
    assert not rules.explains((), NO_MODEL, NO_MODEL)


def test_a_finished_candidate_is_found_again(tmp_path: Path) -> None:
    store = Store(tmp_path / "kept")
    point = Point(np.array([0.1, -0.2]), {"effects.leak.area_1": 1e-9})
    store.save("a", Kept(point, 50.0, 12.5))
    found = store.load("a")
    assert found is not None
    assert found.point.theta.tolist() == [0.1, -0.2]
    assert found.point.effects == point.effects
    assert (found.pace, found.gain) == (50.0, 12.5)
    assert store.load("b") is None


@pytest.mark.parametrize("text", ["", "{", "{}", "[1]", '{"theta": [1], "effects": {}, "pace": 1}'])
def test_a_damaged_file_is_worked_out_anew(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.json").write_text(text)
    assert Store(tmp_path).load("a") is None


def test_nothing_is_kept_without_a_folder() -> None:
    Store().save("a", Kept(Point(np.zeros(1)), 1.0, 0.0))
    assert Store().load("a") is None


def test_an_experiment_that_tells_is_named() -> None:
    said = experiments_that_tell(("leak",), ("valve_offset",), {"free"})
    assert "close the valves" in said["valve_offset"]
    assert "locked" in said["valve_offset"]


def estimated(angle: float | None, torque: float) -> dict[str, object]:
    return {"angle": None if angle is None else {"rmse_deg": angle}, "torque": {"rmse_nm": torque}}


def test_an_estimator_that_got_worse_is_told_with_its_numbers() -> None:
    worse = {"recording": "free", "ukf": {"as_configured": estimated(0.07, 0.01), "extended": estimated(0.41, 0.011)}}
    (said,) = quality.estimator_worse([worse])
    assert "0.41°" in said and "0.07°" in said and "free" in said
    locked = {"recording": "held", "ukf": {"as_configured": estimated(None, 0.02), "extended": estimated(None, 0.05)}}
    assert "torque 0.05 N m" in quality.estimator_worse([locked])[0]
    better = {"recording": "free", "ukf": {"as_configured": estimated(0.4, 0.03), "extended": estimated(0.01, 0.01)}}
    assert quality.estimator_worse([better, {"recording": "fitted", "errors": None}]) == []
