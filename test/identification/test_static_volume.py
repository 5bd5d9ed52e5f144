"""Volumes from tables: the parabola comes back with intervals that hold it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.identification.static_table import VolumeTable
from pam_antagonist.identification.static_volume import fit_volume, parabola

TRUTH = np.array([-2.440e-2, 6.824e-3, -4.254e-4])
NOISE = 2e-7


def table(lengths, repeats: int = 1, seed: int = 0, noise: float = NOISE) -> VolumeTable:
    length = np.repeat(np.asarray(lengths, dtype=float), repeats)
    group = np.repeat(np.arange(len(lengths)), repeats)
    volume = parabola(TRUTH, length)[0] + noise * np.random.default_rng(seed).standard_normal(len(length))
    return VolumeTable("t", "", (), length, group, np.ones(len(length)), False, volume)


def test_the_parabola_comes_back():
    fit = fit_volume(table(np.linspace(0.15, 0.18, 5), noise=0.0))
    assert fit.coefficients == pytest.approx(TRUTH, rel=1e-6)
    assert fit.left_out_rmse < 1e-11


@pytest.mark.parametrize("repeats", [1, 3])
def test_intervals_hold_the_truth(repeats):
    lengths = np.linspace(0.15, 0.18, 7)
    fits = [fit_volume(table(lengths, repeats, seed)) for seed in range(60)]
    hits = [np.abs(fit.coefficients - TRUTH) <= fit.reach95 * fit.std for fit in fits]
    assert np.mean(hits) >= 0.90
    middle = np.array([0.165])
    true = parabola(TRUTH, middle)[0]
    inside = [np.abs(fit.volume(middle)[0] - true) <= fit.interval(middle) for fit in fits]
    assert np.mean(inside) >= 0.88
    assert np.median([fit.volume_std(middle)[0] for fit in fits]) < NOISE


def test_errors_at_lengths_left_out_are_those_of_a_fit_without_them():
    measured = table(np.linspace(0.15, 0.18, 6), seed=4)
    fit = fit_volume(measured)
    keep = measured.group != 0
    by_hand = np.polyval(np.polyfit(measured.length[keep], measured.volume[keep], 2), measured.length[0])
    assert fit.left_out[0] == pytest.approx(abs(by_hand - measured.volume[0]), rel=1e-4)
    assert fit.left_out_rmse > fit.fitted_rmse


def test_three_volumes_have_no_error_bars_unless_their_own_are_known():
    measured = table([0.15, 0.165, 0.18])
    fit = fit_volume(measured)
    assert np.all(np.isnan(fit.std)) and np.all(np.isnan(fit.left_out))
    known = fit_volume(replace(measured, spread=np.full(3, NOISE), declared=True))
    assert known.volume_std(measured.length) == pytest.approx([NOISE] * 3, rel=1e-6)


def test_lengths_that_are_nearly_the_same_are_refused():
    with pytest.raises(BadInput, match="at least 3 lengths that are well apart"):
        fit_volume(table([0.165, 0.165 + 1e-12, 0.165 + 2e-12]))
