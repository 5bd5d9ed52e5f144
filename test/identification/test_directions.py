"""The few directions that a filter considers, against all that a fit does not know."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.identification.directions import Sensitivity, considered_directions
from pam_antagonist.inference.free_parameters import free_parameters, moved
from pam_antagonist.inference.trial import make_trial
from pam_antagonist.model import equilibrium
from pam_antagonist.recording import Recording
from pam_antagonist.simulation.plant import Plant

SECONDS = 4.0


@pytest.fixture(scope="module")
def still(rig):
    """A joint that stands: its recording shows one angle only."""
    plant = Plant(rig, joint="free", seed=5)
    voltage = np.full((round(SECONDS / rig.sample_period), 2), 5.5)
    samples = [plant.step(row) for row in voltage]
    recording = Recording(
        path=Path("still"),
        stamp_ns=np.arange(1, len(samples) + 1, dtype=np.int64) * 1_000_000,
        pressure=np.array([sample.pressure for sample in samples]),
        voltage=voltage,
        angle=np.array([sample.angle for sample in samples]),
        torque=np.array([sample.torque for sample in samples]),
    )
    return make_trial(recording, rig, "free", 0.0, "still")


def test_directions_hold_what_is_not_known_where_the_joint_never_was(rig, still):
    """At rest elsewhere, the few directions are off by what all that is not known together is off by."""
    free = free_parameters(rig)
    # As uncertain as the priors say: a joint that stands tells little.
    covariance = np.eye(len(free))
    known = Sensitivity.of(rig, [still], free, covariance, jobs=1)
    directions = considered_directions(rig, [still], known, covariance)
    assert 1 < len(directions) < len(free)

    def angles(changes):
        p = moved(rig, {name: rig.value(name) + step for name, step in changes.items()}).parameters("free", 0.0)
        return np.array(
            [equilibrium.rest_angle(first, second, p) for first, second in ((3e5, 5e5), (6e5, 2.5e5), (5e5, 5e5))]
        )

    def spread(several):
        return np.sqrt(sum((angles(changes) - angles({})) ** 2 for changes in several))

    all_of_it = spread([{item.name: 0.1 * item.prior_std} for item in free])
    few = spread([{name: 0.1 * step for name, step in item.changes.items()} for item in directions])
    assert np.all(few > 0.9 * all_of_it)
    assert np.all(few < 1.05 * all_of_it)


def test_the_estimate_s_slopes_serve_for_another_covariance(rig, still):
    """Worked out along the combinations of one fit, they tell what those of another fit do."""
    free = free_parameters(rig)
    rng = np.random.default_rng(3)
    turned = np.linalg.qr(rng.normal(size=(len(free), len(free))))[0]
    one, other = ((turned * scales) @ turned.T for scales in rng.uniform(0.01, 0.2, size=(2, len(free))))
    along_one, along_other = (Sensitivity.of(rig, [still], free, covariance, jobs=1) for covariance in (one, other))
    known, wanted = (considered_directions(rig, [still], known, other) for known in (along_one, along_other))
    assert len(known) == len(wanted)
    assert np.allclose([item.share for item in known], [item.share for item in wanted], atol=0.01)
    assert np.allclose([item.angle for item in known], [item.angle for item in wanted], rtol=0.03, atol=1e-5)
