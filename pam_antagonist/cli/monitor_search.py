"""The search of ``close_loop`` in what a monitor has kept, in a process of its own; ``monitor`` starts it.

``monitor --search ORDER.json`` writes the buffer as a bag and the report beside it, adds an
entry to the rig's log book, and prints ``{"verdict", "effects", "calibration", "ambiguous_with"}`` as one line.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.rig import load_rig


def search(order: dict[str, object]) -> dict[str, object]:
    """Carry out an order.

    Its keys: ``buffer`` (a file of numpy with ``stamps`` and ``rows``, as of a feed), ``rig``, ``begin_ns`` from which
    on the joint is searched, ``folder`` for bag and report (empty: none), ``namespace``, ``joint``, ``lock_angle``,
    ``log``.
    """
    from pam_antagonist.api.diagnose import diagnose
    from pam_antagonist.api.history import log
    from pam_antagonist.recording import Recording, write_bag

    rig = load_rig(str(order["rig"]), regulators=True)
    with np.load(str(order["buffer"])) as kept:
        stamps, rows = kept["stamps"], kept["rows"]
    known = np.isfinite(rows[:, 4]).any()
    zero = rig.encoder.offset if rig.encoder is not None else 0.0
    folder = Path(str(order["folder"])) if order["folder"] else None
    buffer = Recording(
        path=Path("buffer") if folder is None else folder / "buffer", stamp_ns=stamps, pressure=rows[:, :2],
        voltage=rows[:, 2:4], angle=rows[:, 4] - zero if known else None, angle_sensor=rows[:, 4] if known else None,
        drive=rig.drive,
    )  # fmt: skip
    if folder is not None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            write_bag(folder / "buffer", buffer, namespace=str(order["namespace"]))
        except (OSError, BadInput) as error:
            print(f"the buffer is not kept: {error}", file=sys.stderr)
            folder = None
    begin = (int(order["begin_ns"]) - int(stamps[0])) * 1e-9  # type: ignore[call-overload]
    since = buffer.slice(max(begin, 0.0), buffer.duration_s)
    joint, lock = str(order["joint"]), float(order["lock_angle"])  # type: ignore[arg-type]
    found = diagnose(
        since, rig, joint=joint, lock_angle=lock if joint == "locked" else None, jobs=1, profiles=False, estimator=False
    )
    if folder is not None:
        try:
            found.save(folder / "report")
        except (OSError, BadInput) as error:
            print(f"the report is not kept: {error}", file=sys.stderr)
    if order["log"]:
        try:
            log("monitor", str(order["rig"]), [since], rig, found)
        except BadInput as error:
            print(str(error), file=sys.stderr)
    report = found.report
    return {key: report.get(key) for key in ("verdict", "effects", "calibration", "ambiguous_with")}


def main(argv: list[str]) -> int:
    """Carry out the order in a file; 2 where the buffer allows no search."""
    try:
        found = search(json.loads(Path(argv[0]).read_text(encoding="utf-8")))
    except BadInput as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(json.dumps(found))
    return 0
