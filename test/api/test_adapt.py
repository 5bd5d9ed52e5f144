"""``adapt``: a rig file follows its joint by half a minute of today."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist import BadInput, Recording, Rig, adapt, simulate, write_bag
from pam_antagonist.cli import adapt as command
from pam_antagonist.identification.joint_stage import ZERO
from pam_antagonist.identification.walk import walking
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.inference.unknown import Unknown
from pam_antagonist.rig.file import write_rig

SECONDS = 9.0
FORCE = ("v1", "v2", "w1", "w2")


@pytest.fixture(scope="module")
def known(rig: Rig) -> Rig:
    """An identified rig."""
    return rig.replaced(identified="the first day", effects={"leak": {"area_1": 2e-9, "area_2": 2e-9}})


def recorded(joint: Rig, seed: int = 1) -> Recording:
    return simulate(joint, duration=SECONDS, seed=seed)


@pytest.fixture(scope="module")
def today(known: Rig) -> Rig:
    """The joint a while later."""
    return moved(known, {"friction.shaft": 1.5 * known.friction.shaft, "effects.leak.area_1": 4e-9})


@pytest.mark.slow(20)
def test_what_has_changed_is_followed_and_the_rest_stays(known: Rig, today: Rig) -> None:
    found = adapt(recorded(today), known)
    assert not found.rejected
    for path in ("friction.shaft", "effects.leak.area_1"):
        now, before, true = (one.value(path) for one in (found.rig, known, today))
        assert abs(now - true) < 0.5 * abs(before - true), path
    for path in ("muscle_1.force.v2", "valve_1.inflow_area", "gas.polytropic_volume"):
        assert found.rig.value(path) == pytest.approx(known.value(path), rel=0.05), path
    for path in ("geometry.radius", "geometry.length", "joint.mass", "supply.pressure"):
        assert found.rig.value(path) == pytest.approx(known.value(path), rel=0.01), path
    assert found.errors_deg["identified"] < found.errors_deg["as_configured"]
    assert found.rig.priors == known.priors


@pytest.mark.slow(20)
def test_another_rig_is_refused(known: Rig) -> None:
    other = moved(known, {path: 1.4 * known.value(path) for path in (f"muscle_1.force.{c}" for c in FORCE)})
    with pytest.raises(BadInput, match=r"of another rig than shin2022.* errs by \d.*identify it anew"):
        adapt(recorded(other), known)


def test_what_cannot_be_adapted_is_refused_with_a_reason(known: Rig, rig: Rig, free: Recording) -> None:
    with pytest.raises(BadInput, match="was never identified"):
        adapt(free, rig)
    with pytest.raises(BadInput, match="no recording"):
        adapt([], known)
    still = simulate(known, np.full((8000, 2), 5.0), seed=2)
    with pytest.raises(BadInput, match="valves never moved"):
        adapt(still, known)


def test_a_number_walks_from_its_own_value(known: Rig) -> None:
    walk = walking(known)
    friction = walk(Unknown("friction.shaft", ("friction.shaft",), 9.0, 1.0, positive=True))
    assert (friction.start, friction.std) == (known.friction.shaft, 0.3)
    assert walk(Unknown("geometry.radius", ("geometry.radius",), 1.0, 0.06, positive=True)).std < 0.01
    assert walk(Unknown(ZERO, (), 0.0, 0.05)).std < 0.01
    vanished = walk(
        Unknown("effects.friction.coulomb", ("effects.friction.coulomb",), 0.02, 1.0, True, may_vanish=True)
    )
    assert 0.0 < vanished.start < 0.02
    own = Unknown("friday: areas", (), 0.0, 0.01, recording="friday")
    assert walk(own) == own


@pytest.mark.slow(30)
def test_the_command_says_what_has_changed_or_that_the_rig_file_stays(
    known: Rig, today: Rig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "my_rig.yaml"
    write_rig(known, file, ["The first day."])

    def adapted(name: str, joint: Rig) -> tuple[int, str]:
        write_bag(tmp_path / name, recorded(joint, seed=5))
        words = [str(tmp_path / name), "--rig", str(file), "--out", str(tmp_path / f"{name}_out"), "--no-figures"]
        return command.main(words), " ".join(capsys.readouterr().out.split())

    status, said = adapted("today", today)
    assert status == 0
    assert re.search(r"Changed since: effects\.leak\.area_1 \+\d.*friction\.shaft \+\d", said)
    assert f"rig: {tmp_path / 'today_out' / 'rig.yaml'}" in said
    assert "Not determined" not in said
    assert json.loads((tmp_path / "today_out" / "report.json").read_text())["rejected"] == ""
    status, said = adapted("same", known)
    assert status == 1
    assert "Keep the rig file as it is: on the " in said
    assert f"rig: {file}, as it was" in said
    assert not (tmp_path / "same_out" / "rig.yaml").exists()
    assert (tmp_path / "my_rig.log.jsonl").read_text().count('"command":"adapt"') == 2
