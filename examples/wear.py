"""Eight weeks of a joint whose muscle 2 loses 1 % of its force a week."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from pam_antagonist import history, identify, load_rig, simulate
from pam_antagonist.api.history import log

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "wear")
folder.mkdir()
file = folder / "my_rig.yaml"
file.write_text("based_on: shin2022\nname: my_rig\n", encoding="utf-8")
rig = load_rig(file)
begin, week, random = 1_790_000_000 * 10**9, 7 * 24 * 3600 * 10**9, np.random.default_rng(1)
for number in range(8):
    # Beside the wear, the supply and the shaft's friction differ from day to day.
    worn = rig.with_value("supply.pressure", rig.supply.pressure * random.normal(1.0, 0.005))
    worn = worn.with_value("friction.shaft", rig.friction.shaft * random.normal(1.0, 0.03))
    for name in ("v1", "v2", "w1", "w2"):
        worn = worn.with_value(f"muscle_2.force.{name}", getattr(rig.muscle_2.force, name) * (1.0 - 0.01 * number))
    recording = simulate(worn, duration=20.0, seed=number, path=f"week_{number + 1}")
    recording = replace(recording, stamp_ns=recording.stamp_ns - recording.stamp_ns[0] + begin + number * week)
    log("identify", file, [recording], rig, identify(recording, rig))
    print(f"week {number + 1} of 8", flush=True)
print(history(file).summary())
