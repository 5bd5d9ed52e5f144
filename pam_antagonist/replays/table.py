"""A replay's estimates as a table, a CSV file, or a bag for PlotJuggler and Foxglove."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.recording import RecordedEstimate, write_bag
from pam_antagonist.replays.result import Replay

_STATES = ("angle", "velocity", "torque")
_UNITS = {"angle": "rad", "velocity": "rad_s", "torque": "Nm"}


def columns(replay: Replay) -> dict[str, NDArray[np.generic]]:
    """Columns of M estimates, by name; the unit stands at the end of each name.

    Standard deviations and three covariances give the covariance. Quantities that were not measured have no column.
    """
    rows = replay.run.rows
    time = (replay.run.stamp_ns - replay.recording.stamp_ns[0]) * 1e-9
    out: dict[str, NDArray[np.generic]] = {"stamp_ns": replay.run.stamp_ns, "time_s": time}
    for k, name in enumerate(_STATES):
        out[f"{name}_{_UNITS[name]}"] = rows[name]
        out[f"{name}_std_{_UNITS[name]}"] = np.sqrt(rows["covariance"][:, k, k])
    for j, k in ((0, 1), (0, 2), (1, 2)):
        pair = (_STATES[j], _STATES[k])
        out[f"covariance_{pair[0]}_{pair[1]}_{_UNITS[pair[0]]}_{_UNITS[pair[1]]}"] = rows["covariance"][:, j, k]
    for muscle in (0, 1):
        out[f"pressure_{muscle + 1}_Pa"] = rows["pressure"][:, muscle]
        out[f"force_{muscle + 1}_N"] = rows["force"][:, muscle]
        out[f"innovation_{muscle + 1}_Pa"] = rows["innovation"][:, muscle]
    for j, k in ((0, 0), (0, 1), (1, 1)):
        out[f"innovation_covariance_{j + 1}{k + 1}_Pa2"] = rows["innovation_covariance"][:, j, k]
    if np.isfinite(rows["external_torque"]).any():
        out["external_torque_Nm"] = rows["external_torque"]
        out["external_torque_std_Nm"] = np.sqrt(rows["external_torque_covariance"][:, 3])
    out |= {"nis": rows["nis"], "stiffness_Nm_rad": rows["stiffness"]}
    out |= {name: rows[name] for name in ("subsystem", "flags")}
    out |= {f"state_{name}": values for name, values in replay.run.added.items()}
    measured = {"measured_angle_rad": replay.measured_angle, "measured_torque_Nm": replay.measured_torque}
    return out | {name: values for name, values in measured.items() if values is not None}


def check_estimate(path: Path, overwrite: bool = False) -> None:
    """Refuse a file name that :func:`write_estimate` would refuse, before the replay runs."""
    if path.suffix not in (".csv", ".mcap"):
        raise BadInput(f"{path}: expected a name that ends with .csv or .mcap")
    if path.exists() and not (overwrite and path.is_file()):
        raise BadInput(f"{path}: exists; expected a new file, nothing is overwritten")


def write_estimate(path: Path, replay: Replay, overwrite: bool = False) -> None:
    """Write the estimates of a replay.

    A bag holds ``joint_estimate`` (estimate, covariance, innovations, stamps) beside the recording's own topics, with
    the definitions of all message types.

    Args:
        path: of a new file, ``*.csv`` or ``*.mcap``.
    """
    check_estimate(path, overwrite)
    try:
        with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as aside:
            partial = Path(aside) / path.name
            if path.suffix == ".csv":
                _write_csv(partial, columns(replay))
            else:
                _write_mcap(partial, replay)
            partial.rename(path)
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror or error}") from None


def _write_csv(path: Path, table: dict[str, NDArray[np.generic]]) -> None:
    formats = ["%d" if np.issubdtype(values.dtype, np.integer) else "%.10g" for values in table.values()]
    line = ",".join(formats)
    with path.open("w", encoding="utf-8") as stream:
        stream.write(",".join(table) + "\n")
        stream.writelines(
            f"{line % row}\n" for row in zip(*(values.tolist() for values in table.values()), strict=True)
        )


def _write_mcap(path: Path, replay: Replay) -> None:
    run = replay.run
    estimate = RecordedEstimate.from_rows(run.stamp_ns, run.started_ns, run.rows)
    folder = path.with_name("bag")
    write_bag(folder, replay.recording, estimate=estimate)
    (written,) = folder.glob("*.mcap")
    written.rename(path)
