"""Thinned data draw the same picture."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pam_antagonist.report import decimate

VALUES = st.lists(st.one_of(st.floats(-1e6, 1e6), st.just(float("nan"))), min_size=1, max_size=400)


@given(VALUES, st.sampled_from([4, 10, 50]))
def test_extremes_survive_and_the_limit_holds(values: list[float], limit: int) -> None:
    array = np.array(values)
    index = decimate.min_max_indices(array, limit)
    assert len(index) <= max(limit, 1)
    assert np.all(np.diff(index) > 0)
    if np.isfinite(array).any():
        assert np.nanmax(array[index]) == np.nanmax(array)
        assert np.nanmin(array[index]) == np.nanmin(array)
    else:
        assert np.isnan(array[index]).all()


def test_what_fits_is_not_touched() -> None:
    assert list(decimate.min_max_indices(np.arange(7.0), 7)) == list(range(7))


@given(VALUES)
def test_a_thinned_band_covers_all_of_the_full_one(values: list[float]) -> None:
    lower = np.array(values)
    upper = lower + 1.0
    limit = 10
    _, low, high = decimate.envelope(lower, upper, limit)
    width = decimate.bucket_width(len(lower), limit)
    for k in range(len(lower)):
        if np.isfinite(lower[k]):
            assert low[k // width] <= lower[k]
            assert high[k // width] >= upper[k]


def test_shares_of_a_category() -> None:
    middle, share = decimate.shares(np.array([0, 0, 1, 2, 2, 2]), 4, 2)
    assert list(middle) == [1, 4]
    assert share.tolist() == [[2 / 3, 0.0], [1 / 3, 0.0], [0.0, 1.0], [0.0, 0.0]]


def test_a_pause_starts_a_new_stretch() -> None:
    stamps = np.array([0, 1, 2, 50, 51]) * 1_000_000
    assert list(decimate.stretches(stamps * 1e-9)) == [0, 0, 0, 1, 1]
    assert len(decimate.stretches(stamps[:0] * 1e-9)) == 0
