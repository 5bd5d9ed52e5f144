"""What the report of an identification says of a rig that became worse."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from pam_antagonist.estimation.metrics import ChannelErrors
from pam_antagonist.identification import held_out as held_out_errors
from pam_antagonist.identification.episodes import EpisodesIdentified
from pam_antagonist.identification.result import HeldRecording
from pam_antagonist.inference.bootstrap import Interval
from pam_antagonist.replays.result import covered
from pam_antagonist.report import identify_findings
from pam_antagonist.report import replay as replay_findings
from pam_antagonist.rig import load_rig


def held_out(before: float, now: float, alone: tuple[float, float] = (1.0, 1.0), nis: float = 2.0) -> Any:
    """A held-out part whose angle has these errors [°] with the filter, and with the model alone."""

    def figures(rmse: float, model: float) -> SimpleNamespace:
        both = (
            ChannelErrors("deg", value, 2.0 * value, 0.08 if math.isfinite(value) else value, 0.95)
            for value in (rmse, model)
        )
        ukf, model_alone = (SimpleNamespace(angle=item, torque=None, external_torque=None) for item in both)
        model_alone.pressure = SimpleNamespace(rmse_pa=(1e3 * model, 1e3 * model))
        return SimpleNamespace(ukf=ukf, model_alone=model_alone, innovation=SimpleNamespace(nis_mean=nis))

    reports = {"as_configured": figures(before, alone[0]), "identified": figures(now, alone[1])}
    for one in reports.values():
        one.joint = SimpleNamespace(condition="free")
    return HeldRecording("lab/free", 20.0, {}, reports, math.nan, math.nan, 0)  # type: ignore[arg-type]


def parameter(name: str, value: float, bound: float | None = None) -> Any:
    return SimpleNamespace(name=name, value=value, bound=bound, unit="-")


@pytest.mark.parametrize(
    ("part", "said"),
    [
        (held_out(0.15, 0.43), "worse with the identified rig (0.43°, as configured 0.15°)"),
        (held_out(0.15, 0.16), ""),
        (held_out(0.15, 0.05), ""),
        (held_out(9.0, 8.4, (3.0, 2.6)), "(8.4°) is worse than that of the model alone (2.6°)"),
        (held_out(9.0, 2.6, (3.0, 2.6)), ""),
    ],
)
def test_a_filter_that_became_worse_or_that_pressures_do_not_help_is_a_warning(part: Any, said: str) -> None:
    found = identify_findings.of_recording(part)
    assert [item.status for item in found] == ["warn"] * bool(said) and all(said in item.text for item in found)
    assert held_out_errors.lacks_an_effect([part]) == ("as configured" in said)


MET = [parameter("friction.shaft", 1.0, 1.0)]


@pytest.mark.parametrize(
    ("part", "options", "said"),
    [
        (held_out(0.15, 0.05), {}, ""),
        (held_out(8.4, 18.0), {}, "the filter's angle error is 18°, with the rig file as given 8.4°"),
        (held_out(8.4, 18.0), {"saw": True}, ""),
        (held_out(0.15, 0.16, (1.0, 1.3)), {}, "the filter's angle error is 0.16°"),
        (held_out(0.15, 0.15, (1.0, math.inf)), {}, "diverges on the held-out part of lab/free"),
        (held_out(0.15, 0.15, nis=math.nan), {}, "diverges on the held-out part of lab/free"),
        (held_out(0.15, 0.05), {"refused": "gas.k: wrong"}, "the values that fit best are impossible (gas.k: wrong)"),
        (held_out(0.15, 0.10), {"parameters": MET}, "ended at a bound of friction.shaft (1.00 -)"),
        (held_out(0.15, 0.01, (1.0, 0.1)), {"parameters": MET}, ""),
        (held_out(0.15, 0.01, (1.0, 0.1)), {"parameters": MET, "declared": {"friction.shaft"}}, "friction.shaft"),
        (held_out(0.15, 0.10), {"parameters": [parameter("friction.shaft", 0.0, 0.0)]}, ""),
    ],
)
def test_a_fit_that_did_not_work_says_so(part: Any, options: dict[str, Any], said: str) -> None:
    found = held_out_errors.rejection([part], **options)
    assert said in found and bool(found) == bool(said)
    assert "\n" not in found


def test_an_error_that_is_large_for_the_range_is_a_warning() -> None:
    part = held_out(20.0, 5.0, (9.0, 9.0))
    assert identify_findings.of_recording(part) == []
    wide = replace(part.reports["identified"].ukf.angle, ratio=0.2)
    part.reports["identified"].ukf.angle = wide
    (found,) = identify_findings.of_recording(part)
    assert "10.0 % of the angle's range: the joint is no plain pair of muscles" in found.text


@pytest.mark.parametrize(
    ("coverage", "status", "said"),
    [
        (
            0.95,
            "good",
            "95.0 % of the held-out readings lie in their 95 % intervals. The filter's covariance is honest.",
        ),
        (0.5, "warn", "covariance is too small (angle of lab/free 50.0 %)."),
        (1.0, "note", "covariance is larger than needed (angle of lab/free 100.0 %)."),
    ],
)
def test_the_coverage_of_all_recordings_is_one_sentence(coverage: float, status: str, said: str) -> None:
    part = held_out(0.15, 0.05)
    wide = {"coverage95": coverage, "width": 20.0 if coverage == 1.0 else 1.96}
    part.reports["identified"].ukf.angle = replace(part.reports["identified"].ukf.angle, **wide)
    found: Any = SimpleNamespace(
        found=SimpleNamespace(notes=()), parameters=(), rejected="", adapts=False, held=[part],
        coverage95=(coverage, math.nan), between=(), correlations=(), recordings=(part,),
    )  # fmt: skip
    (item,) = [one for one in identify_findings.findings(found) if "95 % intervals" in one.text]
    assert item.status == status and item.text.endswith(said)
    # The same words in a replay: one rule.
    assert [said.status for said in replay_findings._honesty(covered(part.identified))] == [status]


@pytest.mark.parametrize(("later", "said"), [(0.5, ""), (1.1, ""), (1.5, "on later episodes is 1.50°, with the rig")])
def test_episodes_that_are_predicted_worse_reject_the_rig(later: float, said: str) -> None:
    errors = {name: (Interval(value, 0.0, 9.0),) * 2 for name, value in (("as configured", 1.0), ("identified", later))}
    rig = load_rig("shin2022_regulators", regulators=True)
    found = EpisodesIdentified(rig, rig, {}, errors, None, (1, 1, 1))
    assert said in found.rejected and bool(found.rejected) == bool(said)
    # A file whose values are from these episodes already has the error of a fit there.
    assert replace(found, is_fair=False).rejected == ""
    impossible = rig.unchecked(joint=rig.joint.unchecked(inertia=-1.0))
    assert "impossible (joint.inertia" in replace(found, rig=impossible).rejected
