"""Figures of a battery, their intervals, and detection against size."""

from __future__ import annotations

import pytest
from battery_outcomes import CREEP, DROOP, LEAK, outcome

from validation.battery import page, scores
from validation.battery.draw import LEVELS
from validation.battery.outcomes import Candidate
from validation.battery.places import Found


def test_scores() -> None:
    items = [
        outcome("single", [LEAK], "effect", [("leak", 2)], errors={"recalibrated": 10.0, "extended": 4.0, "true": 2.0}),
        outcome("single", [CREEP], "effect", [DROOP], ambiguous_with=("creep",)),
        outcome("single", [LEAK], "unexplained", leading=[Candidate("leak", 40.0, 20.0, 0.6, 0.7)]),
        outcome("pair", [LEAK, CREEP], "effect", [CREEP]),
        outcome("none"), outcome("none"), outcome("none"), outcome("none", [], "effect", [LEAK]),
        outcome("foreign", [("exchange", None)], "unexplained"),
        outcome("calibration", form=("encoder_zero",), calibrations=("encoder_zero",)),
        outcome("calibration", form=("encoder_zero",)),
    ]  # fmt: skip
    values = {score.what: (score.value, score.count, score.holds) for score in scores.scores(items)}
    assert values["single effect: the right one first"] == (pytest.approx(1.0 / 3.0), 3, False)
    assert values["single effect: and on its muscle"] == (0.0, 1, None)
    assert values["single effect: first, or among those it cannot be told from"] == (pytest.approx(2.0 / 3.0), 3, None)
    leads = values["single effect: named, or the first of the candidates where none explains enough"]
    assert leads == (pytest.approx(2.0 / 3.0), 3, None)
    assert values["two effects: both found"] == (0.0, 1, False)
    assert values["two effects: one of them first"] == (1.0, 1, None)
    assert values["one or two effects, some found: none named that is not there"] == (pytest.approx(2.0 / 3.0), 3, None)
    calibrated = scores.scores([outcome("single", [LEAK], "effect", [LEAK], calibrations=("encoder_zero",)), items[0]])
    assert {score.what: score.value for score in calibrated}[
        "one or two effects, some found: no calibration named, which is not there"
    ] == 0.5
    assert values["nothing: false alarm"] == (0.25, 4, False)
    assert values["a calibration and nothing else: named, and no effect"] == (0.5, 2, False)
    assert values["in no catalogue: unexplained"] == (1.0, 1, True)
    assert values["error that a true model takes away, taken away (median)"] == (pytest.approx(0.75), 1, True)
    assert values["nothing: a law added"] == (0.0, 4, True)
    assert values["two effects: both places"] == (0.0, 1, False)
    at = Found(("exchange",), None, ("pressure_difference",))
    numbers = {"as_configured": 10.0, "extended": 2.4, "true": 2.0, "angle_as_configured": 2.0, "angle_extended": 0.1}
    learned = outcome("foreign", [("check", None)], "effect", [("learned", None)], where=(at,), errors=numbers)
    values = {score.what: score.value for score in scores.scores([learned])}
    assert values["in no catalogue: its place"] == values["in no catalogue: unexplained"] == 1.0
    assert values["one effect, in any form or in no catalogue: and its arguments"] == 1.0
    assert values["in no catalogue: held-out error of the angle, of the configured one (median)"] == 0.05
    assert values["one effect: held-out excess of the configured rig, removed (median)"] == pytest.approx(0.95)
    assert all(score.value is None and score.holds is None for score in scores.scores([]))


def test_confusion_matrix() -> None:
    header, rows = scores.confusion(
        [
            outcome("single", [LEAK], "effect", [LEAK]),
            outcome("single", [LEAK], "effect", [CREEP]),
            outcome("single", [CREEP], "unexplained"),
            outcome("pair", [LEAK, CREEP], "effect", [CREEP]),
            outcome("none"),
            outcome("foreign", [("exchange", None)], "effect", [LEAK]),
        ]
    )
    assert header == ("there \\ found first", "leak", "creep", "none", "unexplained")
    assert rows == (
        ("leak", "1", "1", "·", "·"),
        ("creep", "·", "·", "·", "1"),
        ("none", "·", "·", "1", "·"),
        ("(exchange)", "1", "·", "·", "·"),
    )


def test_intervals_are_those_of_clopper_and_pearson() -> None:
    # Their limits of 38 of 40 and of none of 12, from the beta distribution's quantiles.
    assert scores.Share(38, 40).interval == pytest.approx((0.8308, 0.9939), abs=1e-4)
    assert scores.Share(0, 12).interval == pytest.approx((0.0, 0.2646), abs=1e-4)
    assert scores.Share(0, 0).interval is None and scores.Share(0, 0).value is None
    run = page.Run(1, 2, 0, 0, 0, 60.0, None, [outcome("single", [LEAK], "effect", [LEAK])], {})
    (first, *_) = page.figures_table(run).rows
    assert first[:4] == ("single effect: the right one first", "100.0 %", "2.5 to 100.0 %", "1")


def test_detection_against_size() -> None:
    def found(size: float, *names: tuple[str, int | None]):
        return outcome("single", [LEAK], "effect" if names else "none", names, reached=(size,))

    items = [found(16.5, LEAK), found(8.0, LEAK), found(3.9, LEAK), found(4.2, LEAK), found(2.0, CREEP), found(0.5)]
    leak, every = scores.detections(items)
    assert (leak.effect, every.effect) == ("leak", "")
    assert [(part.hits, part.count) for part in leak.found] == [(0, 1), (0, 0), (0, 1), (2, 2), (1, 1), (1, 1)]
    assert leak.smallest == 4.0 and leak.confusion == 2.0
    # A miss at a large size: the smaller ones do not count as found.
    missed = scores.detections([*items, found(15.0)])[0]
    assert missed.smallest is None and LEVELS[-1] == 16.0
    assert scores.detections([outcome("none")]) == []
