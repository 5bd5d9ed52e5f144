"""The course of several models side by side, compiled. Import it only where it is needed: this generates the lane form.

To read the generated module: ``python -m pam_antagonist.model.lane_course``.
"""

from __future__ import annotations

from pam_antagonist._jit import in_place
from pam_antagonist.model import composition, dynamics, integration, lane_form
from pam_antagonist.model.lane_values import CHUNK, LANES, item, put

TEXT = composition.remembered("lanes", lambda: lane_form.lane_module((integration.rk4_step_within, dynamics.torque)))
"""Source of the module with the lane form of the equations."""
_form = composition.imported(TEXT, "lanes")
rk4_step, _torque = _form.rk4_step_within, _form.torque


@in_place
def course(x, voltage, p, dt, substeps, states, torques, scratch):
    """:func:`~pam_antagonist.model.integration.course` of several models.

    `x`: states (n, LANES) at the first sample; changed in place to the states at the last one. `voltage`: input (N, 2)
    or (N, 3) of all models [V, N m]. `p`: parameter vectors (P, LANES). `dt`: sample period [s]. `states`: result
    (LANES, N, n). `torques`: result (LANES, N) [N m]. `scratch`: (STAGES + 1, n, LANES) for a step, (CHUNK, n, LANES)
    and (CHUNK, LANES) for the last samples.
    """
    stages, recent, recent_torques = scratch
    for begin in range(0, states.shape[1], CHUNK):
        count = min(CHUNK, states.shape[1] - begin)
        for k in range(count):
            if begin + k > 0:
                for _ in range(substeps):
                    rk4_step(x, voltage[begin + k], p, dt / substeps, x, stages)
            for i in range(x.shape[0]):
                put(recent, (k, i), item(x, i))
            put(recent_torques, k, _torque(x, p))
        for lane in range(LANES):
            for k in range(count):
                for i in range(x.shape[0]):
                    states[lane, begin + k, i] = recent[k, i, lane]
                torques[lane, begin + k] = recent_torques[k, lane]


if __name__ == "__main__":
    print(TEXT)
