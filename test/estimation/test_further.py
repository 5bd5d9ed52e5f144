"""Further signals and weak laws in the filter: against their sums by hand, and against an effect that does the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pam_antagonist import Estimator, load_rig, replay, simulate
from pam_antagonist.estimation.further import FADING, OWN, PLACES, FurtherInputs, fading
from pam_antagonist.inference.weak_features import coefficients, features, inputs_of
from pam_antagonist.recording import Recording
from pam_antagonist.recording.recording import FurtherSignal
from pam_antagonist.rig import Rig

RIG = load_rig("shin2022")
SAMPLES = 400
RNG = np.random.default_rng(7)


def with_laws(numbers: dict[str, dict[str, float]], signals: dict[str, float] | None = None) -> Rig:
    names = [*OWN, *(signals or {})]
    laws = {"middle": {**dict.fromkeys(OWN, 4e5), **dict.fromkeys(names[2:], 0.0)},
            "range": dict.fromkeys(names, 2e5), "numbers": numbers}  # fmt: skip
    acting = {"amount": 1.0, "angle": 0.5, "velocity": 0.5}
    return RIG.replaced(signals=signals or {}, effects={**RIG.effects, "weak_laws": acting}, weak_laws=laws)


@pytest.fixture(scope="module")
def recorded() -> Recording:
    return simulate(RIG, duration=2.0, seed=3)


def test_coefficients_are_the_sums_of_their_features() -> None:
    names = ("pressure_1", "pressure_2", "other")
    pressure, other = 4e5 + 2e5 * RNG.standard_normal((SAMPLES, 2)), 2e5 * RNG.standard_normal(SAMPLES)
    time, first = np.cumsum(RNG.uniform(5e-3, 15e-3, SAMPLES)), np.array([0, 150, SAMPLES])
    rig = with_laws({}, {"other": 3e5})
    assert rig.weak_laws is not None
    known = features(inputs_of(rig.weak_laws, pressure, other[:, None], ["other"]), first, time)
    late = [fading(name, time) for name in names for time in FADING]
    assert {*late, "pressure_1^3", "other*other", "pressure_2 within 0.3 s*other"} <= set(known)
    numbers = {place: dict(zip(known, RNG.standard_normal(len(known)).tolist(), strict=True)) for place in PLACES}
    found = coefficients(with_laws(numbers, {"other": 3e5}), pressure, other[:, None], first, time)
    for place, of_place in numbers.items():
        expected = sum(value * known[name] for name, value in of_place.items())
        assert found[:, PLACES.index(place)] == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_one_sample_at_a_time_gives_the_bits_of_all_at_once_and_a_missing_signal_is_its_value_in_the_file() -> None:
    numbers = {"torque": {"pressure_1*other": 0.2, "other within 0.1 s": 0.1}, "friction": {"pressure_2": 0.05}}
    rig = with_laws(numbers, {"other": 3e5})
    stamps = np.cumsum(RNG.integers(5_000_000, 15_000_000, SAMPLES))
    pressure, other = 4e5 + 1e5 * RNG.standard_normal((SAMPLES, 2)), 3e5 + 1e5 * RNG.standard_normal((SAMPLES, 1))
    other[::7] = np.nan
    whole, single = (FurtherInputs(rig) for _ in range(2))
    every = whole.follow(stamps, pressure, other)
    each = []
    for k in range(SAMPLES):
        single.step(int(stamps[k]), pressure[k : k + 1], other[k])
        each.append(single.now[0].copy())
    assert np.array_equal(every, each)
    assert not every[::7, 0].any() and every[1::7, 0].all()
    whole.reset()
    filled = whole.follow(stamps, pressure, np.where(np.isnan(other), 3e5, other))
    assert np.array_equal(every, filled)


def test_a_weak_law_that_goes_with_the_angle_acts_on_the_filter_as_a_spring(recorded: Recording) -> None:
    stiffer = RIG.replaced(joint=RIG.joint.replaced(stiffness=RIG.joint.stiffness + 0.4))
    samples = recorded.stamp_ns, recorded.pressure, recorded.voltage
    one, other, without = (Estimator(rig).run(*samples).rows["angle"][50:] for rig in
                           (with_laws({"torque*angle": {"constant": -0.4 * 0.5}}), stiffer, RIG))  # fmt: skip
    assert np.max(np.abs(one - other)) < 0.01 * np.max(np.abs(one - without)) and np.ptp(without) > 0.02


def test_the_filter_takes_a_signal_at_each_sample_live_and_over_a_recording(recorded: Recording) -> None:
    rig = with_laws({"torque": {"other": 0.3}}, {"other": 0.0})
    pushed = 2e5 * np.sin(4.0 * recorded.time_s)
    estimator, live = Estimator(rig), Estimator(rig)
    rows = estimator.run(recorded.stamp_ns, recorded.pressure, recorded.voltage, signals={"other": pushed}).rows
    given = zip(recorded.stamp_ns.tolist(), recorded.pressure, recorded.voltage, pushed, strict=True)
    alone = [live.step(stamp, *p, *u, signals=[s]) for stamp, p, u, s in given]
    assert np.array_equal(rows["angle"], [row["angle"] for row in alone if row is not None])
    nothing = Estimator(rig).run(recorded.stamp_ns, recorded.pressure, recorded.voltage).rows
    plain = Estimator(RIG).run(recorded.stamp_ns, recorded.pressure, recorded.voltage).rows
    assert nothing["angle"] == pytest.approx(plain["angle"], abs=1e-9)
    assert np.max(np.abs(rows["torque"] - nothing["torque"])[50:]) > 0.05


def test_replay_reads_further_signals_and_says_where_one_is_missing(recorded: Recording) -> None:
    """A joint whose torque goes with another pressure, which only one of two models knows."""
    rig = with_laws({"torque": {"other": 0.3}}, {"other": 0.0})
    pushed = 2e5 * np.sin(4.0 * recorded.time_s)
    estimated = Estimator(rig).run(recorded.stamp_ns, recorded.pressure, recorded.voltage, signals={"other": pushed})
    angle = np.full(len(recorded), np.nan)
    angle[estimated.index] = estimated.rows["angle"]
    signal = FurtherSignal(pushed, "Pa")
    known, unknown = replace(recorded, angle=angle, signals={"other": signal}), replace(recorded, angle=angle)
    read, missed = (replay(one, rig).report for one in (known, unknown))
    assert read.ukf.angle is not None and missed.ukf.angle is not None
    assert read.ukf.angle.rmse < 1e-9 and missed.ukf.angle.rmse > 0.1
    assert not [issue for issue in read.recording.issues if "signal" in str(issue)]
    (said,) = [str(issue) for issue in missed.recording.issues if "signal other is missing throughout" in str(issue)]
    assert "its value in the rig file" in said
