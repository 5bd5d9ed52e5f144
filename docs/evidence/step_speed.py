"""What a step of the filter costs: ``./run python docs/evidence/step_speed.py``, in any checkout of this package.

Recordings are short and run often, and the quickest run counts: other work on the machine is slower, never quicker.
"""

from __future__ import annotations

import time

import numpy as np

from pam_antagonist.estimation import Estimator
from pam_antagonist.rig import load_rig

SAMPLES, ROUNDS = 300, 600

rig = load_rig("shin2022")
rng = np.random.default_rng(1)
stamps = 10**18 + np.arange(SAMPLES) * 1_000_000
pressure = 450e3 + rng.normal(0.0, 300.0, (SAMPLES, 2))
voltage = np.repeat(rng.uniform(5.0, 6.0, (SAMPLES // 30, 2)), 30, axis=0)
rows = list(zip(stamps.tolist(), *pressure.T.tolist(), *voltage.T.tolist(), strict=True))

begin = time.process_time()
estimator = Estimator(rig)
print(
    f"start of an estimator: {time.process_time() - begin:.1f} s of CPU time, mostly compiling where nothing is cached"
)
for tuning in ("published", "default"):
    estimator = Estimator(rig, tuning)
    step = getattr(estimator, "step_in_place", estimator.step)
    replayed, live = [], []
    for _ in range(ROUNDS):
        estimator.reset()
        begin = time.perf_counter()
        estimator.run(stamps, pressure, voltage)
        replayed.append(time.perf_counter() - begin)
        estimator.reset()
        begin = time.perf_counter()
        for row in rows:
            step(*row)
        live.append(time.perf_counter() - begin)
    scale = 1e6 / SAMPLES
    print(
        f"{tuning}: {min(replayed) * scale:.2f} µs a sample in a replay, {min(live) * scale:.2f} µs a call from Python"
    )
