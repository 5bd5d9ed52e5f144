"""Each form is another law than the catalogue's of that effect, and still an example of it.

The catalogue's effect is fitted to what the form does to a joint (no noise, base parameters known): it has to explain
most of it, or the battery would ask for the impossible, and it must not explain all, or it would ask for nothing.
"""

from __future__ import annotations

import os

import numpy as np
import pytest
from scipy.optimize import least_squares

from pam_antagonist.model import dynamics, equilibrium, sensor
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import CATALOGUE, EffectParameter, parameter_path
from pam_antagonist.rig import load_rig
from pam_antagonist.validation.battery.forms import SINGLE, Form
from pam_antagonist.validation.battery.plants import JOINTS, Case

SECONDS, BLOCK, SUBSTEPS = 14.0, 10, 1
SENSORS = load_rig("shin2022").sensors
NOISE = np.array([SENSORS.angle_std, SENSORS.pressure_std, SENSORS.pressure_std, SENSORS.torque_std])


def blocks(angle, pressure, torque) -> np.ndarray:
    """Means over 10 ms in units of the sensors' noise (B, 4)."""
    columns = np.column_stack([angle, pressure, torque]) / NOISE
    return columns[: len(columns) // BLOCK * BLOCK].reshape(-1, BLOCK, 4).mean(axis=1)


def with_catalogue(case: Case, joint: str, changes: dict[str, float]) -> np.ndarray:
    p = par.changed(case.parameters(joint), {**changes, "friction.time_step": 1e-3 / SUBSTEPS})
    voltage = case.voltage(joint, SECONDS)
    start = equilibrium.initial_state(0.0, 450e3, 450e3, voltage[0], p)
    states, torque, _ = dynamics.simulate(start, voltage, p, 1e-3, SUBSTEPS)
    shown = np.column_stack([sensor.reading(i, states[:, 2 + i], p) for i in (0, 1)])
    return blocks(states[:, 0], shown, torque)


def left_over(form: Form) -> float:
    """Share of the most moved channel's change that the best of the catalogue's effect leaves."""
    muscle = 2 if form.by_muscle else None
    case = Case(form.name, "single", ((form.effect, muscle),), (form.name,), 21, (min(10.0, form.largest),))
    targets = []
    for joint in JOINTS:
        true = case.channels(joint, SECONDS)
        targets.append(blocks(true.angle, true.pressure, true.torque))
    effect = CATALOGUE[form.effect]
    items = [item for item in effect.parameters if muscle is None or item.muscle in (None, muscle)]

    def value(item: EffectParameter, z: float) -> float:
        return float(np.clip(z * item.scale if item.is_size else np.exp(z), item.low, item.high))

    def residual(z) -> np.ndarray:
        changes = {parameter_path(effect.name, i.name): value(i, z[k]) for k, i in enumerate(items)}
        return np.concatenate(
            [with_catalogue(case, joint, changes) - target for joint, target in zip(JOINTS, targets, strict=True)]
        )

    def rms(values: np.ndarray) -> np.ndarray:
        return np.sqrt(np.mean(values**2, axis=0))

    before = rms(
        np.concatenate(
            [with_catalogue(case, joint, {}) - target for joint, target in zip(JOINTS, targets, strict=True)]
        )
    )

    def start(way: float) -> np.ndarray:
        return np.array([0.5 * way if item.is_size else np.log(item.neutral) for item in items])

    signed = any(item.is_size and item.low < 0.0 for item in items)
    # The better sign of all sizes: a descent does not cross zero where the model has another number of states there.
    begin = min((start(way) for way in ((1.0, -1.0) if signed else (1.0,))), key=lambda z: np.sum(residual(z) ** 2))
    best = least_squares(lambda z: residual(z).ravel(), begin, diff_step=0.03, max_nfev=8)
    after = rms(residual(best.x))
    channel = int(np.argmax(before))
    return float(after[channel] / before[channel])


# Pushes are no law that could be fitted: their form is theirs alone.
LAWS = [form for form in SINGLE if form.effect != "external_torque"]
ONE_AN_EFFECT = list({form.effect: form for form in reversed(LAWS)}.values())


@pytest.mark.slow
@pytest.mark.parametrize(
    # PAM_ALL_FORMS=1 takes them all, which is two minutes more.
    "form",
    LAWS if os.environ.get("PAM_ALL_FORMS") else ONE_AN_EFFECT,
    ids=lambda form: form.name,
)
def test_the_catalogue_explains_most_of_it_and_not_all(form: Form) -> None:
    # The leak's exponent takes in capillaries and cracks as well as orifices.
    least = 0.0 if form.effect == "leak" else 0.01
    assert least < left_over(form) < 0.6
