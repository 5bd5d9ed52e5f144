"""Models side by side are the models one by one, bit for bit, whatever they have and wherever they go."""

from __future__ import annotations

import inspect
import math
import sys

import numpy as np
import pytest

from pam_antagonist._jit import in_place, inlined
from pam_antagonist.model import (
    composition,
    drive,
    dynamics,
    equilibrium,
    lane_drive,
    lane_form,
    lane_values,
    lanes,
    numeric,
)
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import CATALOGUE, parameter_path
from pam_antagonist.rig.file import load_rig

SAMPLES = 1500
BASE = ("muscle_1.force.v1", "valve_1.inflow_area", "gas.temperature", "geometry.radius", "joint.inertia")


def inputs(unit: float = 1.0) -> np.ndarray:
    """Voltages that jump, with a torque from outside (N, 3)."""
    rng = np.random.default_rng(3)
    jumps = np.repeat(rng.normal(0.0, 1.2, (SAMPLES // 100, 2)), 100, axis=0)
    return np.column_stack([5.0 + jumps, 0.1 * np.sin(np.arange(SAMPLES) / 200.0)]) * unit


@pytest.fixture(autouse=True)
def _whatever_the_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lanes are tried on every machine, also where they are no quicker."""
    monkeypatch.setattr(drive, "FEWEST", 2)


def assert_same(vectors: list[np.ndarray], given: np.ndarray) -> None:
    starts = [equilibrium.initial_state(0.05, 3e5, 2.5e5, given[0], p) for p in vectors]
    along = drive.Inputs.even(len(given), 1e-3, command=given)
    together = along.driven_each([x[None] for x in starts], vectors, drive.TORQUE)
    for x, p, (states, shown) in zip(starts, vectors, together, strict=True):
        alone = drive.course(x, given, p, 1e-3, 1)
        assert np.array_equal(states, alone[0], equal_nan=True)
        assert np.array_equal(shown[0], alone[1], equal_nan=True)


@pytest.fixture(scope="module")
def p0() -> np.ndarray:
    return load_rig("shin2022").parameters("free", 0.0)


def test_plain_and_far_models_have_the_same_bits(p0: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    vectors = []
    for spread in (0.0, 1e-3, 0.02, 0.1) * 3:
        vectors.append(par.changed(p0, {name: p0[par.INDEX[name]] * (1 + spread * rng.normal()) for name in BASE}))
    locked = p0.copy()
    locked[par.LOCKED] = 1.0
    # Models of other structure go in groups of their own, one that is alone by itself.
    assert_same([*vectors, locked], inputs())
    sizes = [len(group) for group in lanes.groups([[p] for p in (*vectors, locked)])]
    assert sizes == ([8, 4, 1] if lanes.LANES == 8 else [4, 4, 4, 1])


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=lambda effect: effect.name)
def test_every_effect_has_the_same_bits(p0: np.ndarray, effect) -> None:
    rng = np.random.default_rng(2)
    sizes = [item for item in effect.parameters if item.is_size]
    vectors = []
    for k in range(6):
        values = {item.name: item.scale * (1.0 + 0.3 * rng.normal()) * (k != 2) for item in sizes}
        values |= {item.name: item.neutral * (1.0 + 0.2 * k) for item in effect.parameters if not item.is_size}
        # One model of them has one size alone: the others' states are there, and stay as they are.
        values |= {item.name: 0.0 for item in sizes[1:] if k == 4}
        p = par.changed(p0, {parameter_path(effect.name, name): value for name, value in values.items()})
        p[par.SIGNAL : par.SIGNAL + 4] = (0.5, -0.3, 0.2, 0.1)
        vectors.append(p)
    assert_same(vectors, inputs(1.0 if effect.name.split("_")[0] != "regulator" else 4e4))


def test_elementary_functions_are_right_to_their_last_digits() -> None:
    rng = np.random.default_rng(0)
    x = np.concatenate([rng.uniform(-3.0, 3.0, 2000), rng.uniform(-700.0, 700.0, 2000)])
    for own, exact, points in ((numeric.exp, math.exp, x), (numeric.log, math.log, np.abs(x))):
        values = np.array([own(float(point)) for point in points])
        assert values == pytest.approx([exact(point) for point in points], rel=4e-16, abs=4e-16)
    for k, exact in enumerate((math.sin, math.cos)):
        values = np.array([numeric.sine_and_cosine(float(point))[k] for point in x])
        assert values == pytest.approx([exact(point) for point in x], rel=0.0, abs=3e-16)
    assert numeric.log(0.0) == -math.inf
    assert math.isnan(numeric.log(-1.0)) and math.isnan(numeric.exp(math.nan)) and math.isnan(numeric.log(math.nan))
    assert numeric.log(math.inf) == math.inf


@inlined
def _first_above(p, value):
    for i in range(4):
        if p[i] > value:
            return float(i)
        if p[i] < -value:
            break
    return -1.0


@in_place
def _with_while(p, value):
    while value > p[0]:
        value = value - 1.0
    return value


@in_place
def _set_in_some_lanes(p, value):
    if value > 2.0:
        factor = 2.0
    if value < 1.0:
        factor = 3.0
    if value > 2.0 or value < 1.0:
        return factor * value
    return value


@pytest.mark.parametrize(("features", "width"), [("+avx2,+avx512f", (8, 3)), ("+avx,+avx2", (4, 2)), ("+sse2", (4, 5))])
def test_a_processor_without_wide_instructions_runs_models_one_by_one(features: str, width: tuple[int, int]) -> None:
    assert lane_values.width(features) == width


@pytest.mark.parametrize(
    "function", [_first_above, _with_while, _set_in_some_lanes], ids=["break", "while", "set in some lanes"]
)
def test_what_has_no_lane_form_is_refused_with_its_place(function) -> None:
    with pytest.raises(lane_form.NoLaneForm, match=f"{function.py_func.__name__}, line"):
        lane_form.lane_module((function,))


def test_an_effect_without_lane_form_leaves_the_models_to_run_one_by_one(p0, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> str:
        raise lane_form.NoLaneForm("an effect with a while")

    monkeypatch.setattr(composition, "remembered", refuse)
    monkeypatch.delitem(sys.modules, "pam_antagonist.model.lane_drive", raising=False)
    lanes._side_by_side.cache_clear()
    try:
        assert lanes._side_by_side() is None
        assert_same([p0, par.changed(p0, {"joint.inertia": 5e-4})], inputs())
    finally:
        lanes._side_by_side.cache_clear()


def test_the_source_of_the_equations_is_what_is_written_for_lanes() -> None:
    text = lane_drive.TEXT
    for function in (dynamics.slopes, dynamics.rows):
        assert f"def dynamics__{function.py_func.__name__}(" in text
        assert "lanes" not in inspect.getsource(function.py_func)
