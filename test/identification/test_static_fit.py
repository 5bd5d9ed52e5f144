"""Fits to tables: the truth comes back with intervals that hold it, and slack points do not bend a force map."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import norm

from pam_antagonist.identification.static_fit import UNITS, VOLUME, TableForm, compare_forms, fit, largest, rms
from pam_antagonist.identification.static_table import StaticTable, read_force_map
from pam_antagonist.identification.tobit import Undetermined, solve
from pam_antagonist.model import parameters as par

MAP = Path(__file__).resolve().parents[3] / "shared" / "data" / "measured" / "force_maps" / "dmsp_20_300.csv"
REST, OUTSIDE = 0.165, 101.3e3
LENGTHS = np.linspace(0.147, 0.182, 7)
PRESSURES = np.linspace(120e3, 700e3, 10)
FORMS = tuple(form for form in UNITS if form != VOLUME)
TRUTH = {
    # Muscles that are slack at a third of the points.
    "linear": (9.0e-3, -1.25e-3, 900.0, -190.0),
    "hildebrandt": (22.0, -110.0, 60.0, -30.0, -60.0, 90.0, -300.0),
    "sarosi": (12.0, 20.0, -9.0, -60.0, 5.0, -40.0),
    "polynomial": (-25.0, -60.0, 18.0, 90.0, -90.0, 0.4),
    "braided": (22.0, 3.0, 25.0, 50.0, 0.012, 0.182, 0.7336),
}
NOISE = 0.8


def table(form: str, seed: int, noise: float = NOISE, together: float = 0.0) -> StaticTable:
    """A measured map: noise on each force, and an error that all forces at a length share."""
    rng = np.random.default_rng(seed)
    length, pressure = (grid.ravel() for grid in np.meshgrid(LENGTHS, PRESSURES))
    group = np.tile(np.arange(len(LENGTHS)), len(PRESSURES))
    force = TableForm(form, REST, OUTSIDE).value(np.array(TRUTH[form]), length, pressure)
    force = force + noise * rng.standard_normal(len(force)) + together * rng.standard_normal(len(LENGTHS))[group]
    # This map is above 0 everywhere: a sensor shows nothing below 1.5 N.
    limit = 1.5 if form == "braided" else 0.0
    slack = force <= limit
    ones = np.ones(len(force))
    return StaticTable("t", length, np.maximum(force, 0.0), pressure, group, ones, False, slack, limit, OUTSIDE)


def worst(found, form: str) -> float:
    """Largest error of the fitted map where the muscle really pulls [N]."""
    length, pressure = (grid.ravel() for grid in np.meshgrid(np.linspace(0.147, 0.182, 15), PRESSURES))
    true = TableForm(form, REST, OUTSIDE).value(np.array(TRUTH[form]), length, pressure)
    return float(np.max(np.abs(found.value(length, pressure) - true)[true > 0.0]))


def test_every_form_of_the_model_can_be_fitted():
    assert FORMS == par.FORCE_FORMS


@pytest.mark.parametrize("form", FORMS)
def test_coefficients_come_back_from_exact_forces(form):
    measured = table(form, 0, noise=0.0)
    assert 0.1 < np.mean(measured.slack) < 0.6
    found = fit(measured, form, REST)
    assert found.coefficients == pytest.approx(TRUTH[form], rel=2e-3, abs=1e-6)
    assert found.left_out_rmse < 0.02 and worst(found, form) < 0.02


@pytest.mark.slow(5)
@pytest.mark.parametrize("form", FORMS)
def test_intervals_hold_the_truth(form):
    hits, widths = [], []
    for seed in range(12 if form == "sarosi" else 30):
        found = fit(table(form, seed), form, REST)
        fitted = found.std > 0.0
        hits.append((np.abs(found.coefficients - TRUTH[form]) <= found.reach95 * found.std)[fitted])
        widths.append(found.value_std(np.array([REST]), np.array([500e3]))[0])
    assert np.mean(hits) >= 0.90
    # Wide intervals hold everything; dozens of forces tell more than one.
    assert np.median(widths) < 0.6 * NOISE


def test_errors_that_a_length_shares_widen_the_intervals():
    alone, together = [], []
    for seed in range(40):
        measured = table("linear", seed, together=4.0)
        found = fit(measured, "linear", REST)
        at = measured.length, measured.pressure
        design = np.column_stack([TableForm("linear", REST, OUTSIDE).value(e, *at) for e in np.eye(4)])
        plain = solve(design, measured.value, measured.slack, measured.spread, False, 4)
        assert plain.coefficients == pytest.approx(found.coefficients, rel=1e-6)
        error = np.abs(found.coefficients - TRUTH["linear"])
        together.append(error <= found.reach95 * found.std)
        alone.append(error <= found.reach95 * np.sqrt(np.diag(plain.covariance)))
    assert np.mean(alone) < 0.85
    assert np.mean(together) >= 0.9


def test_a_fit_that_takes_slack_for_a_measured_zero_is_wrong():
    measured = table("linear", 3)
    right = fit(measured, "linear", REST)
    taken = fit(replace(measured, slack=np.zeros(len(measured), dtype=bool)), "linear", REST)
    assert worst(right, "linear") < 1.5 * NOISE
    assert worst(taken, "linear") > 10.0


def test_leaving_slack_points_out_is_biased_and_keeping_them_is_not():
    """Where noise is large, forces that happen to come out below 0 are missing from those that are left."""
    kept, dropped = [], []
    for seed in range(60):
        measured = table("linear", seed, noise=8.0)
        at = np.array([0.15]), np.array([300e3])
        true = TableForm("linear", REST, OUTSIDE).value(np.array(TRUTH["linear"]), *at)[0]
        kept.append(fit(measured, "linear", REST).value(*at)[0] - true)
        dropped.append(fit(measured.part(~measured.slack), "linear", REST).value(*at)[0] - true)
    assert abs(np.mean(dropped)) > 4.0 * np.std(dropped) / np.sqrt(len(dropped))
    assert abs(np.mean(kept)) < 0.5 * abs(np.mean(dropped))


def test_the_likelihood_is_that_of_the_textbook():
    rng = np.random.default_rng(1)
    design = np.column_stack([np.ones(60), rng.uniform(-2.0, 2.0, 60)])
    value = design @ [0.5, 1.5] + 0.7 * rng.standard_normal(60)
    censored = value < 0.2

    def cost(x):
        left = design @ x[:2]
        scale = np.exp(x[2])
        return -(
            norm.logpdf(value[~censored], left[~censored], scale).sum()
            + norm.logcdf((0.2 - left[censored]) / scale).sum()
        )

    best = minimize(
        cost, [0.0, 1.0, 0.0], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12, "maxiter": 5000}
    )
    found = solve(design, np.where(censored, 0.2, value), censored, np.ones(60), False, 2)
    assert found.coefficients == pytest.approx(best.x[:2], abs=1e-6)
    count = int(np.sum(~censored))
    assert found.scale == pytest.approx(np.exp(best.x[2]) * np.sqrt(count / (count - 2)), rel=1e-6)


def test_without_slack_points_it_is_least_squares():
    measured = table("linear", 5)
    measured = replace(measured, value=measured.value + 500.0, slack=np.zeros(len(measured), dtype=bool))
    length, pressure = measured.length, measured.pressure
    design = np.column_stack([length * pressure, pressure, length, np.ones(len(length))])
    inside = measured.group == 2
    without = np.linalg.lstsq(design[~inside], measured.value[~inside], rcond=None)[0]
    found = fit(measured, "linear", REST)
    errors = design[inside] @ without - measured.value[inside]
    assert found.left_out[2].errors == pytest.approx(errors, abs=1e-5)
    assert rms(found.left_out[2].errors) == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-5)
    whole, rss = np.linalg.lstsq(design, measured.value, rcond=None)[:2]
    assert found.coefficients == pytest.approx(whole, rel=1e-6)
    assert found.scale == pytest.approx(np.sqrt(rss[0] / (len(length) - 4)), rel=1e-6)


def test_a_declared_deviation_weighs_and_is_not_shrunk():
    measured = table("linear", 7, noise=0.01)
    spoilt = measured.group == 1
    force = np.where(spoilt & ~measured.slack, measured.value + 60.0, measured.value)
    believed = fit(replace(measured, value=force), "linear", REST)
    spread = np.where(spoilt, 1e4, 2.0)
    weighed = fit(replace(measured, value=force, spread=spread, declared=True), "linear", REST)
    assert worst(weighed, "linear") < 0.1 < worst(believed, "linear")
    # 2 N were declared: that it agrees to 0.01 N is luck.
    assert weighed.scale == 1.0
    assert weighed.value_std(np.array([REST]), np.array([450e3]))[0] > 0.2


def test_too_few_lengths_for_a_form_are_said():
    measured = table("linear", 1).part(np.isin(table("linear", 1).group, (4, 5)))
    found = compare_forms(measured, REST)
    assert isinstance(found["hildebrandt"], Undetermined) and "cannot tell" in str(found["hildebrandt"])
    linear = found["linear"]
    assert not isinstance(linear, Undetermined)
    assert np.isnan(linear.left_out_rmse)
    assert any("too small" in note for note in linear.notes)


def test_the_form_that_made_the_data_errs_least_where_it_was_not_fitted():
    for form in ("linear", "sarosi"):
        found = compare_forms(table(form, 2), REST)
        errors = {name: one.left_out_rmse for name, one in found.items()}
        assert errors[form] < 1.6 * NOISE
        if form == "sarosi":
            assert errors["linear"] > 3.0 * errors["sarosi"]


@pytest.mark.skipif(not MAP.exists(), reason="no ../shared/data/measured beside the project")
def test_the_measured_map():
    measured = read_force_map(MAP, 101.3e3)
    assert (len(measured), measured.lengths, int(measured.slack.sum())) == (126, 6, 66)
    found = compare_forms(measured, 0.3)
    errors = {name: one.left_out_rmse for name, one in found.items() if name != "braided"}
    assert errors == pytest.approx(
        {"linear": 133.6, "hildebrandt": 57.1, "sarosi": 109.9, "polynomial": 119.4}, abs=0.1
    )
    # A fit says little about lengths that it has not seen.
    assert found["hildebrandt"].fitted_rmse < 0.15 * errors["hildebrandt"]
    # The contraction's zero is a convention: errors do not depend on it.
    other = compare_forms(measured, 0.26)
    assert {name: other[name].left_out_rmse for name in errors} == pytest.approx(errors, rel=1e-3)


@pytest.mark.skipif(not MAP.exists(), reason="no ../shared/data/measured beside the project")
def test_a_braided_map_has_the_measured_forces_to_two_per_cent_where_it_was_not_fitted():
    measured = read_force_map(MAP, 101.3e3)
    bound = 0.02 * measured.value.max()
    found = fit(measured, "braided", 0.27)
    assert largest(found.errors) < bound
    lengths = [item for item in found.left_out if item.measured]
    assert [largest(item.errors) < bound and item.overshoot < bound for item in lengths[:-1]] == [True] * 4
    # The longest length lies beyond the others, where the rubber begins to pull: there the nominal length helps.
    assert largest(fit(measured, "braided", 0.27, 0.3).left_out_errors) < 0.5 * largest(lengths[-1].errors)
    pressures = np.unique(measured.pressure)
    for first in (0, 1):
        left_out = np.isin(measured.pressure, pressures[first::2])
        there = measured.part(left_out)
        predicted = fit(measured.part(~left_out), "braided", 0.27).value(there.length, there.pressure)
        assert np.max(np.abs(predicted - there.value)) < bound
    # Physical by their signs: the force grows with the pressure and falls with the contraction, and never pushes.
    assert np.all(found.coefficients[:4] > 0.0) and np.min(found.value(measured.length, measured.pressure)) > 0.0


PARABOLA = np.array([-2.440e-2, 6.824e-3, -4.254e-4])
VOLUME_NOISE = 2e-7


def cylinder(lengths, repeats: int = 1, seed: int = 0, noise: float = VOLUME_NOISE) -> StaticTable:
    length = np.repeat(np.asarray(lengths, dtype=float), repeats)
    group = np.repeat(np.arange(len(lengths)), repeats)
    volume = TableForm(VOLUME).value(PARABOLA, length) + noise * np.random.default_rng(seed).standard_normal(
        len(length)
    )
    ones = np.ones(len(length))
    return StaticTable("t", length, volume, 0.0 * ones, group, ones, False, ones < 0.0)


@pytest.mark.parametrize("repeats", [1, 3])
def test_intervals_hold_the_parabola(repeats):
    lengths = np.linspace(0.15, 0.18, 7)
    fits = [fit(cylinder(lengths, repeats, seed), VOLUME) for seed in range(60)]
    hits = [np.abs(found.coefficients - PARABOLA) <= found.reach95 * found.std for found in fits]
    assert np.mean(hits) >= 0.90
    middle = np.array([0.165])
    true = TableForm(VOLUME).value(PARABOLA, middle)
    inside = [np.abs(found.value(middle) - true) <= found.reach95 * found.value_std(middle) for found in fits]
    assert np.mean(inside) >= 0.88
    assert np.median([found.value_std(middle)[0] for found in fits]) < VOLUME_NOISE


def test_three_volumes_have_no_error_bars_unless_their_own_are_known():
    measured = cylinder([0.15, 0.165, 0.18])
    found = fit(measured, VOLUME)
    assert np.all(np.isnan(found.std)) and np.isnan(found.left_out_rmse)
    known = fit(replace(measured, spread=np.full(3, VOLUME_NOISE), declared=True), VOLUME)
    assert known.value_std(measured.length) == pytest.approx([VOLUME_NOISE] * 3, rel=1e-6)
