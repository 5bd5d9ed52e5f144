"""Whiteness, what goes before a residual, errors of single equations, and what is left of a residual."""

from __future__ import annotations

import re

import numpy as np
import pytest

from pam_antagonist.diagnosis import remaining, residual_statistics
from pam_antagonist.diagnosis.models import Model, recalibrated
from pam_antagonist.diagnosis.remaining import Surroundings
from pam_antagonist.diagnosis.residual_statistics import equation_errors
from pam_antagonist.inference.gauss_newton import Fitted
from pam_antagonist.inference.point import Point
from validation.battery.plants import staircase

STEP = 0.02
COUNT = 1000


def drift(rng: np.random.Generator, memory: float = 0.95) -> np.ndarray:
    """A slow series that has nothing to do with any command."""
    out, noise = np.zeros(COUNT), rng.standard_normal(COUNT)
    for k in range(1, COUNT):
        out[k] = memory * out[k - 1] + noise[k]
    return out


def command(rng: np.random.Generator) -> np.ndarray:
    return staircase(np.arange(1, COUNT + 1) * STEP, rng)[:, 0]


def test_slow_series_that_have_nothing_in_common_pass_as_such() -> None:
    """Without whitening about every second of these pairs would count as related."""
    false, plain = 0, 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        residual, signal = drift(rng), command(rng)
        false += residual_statistics.cross_correlations(residual, {"voltage": signal}, STEP)["voltage"].p < 0.05
        plain += abs(np.corrcoef(residual, signal)[0, 1]) > 1.96 / np.sqrt(COUNT)
    assert false <= 9
    assert plain > 50


