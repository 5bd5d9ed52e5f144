"""``commission`` of a rig file that was never identified: driven by what is measured, within limits."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.cli import commission, new_rig
from pam_antagonist.cli.commission_guessed import GuessedCommission, held_angles, tried_gains
from pam_antagonist.cli.demo import found_gains
from pam_antagonist.cli.driving import rehearse
from pam_antagonist.control.model_law import ModelGains
from pam_antagonist.design import Limits, Plan
from pam_antagonist.design.exploration import FirstAir
from pam_antagonist.design.first_fill import pulse_faults
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.recording import read_bag
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.file import write_rig
from pam_antagonist.rig.physical import vented
from pam_antagonist.simulation.plant import Plant

COMMON = (
    "--kind pulley --muscle DMSP-20 --radius 25mm --nominal-length 300mm --length 272mm --inertia 0.02 --mass 1.5kg "
    "--supply 6bar --stop 40deg --rate 100"
)
DRIVES = {
    "regulators": "--drive regulator --regulator VPPM-0L6H --regulator-time 0.1",
    "valves": "--drive valve --valve MPYE-5-M5",
}


def guess(folder: Path, drive: str) -> Rig:
    path = folder / "rig.yaml"
    assert new_rig.main(["--out", str(path), *COMMON.split(), *DRIVES[drive].split()]) == 0
    return load_rig(path, regulators=True)


def joint_of(rig: Rig) -> Rig:
    """A joint that the guess may be of."""
    return moved(
        rig,
        {
            "muscle_1.force.c1": 1.2 * rig.value("muscle_1.force.c1"),
            "muscle_2.force.c3": 0.7 * rig.value("muscle_2.force.c3"),
            "muscle_2.force.c6": 1.01 * rig.value("muscle_2.force.c6"),
            "effects.load_torque.constant": 1.0,
        },
    )


def at_rest(rig: Rig, limits: Limits) -> Plan:
    """Where a joint without air begins, and its limits."""
    least, command = vented(rig)
    return Plan(np.empty((0, 2)), rig.sample_period, "free", 0.0, limits, least, command)


def test_beyond_a_limit_a_rehearsal_lets_the_air_out(tmp_path):
    rig = guess(tmp_path, "valves")
    least, command = vented(rig)
    limits = replace(Limits.of(rig), pressure=(least, least + 20e3))
    _, ended = rehearse(joint_of(rig), at_rest(rig, limits), FirstAir(rig), 1, 0.0, tmp_path / "bag")
    recording = read_bag(tmp_path / "bag", judge=False)
    assert "above the limit of 121 kPa" in ended
    assert np.all(recording.voltage[-20:] == command) and recording.pressure[-1].max() < recording.pressure.max() - 5e3


@pytest.mark.thorough(24)
def test_a_guess_becomes_a_controlled_joint(tmp_path):
    """With regulators; the tutorial's rig, which the tests of the pages commission, has valves."""
    rig = guess(tmp_path, "regulators")
    write_rig(joint_of(rig), tmp_path / "truth.yaml")
    out = tmp_path / "commissioned"
    given = ["--rig", str(tmp_path / "rig.yaml"), "--plant", str(tmp_path / "truth.yaml"), "--out", str(out)]
    assert commission.main([*given, "--mismatch", "0", "--source", "rehearsal", "--unattended"]) == 0
    steps = json.loads((out / "state.json").read_text())["steps"]
    assert list(steps) == ["wiring", "slow", "quick", "identify", "gains"]
    assert sum(step.get("rig_s", 0.0) for step in steps.values()) < 15 * 60
    report = json.loads((out / "identified" / "report.json").read_text())
    assert report["rejected"] == ""
    found = load_rig(out / "rig.yaml", regulators=True)
    assert found.identified and "pressure_bandwidth" in (out / "parameters.yaml").read_text()
    page = (out / "report.html").read_text(encoding="utf-8")
    assert all(name in page for name in ('href="identified/report.html"', "Step slow", "Step quick", "figure-2"))
    next_line = f"demo --rig {out / 'rig.yaml'} --gains {out / 'parameters.yaml'}"
    assert next_line in re.sub(r"<[^>]*>|&nbsp;|\xa0", lambda found: "" if found[0][0] == "<" else " ", page)
    assert found_gains(str(out / "parameters.yaml"))["law"] == "model"
    angle = read_bag(out / steps["quick"]["bag"]).angle
    assert angle is not None
    inside = np.flatnonzero(np.abs(angle) < 0.1)[0]
    assert np.abs(angle[inside:]).max() <= 0.9 * math.radians(40.0)
    assert np.ptp(angle[inside:]) > math.radians(15.0)


