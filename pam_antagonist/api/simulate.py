"""``simulate``: a recording of a simulated joint."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.api.given import RigGiven
from pam_antagonist.errors import BadInput, number
from pam_antagonist.estimation import possible
from pam_antagonist.recording import Recording
from pam_antagonist.rig import as_rig
from pam_antagonist.simulation import excitation
from pam_antagonist.simulation.plant import Plant

_LONGEST = 86400.0
"""[s] Longest simulation: a day."""

FIRST_STAMP_NS = 1_000_000_000_000_000_000
"""First stamp (in 2001), constant so that the same arguments give the same recording."""


def simulate(
    rig: RigGiven,
    voltage: NDArray[np.float64] | None = None,
    *,
    profile: str = "steps",
    duration: float = 10.0,
    joint: str = "free",
    lock_angle: float = 0.0,
    seed: int = 0,
    mismatch: float = 0.0,
    noise: bool = True,
    path: str | Path = "simulated",
    progress: Callable[[int], object] | None = None,
) -> Recording:
    """Drive a simulated joint and record its sensors.

    The model runs with finer steps than the estimator's, and its sensors are noisy and quantised. It is this package's
    own model, so agreement with it proves nothing about a real joint.

    Args:
        rig: a rig, its name or its file.
        voltage: on the valves (N, 2) [V], or pressure commands [Pa], row k over sample period k; default: a profile.
        profile: ``paper``, ``steps`` or ``multisine``, used without ``voltage``.
        duration: of the profile [s].
        joint: ``free`` or ``locked``.
        lock_angle: of a locked joint [rad].
        seed: of all random numbers.
        mismatch: relative standard deviation of the joint's parameters from the rig's.
        noise: False for exact sensors.
        path: name of the recording; nothing is written.
        progress: called with the number of samples done since the last call.

    Returns:
        The recording; sample k is stamped at the end of period k. ``write_bag`` makes a bag of it.

    Raises:
        BadInput: voltages of a wrong shape, or a value that is not physical.

    Example:
        >>> from pam_antagonist import simulate
        >>> recording = simulate("shin2022", duration=2.0, mismatch=0.01, seed=7)
        >>> len(recording), recording.pressure.shape
        (2000, (2000, 2))
    """
    chosen = as_rig(rig, regulators=True)
    lock_angle, mismatch = number("lock_angle", lock_angle), number("mismatch", mismatch)
    seed = int(number("seed", seed, 0.0, 2.0**63))
    if voltage is None:
        if profile not in excitation.PROFILES:
            raise BadInput(f"profile {profile!r}: expected one of {', '.join(excitation.PROFILES)}")
        duration = number("duration", duration, chosen.sample_period, _LONGEST)
        voltage = excitation.for_rig(chosen, profile, duration, seed)
    try:
        given = np.asarray(voltage, dtype=np.float64)
    except (TypeError, ValueError):
        raise BadInput("voltage: expected numbers of shape (N, 2)") from None
    if given.ndim != 2 or given.shape[1] != 2 or len(given) == 0:
        raise BadInput(f"voltage has shape {given.shape}, expected (N, 2)")
    wrong = possible.complaint(possible.bounds(chosen), chosen.drive, np.full(given.shape, np.nan), given)
    if wrong:
        raise BadInput(wrong)
    # Regulators start at the first command; the voltage of a valve does not determine a pressure.
    before = None if chosen.drive == "valve" else (float(given[0, 0]), float(given[0, 1]))
    plant = Plant(chosen, joint, lock_angle, seed, mismatch=mismatch, noise=noise, initial_pressure=before)
    count = len(given)
    pressure, (angle, torque, encoder) = np.empty((count, 2)), np.empty((3, count))
    for k in range(count):
        sample = plant.step(given[k])
        pressure[k] = sample.pressure
        angle[k] = sample.angle
        torque[k], encoder[k] = sample.torque, sample.encoder
        if progress is not None and k % 1000 == 999:
            progress(1000)
    stamps = FIRST_STAMP_NS + np.rint(np.arange(1, count + 1) * chosen.sample_period * 1e9).astype(np.int64)
    return Recording(
        path=Path(path), stamp_ns=stamps, pressure=pressure, voltage=given, angle=angle, torque=torque,
        angle_sensor=None if chosen.encoder is None else encoder, drive=chosen.drive, corrected=True,
    )  # fmt: skip