def test_an_answer_to_a_command_is_seen_with_its_lag() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        signal = np.repeat(rng.uniform(4.0, 8.0, COUNT // 40), 40)
        late = np.concatenate([np.full(15, signal[0]), signal[:-15]])
        found = residual_statistics.cross_correlations(drift(rng, 0.8) + 3.0 * late, {"voltage": signal}, STEP)[
            "voltage"
        ]
        assert found.p < 1e-3
        assert found.lag_s == pytest.approx(0.3, abs=0.021)
        assert abs(found.z) > found.limit


def test_what_follows_from_the_residual_itself_is_not_read() -> None:
    """A controller answers a residual half a second later; the command then goes with a residual that was before it."""
    hits = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        residual = rng.standard_normal(COUNT)
        signal = np.concatenate([np.zeros(25), residual[:-25]]) + 0.1 * rng.standard_normal(COUNT)
        hits += residual_statistics.cross_correlations(residual, {"voltage": signal}, STEP)["voltage"].p < 0.05
        backwards = np.corrcoef(signal[25:], residual[:-25])[0, 1]
        assert backwards > 0.9
    assert hits <= 5


@pytest.fixture(scope="module")
def sound(recorded, experiment_of):
    experiment = experiment_of(recorded(), "locked")
    return experiment, recalibrated([experiment]).fits[0]


@pytest.fixture(scope="module")
def exchanging(recorded, experiment_of):
    experiment = experiment_of(recorded("exchange", None, "chambers exchange air", 25.0), "locked")
    return experiment, recalibrated([experiment]).fits[0]


def test_a_right_model_leaves_white_noise_of_the_sensors_size(sound) -> None:
    experiment, fitted = sound
    rows = {row.channel: row for row in residual_statistics.statistics(experiment, fitted.point)}
    assert set(rows) == {"mass flow 1", "mass flow 2", "contraction torque", "torque", "pressure_1", "pressure_2"}
    for name, row in rows.items():
        assert row.rms < 1.35 * row.noise, name
        assert row.above_noise < 0.45, name
        assert row.whiteness_p > 1e-4, name
    assert "angle" not in rows["torque"].relations


def test_a_missing_flow_shows_in_the_flows(exchanging) -> None:
    experiment, fitted = exchanging
    rows = {row.channel: row for row in residual_statistics.statistics(experiment, fitted.point)}
    for name in ("mass flow 1", "mass flow 2", "pressure_1", "pressure_2"):
        assert rows[name].rms > 2.0 * rows[name].noise, name
        assert rows[name].whiteness_p < 1e-6, name
    assert rows["pressure_1"].independent < 0.2 * 500


def test_equation_errors_are_those_of_the_equation(rig, recorded, experiment_of) -> None:
    """A leak that the model has in excess is missing in one mass flow, and nowhere else."""
    experiment = experiment_of(recorded(seconds=20.0), "locked")
    fitted = recalibrated([experiment]).fits[0]
    leaking = Point(fitted.point.theta, {"effects.leak.area_1": 5e-9})
    right, wrong = (equation_errors(experiment, point) for point in (fitted.point, leaking))
    change = (wrong.values - right.values).mean(axis=0)
    area, pressure = 5e-9, float(experiment.measured[:, 1].mean())
    choked = area * pressure * 0.6847 / np.sqrt(287.0 * 293.0) * 1e6
    assert change[0] == pytest.approx(choked, rel=0.15)
    assert abs(change[1]) < 0.02 * choked
    assert abs(change[2]) < 0.2 * wrong.noise[2]
    assert np.all(np.std(right.values[:, :3], axis=0) < 1.5 * right.noise[:3])


def test_what_is_left_is_described_with_its_form(exchanging) -> None:
    experiment, fitted = exchanging
    left = {item.channel: item for item in remaining.describe(Model((experiment,), (fitted,)))}
    flow = left["mass flow 1"]
    assert flow.depends_on["pressure"] > max(0.4, flow.depends_on["time"])
    assert set(flow.depends_on) == {"pressure", "command", "time"}, "a locked joint has no length and no direction"
    assert sum(flow.bands.values()) == pytest.approx(1.0)
    assert flow.form.terms and flow.form.held_out > 0.2
    assert any("P_1" in name or "P_2" in name for name, _ in flow.form.terms)
    # Voltage and pressure go together in a locked joint: which of them comes first is chance.
    assert re.search(r"depends on .*pressure", flow.line()) and "Hz" in flow.line()


def test_nothing_is_left_of_a_right_model(sound) -> None:
    experiment, fitted = sound
    assert isinstance(fitted, Fitted)
    assert remaining.describe(Model((experiment,), (fitted,))) == []


def around(seed: int, count: int = 400) -> Surroundings:
    rng = np.random.default_rng(seed)
    voltage = np.repeat(rng.uniform(4.0, 8.0, (count // 10, 2)), 10, axis=0)
    angle = 0.3 * np.sin(np.arange(count) / 9.0)
    return Surroundings(
        1e5 * rng.uniform(1.5, 6.0, (count, 2)), voltage, np.arange(count) * 0.2, angle, np.gradient(angle, 0.2),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "made"),
    [
        ("pressure", lambda a: (a.pressure[:, 0] - a.pressure[:, 1]) / 1e5),
        ("command", lambda a: (a.voltage[:, 1] - 6.0) ** 2),
        ("length", lambda a: 20.0 * a.angle**2),
        ("direction of motion", lambda a: np.sign(a.velocity)),
        ("time", lambda a: 0.05 * a.time),
    ],
)
def test_each_kind_of_dependence_is_told(kind: str, made) -> None:
    here = around(3)
    residual = made(here) + 0.3 * np.random.default_rng(4).standard_normal(len(here.time))
    shares = remaining.shares(residual, here)
    assert max(shares, key=lambda name: shares[name]) == kind
    assert shares[kind] > 0.6
    assert all(share < 0.3 for name, share in shares.items() if name != kind)


def test_a_sparse_regression_finds_the_form_and_is_judged_by_what_it_has_not_seen() -> None:
    here, later = around(5), around(6)

    def made(a: Surroundings) -> np.ndarray:
        return np.asarray(2.0 * a.direction * a.pressure.sum(axis=1) / 1e5)

    rng = np.random.default_rng(7)
    found = remaining.form(made(here) + rng.standard_normal(400), here, (made(later), later))
    assert [name for name, _ in found.terms][0] == "sign ψ̇ (P_1 + P_2)"
    assert found.terms[0][1] == pytest.approx(2.0, rel=0.1)
    assert found.share > 0.9 and found.held_out > 0.95
    nothing = remaining.form(rng.standard_normal(400), here, (made(later), later))
    assert len(nothing.terms) <= 1 and nothing.held_out < 0.1


def test_the_model_has_a_course_where_a_delay_leaves_no_reading(recorded, experiment_of) -> None:
    experiment = experiment_of(recorded(joint="free", seconds=20.0), "free")
    late = Point(experiment.origin.theta, {"calibration.delay_angle": -0.06})
    assert np.isnan(experiment.simulated(late, whole=True)[:, 0]).any()
    assert all(np.isfinite(values).all() for values in experiment.signals(late).values())