@pytest.mark.parametrize("drive", DRIVES)
def test_first_air_says_what_is_exchanged(drive, tmp_path):
    rig = guess(tmp_path, drive)
    program = FirstAir(rig)
    _, ended = rehearse(joint_of(rig), at_rest(rig, Limits.of(rig)), program, 1, 0.0, tmp_path / "bag")
    recording = read_bag(tmp_path / "bag", judge=False)
    assert ended == "" and pulse_faults(rig, recording, program.pulses) == []
    assert all(pulse.rise.max() < 150e3 for pulse in program.pulses), "a little air only"
    crossed = [replace(pulse, rise=pulse.rise[::-1]) for pulse in program.pulses]
    assert "exchanged" in pulse_faults(rig, recording, crossed)[0].sentence
    off = replace(recording, pressure=recording.pressure + 100e3)
    assert "its zero is wrong" in pulse_faults(rig, off, program.pulses)[0].sentence


HEAVY = (
    "--kind lever --muscle MAS-40 --radius 45mm --nominal-length 600mm --length 545mm --inertia 0.25 --mass 5kg "
    "--supply 6bar --stop none --rate 100 --drive valve --valve MPYE-5-3/8"
)


@pytest.mark.slow(4)
def test_gains_with_which_a_heavy_joint_swings_are_not_taken(tmp_path):
    assert new_rig.main(["--out", str(tmp_path / "rig.yaml"), *HEAVY.split()]) == 0
    rig = load_rig(tmp_path / "rig.yaml").replaced(uncertainty={}, directions={})  # as if it were identified
    rig = moved(rig, {"joint.viscous_friction": 0.18})
    gains, held = tried_gains(rig)
    swinging = held_angles(rig, Plant(rig, seed=1), ModelGains())
    assert swinging.error > max(2.0 * held.error, held.allowed) and "run away" in swinging.in_words()
    assert gains.integral < ModelGains().integral


def test_air_that_does_not_turn_the_joint_has_no_tick_and_angles_are_those_of_the_bag(tmp_path, monkeypatch):
    found = {}
    for name, length, steps in (("slack", "272mm", ("wiring",)), ("stretched", "297mm", ("wiring", "slow"))):
        monkeypatch.setattr(GuessedCommission, "STEPS", dict.fromkeys(steps, "Joint free:"))
        monkeypatch.setitem(DRIVES, name, f"{DRIVES['valves']} --length {length}")
        guess(tmp_path, name)
        out = tmp_path / name
        given = ["--rig", str(tmp_path / "rig.yaml"), "--out", str(out), "--source", "rehearsal", "--unattended"]
        commission.main(given)
        (tmp_path / "rig.yaml").unlink()
        found[name] = json.loads((out / "report.json").read_text(encoding="utf-8"))["steps"]
    slack, (wiring, slow) = found["slack"][0], found["stretched"][:2]
    assert slack["done"] and slack["doubt"] and "too little to show the encoder's sign" in slack["said"]
    assert wiring["done"] and not wiring["doubt"]
    angle = np.degrees(read_bag(next((tmp_path / "stretched").glob("slow_1/bag")), judge=False).angle)
    assert f"from {np.nanmin(angle):+.1f} to {np.nanmax(angle):+.1f} deg" in slow["said"]
