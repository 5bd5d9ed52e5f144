"""Nothing is certain from the model of a rig that was never identified, and drifting valves are judged by pressures."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.checks import check_recording
from pam_antagonist.cli import import_csv, new_rig
from pam_antagonist.recording import Recording, read_bag
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.rig import Rig, load_rig

STRANGERS = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "strangers"
KNOWN = {
    "elbow": "--kind pulley --radius 21.6mm --muscle DMSP-20 --nominal-length 250mm --length 225mm --supply 6bar "
    "--drive valve --valve own --valve-flow 47 --voltage 0:10 --inertia 0.032 --mass 1.2kg --shaft-radius 8mm "
    "--stop 50deg --sensor-range 10bar --sensor-bits 12 --rate 100",
    "bench": "--kind pulley --radius 28.7mm --muscle DMSP-20 --nominal-length 300mm --length 272mm --supply 6bar "
    "--drive valve --valve MPYE-5-M5 --voltage 0:10 --inertia 0.022 --mass 2.5kg --shaft-radius 10mm --stop 24deg "
    "--sensor-range 10bar --sensor-bits 12 --rate 1000",
}
RECORDED = [("elbow", "elbow_trial_09.csv", "elbow_map.yaml"), ("bench", "bench_free.mat", "bench_mat_map.yaml"),
            ("bench", "bench_locked_a.mat", "bench_mat_map.yaml")]  # fmt: skip


@pytest.fixture(scope="module")
def guessed(rig: Rig) -> Rig:
    """A rig file that says that it was never identified."""
    names = ("muscle_1.force.v1", "muscle_2.force.v1", "valve_1.inflow_area", "valve_2.inflow_area")
    return rig.replaced(priors={name: abs(rig.value(name)) * (1.0 if "force" in name else 0.25) for name in names})


@pytest.fixture(scope="module", params=RECORDED, ids=lambda item: item[1])
def stranger(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, Rig]:
    """A recording of closed-centre valves in a pressure loop, and the rig that its laboratory would type."""
    if not STRANGERS.is_dir():
        pytest.skip("the recordings of other laboratories are not part of this repository")
    lab, table, columns = request.param
    folder = tmp_path_factory.mktemp(lab)
    assert new_rig.main(["--out", str(folder / "rig.yaml"), "--name", lab, *KNOWN[lab].split()]) == 0
    arguments = [str(STRANGERS / lab / table), "--map", str(STRANGERS / lab / columns), "--out", str(folder / "bag")]
    assert import_csv.main(arguments) == 0
    return read_bag(folder / "bag", judge=False), load_rig(folder / "rig.yaml")


def test_nothing_is_sure(free: Recording, guessed: Rig) -> None:
    for changed in (
        replace(free, pressure=free.pressure[:, ::-1]),
        replace(free, angle=-free.angle),  # type: ignore[operator]
        replace(free, pressure=free.pressure - 101_325.0),
        replace(free, torque=100.0 * free.torque),  # type: ignore[operator]
    ):
        checked = check_recording(changed, guessed)
        assert not checked.wrong
        assert checked.corrections == Corrections()
        doubts = [finding for finding in checked.findings if finding.status == "doubtful"]
        assert doubts and not [finding.text for finding in checked.findings if re.search(r"\bsure\b", finding.text)]
        assert any("never identified" in item.text or "the rig file is far off" in item.text for item in doubts)


def test_what_the_values_alone_show_is_sure(free: Recording, guessed: Rig) -> None:
    (finding,) = check_recording(replace(free, angle=np.degrees(free.angle)), guessed).wrong  # type: ignore[arg-type]
    assert finding.options == ("--angle-unit deg",)


def test_a_factor_within_the_uncertainty_of_the_rig_is_no_unit(free: Recording, rig: Rig, guessed: Rig) -> None:
    turned = replace(free, angle=0.2 * free.angle)  # type: ignore[operator]
    (certain,) = check_recording(turned, rig).wrong
    assert certain.options == ("--angle-unit rev",)
    (doubt,) = [item for item in check_recording(turned, guessed).findings if "times as large" in item.text
                and "angle" in item.text]  # fmt: skip
    assert doubt.status == "doubtful" and not doubt.options and "the rig file is far off" in doubt.text


def test_no_delay_is_to_be_typed(free: Recording, rig: Rig, guessed: Rig) -> None:
    late = Corrections(delay_voltage=-0.03).arranged(free)
    assert [item.options for item in check_recording(late, rig).findings if item.options]
    found = check_recording(late, guessed).findings
    assert not [item.options for item in found if item.options]
    assert any("stamps cannot be told from the speed of the valves" in item.text for item in found)


def test_an_identified_rig_is_certain_again(free: Recording, guessed: Rig) -> None:
    identified = guessed.replaced(identified="free, locked")
    assert check_recording(replace(free, pressure=free.pressure[:, ::-1]), identified).wrong


def test_drifting_valves_are_judged_by_the_measured_pressures(stranger: tuple[Recording, Rig]) -> None:
    recording, own = stranger
    checked = check_recording(recording, own)
    texts = {finding.text: finding.status for finding in checked.findings}
    assert "another rig" not in " ".join(texts)
    assert any("in steps of 0.5 s that begin at measured pressures" in text and status == "good"
               for text, status in texts.items())  # fmt: skip
    assert any("drift away" in text and "delays" in text and status == "untested" for text, status in texts.items())
    assert any("as the measured pressures say" in text and status == "good" for text, status in texts.items())
    assert not [text for text, status in texts.items() if status in ("wrong", "doubtful")]


def test_exchanged_lines_show_although_the_model_drifts(stranger: tuple[Recording, Rig]) -> None:
    recording, own = stranger
    exchanged = replace(recording, pressure=recording.pressure[:, ::-1])
    doubts = [item for item in check_recording(exchanged, own).findings if item.status == "doubtful"]
    assert [item.options for item in doubts] == [("--swap-pressures",)]
