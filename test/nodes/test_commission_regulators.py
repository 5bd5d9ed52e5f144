"""A joint with pressure regulators, driven live by what is measured, as ``commission`` drives a new rig."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typing_extensions import override

from pam_antagonist.cli.driving import Owner, drive
from pam_antagonist.design import Limits, Plan
from pam_antagonist.design.exploration import Program
from pam_antagonist.recording import read_bag
from pam_antagonist.rig import load_rig
from pam_antagonist.rig.limits import vented

pytestmark = [pytest.mark.ros, pytest.mark.realtime]
RIG = load_rig("shin2022_regulators", regulators=True)
ASKED = 300e3


class Fill(Program):
    """Ask for a pressure in muscle 1, for a second and a half."""

    seconds = 1.5

    @override
    def command(self, time: float, pressure: np.ndarray, angle: float) -> tuple[float, float] | None:
        return (ASKED, vented(RIG)[0]) if time < self.seconds else None


def test_regulators_follow_a_program_and_let_the_air_out_beyond_a_limit(tmp_path: Path, domain: None) -> None:
    owner, limits, (least, rest) = Owner("plant", "shin2022_regulators"), Limits.of(RIG), vented(RIG)
    recordings = {}
    for name, highest in (("kept", limits.pressure[1]), ("broken", 0.5 * (least + ASKED))):
        folder = tmp_path / name
        folder.mkdir()
        within = replace(limits, pressure=(limits.pressure[0], highest))
        plan = Plan(np.empty((0, 2)), RIG.sample_period, "free", 0.0, within, least, rest)
        ended = drive(owner, plan, folder, RIG, Fill()).ended
        assert ("pressure" in ended) == (name == "broken"), ended
        recordings[name] = read_bag(folder / "bag", judge=False)
    kept, broken = recordings["kept"], recordings["broken"]
    assert kept.drive == "regulator"
    assert kept.voltage[:, 0].max() == pytest.approx(ASKED) and kept.pressure[:, 0].max() == pytest.approx(
        ASKED, rel=0.1
    )
    assert kept.pressure[:, 1].max() < least + 20e3
    assert broken.voltage[-1] == pytest.approx(rest)
    assert broken.pressure[-1, 0] < broken.pressure[:, 0].max() - 30e3
