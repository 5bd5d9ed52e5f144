"""The verdict, on joints whose fault is known and written in another form than the catalogue's."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pam_antagonist import simulate
from pam_antagonist.api.diagnose import DiagnoseResult
from pam_antagonist.diagnosis import Diagnosis, diagnose, findings, held_out, warnings
from pam_antagonist.diagnosis.checkpoint import Checkpoint
from pam_antagonist.errors import BadInput
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.rig import load_rig
from pam_antagonist.rig.write import write_rig
from pam_antagonist.strict_json import plain


@pytest.fixture(scope="module")
def leaking(rig, recorded):
    return diagnose([recorded("leak", 1, "seeping", 15.0, seconds=24.0)], rig, joint="locked", jobs=1)


@pytest.mark.slow(15)
def test_a_leak_is_found_on_its_muscle(leaking) -> None:
    assert leaking.verdict == "effect"
    first = leaking.effects[0]
    assert (first.name, first.muscle) == ("leak", 1)
    assert first.delta_bic > 6.0
    assert first.holdout_gain > 0.7
    assert "area_1" in first.parameters and "area_2" not in first.parameters


def test_every_candidate_is_ranked_on_each_muscle(leaking) -> None:
    first = {item.effect: item for item in leaking.ranking if item.round == 1}
    assert set(first) == {
        name for name, effect in CATALOGUE.items() if "valve" in effect.tested_with and effect.deterministic
    }
    leak = first["leak"]
    assert leak.muscles[0] > 0.9 * leak.score
    assert leak.muscles[1] < 0.2 * leak.score
    assert {name for name, item in first.items() if item.muscles is None} == {
        "hysteresis", "supply_droop", "load_torque", "friction", "slack",
    }  # fmt: skip


def test_the_extended_model_is_better_on_data_that_no_fit_saw(leaking) -> None:
    errors = leaking.errors
    assert errors.extended.rmse_pa[0] < 0.4 * errors.recalibrated.rmse_pa[0]
    assert errors.extended.angle is None
    for part in leaking.by_recording:
        assert all(model.innovation is not None for model in part.ukf.all)


def test_the_extended_rig_can_be_read_again(leaking, tmp_path) -> None:
    write_rig(leaking.rig_extended, tmp_path / "rig.yaml")
    assert load_rig(tmp_path / "rig.yaml").effects["leak"]["area_1"] > 0.0


@pytest.mark.slow(8)
def test_a_curve_that_the_file_calls_guessed_is_no_fault(rig) -> None:
    """The student's case: the data sheet tells no curve, and nothing is wrong with the joint."""
    shifts = {"voltage_1": 0.4, "voltage_2": -0.3}
    joint = rig.replaced(effects={"valve_offset": shifts})
    recording = simulate(joint, duration=24.0, joint="locked", mismatch=0.0, seed=3)
    guessed = rig.replaced(priors={f"effects.valve_offset.{name}": 0.5 for name in shifts})
    found = diagnose([recording], guessed, joint="locked", jobs=1)
    assert (found.verdict, found.effects) == ("none", ())
    for name, shift in shifts.items():
        assert found.rig_recalibrated.value(f"effects.valve_offset.{name}") == pytest.approx(shift, abs=0.02)


def test_no_rig_is_written_that_explains_nothing_and_is_worse(rig, leaking, tmp_path) -> None:
    fields = {item.name: getattr(leaking, item.name) for item in dataclasses.fields(Diagnosis)}
    found = DiagnoseResult(**fields, start=rig, hashes=("0" * 64,), seed=0, kept=1.0 / 3.0)
    found.save(tmp_path / "effect", figures=False)
    assert (tmp_path / "effect" / "rig_extended.yaml").is_file() and not found.worse

    errors = found.errors
    worse = dataclasses.replace(errors.extended, rmse_pa=(1.0, 1.2 * errors.as_configured.rmse_pa[1]))
    unexplained = dataclasses.replace(found, verdict="unexplained", errors=dataclasses.replace(errors, extended=worse))
    (said,) = unexplained.worse
    assert said.startswith("pressure 2 ")
    unexplained.save(tmp_path / "nothing", figures=False)
    assert sorted(path.name for path in (tmp_path / "nothing").iterdir()) == ["report.html", "report.json"]

    better = dataclasses.replace(unexplained, errors=dataclasses.replace(errors, extended=errors.as_configured))
    assert not better.worse


def test_recordings_with_different_faults_get_a_rig_each(rig, leaking, tmp_path) -> None:
    fields = {item.name: getattr(leaking, item.name) for item in dataclasses.fields(Diagnosis)}
    fields["own"] = (("one", leaking.rig_extended), ("two", leaking.rig_extended))
    found = DiagnoseResult(**fields, start=rig, hashes=("0" * 64,), seed=0, kept=1.0 / 3.0)
    assert found.rig_files == ("rig_extended.yaml", "rig_extended_1.yaml", "rig_extended_2.yaml")

    (leak,) = leaking.effects
    apart = tuple(dataclasses.replace(leak, muscle=k, recordings=(name,)) for k, name in ((1, "one"), (2, "two")))
    different = dataclasses.replace(found, effects=apart)
    assert different.no_common_rig == "no rig suits all recordings: leak is on muscle 1 in one and on muscle 2 in two"
    different.save(tmp_path / "different", figures=False)
    rigs = sorted(path.name for path in (tmp_path / "different").glob("*.yaml"))
    assert rigs == ["rig_extended_1.yaml", "rig_extended_2.yaml"]
    assert "rig_extended.yaml" not in (tmp_path / "different" / rigs[0]).read_text(encoding="utf-8")

    both = tuple(dataclasses.replace(item, recordings=("one", "two")) for item in apart)
    assert "rig_extended.yaml" in dataclasses.replace(found, effects=both).rig_files
    worse = dataclasses.replace(leaking.errors.as_configured, rmse_pa=(1e6, 1.0))
    alike = dataclasses.replace(found, effects=both, errors_of_one_rig=worse)
    assert alike.no_common_rig.startswith(
        "one rig for all recordings would be worse than shin2022 (pressure 1 error 1e+03 kPa, before "
    )
    assert "rig_extended.yaml" not in alike.rig_files


def test_a_report_says_what_to_do_next(rig, leaking) -> None:
    fields = {item.name: getattr(leaking, item.name) for item in dataclasses.fields(Diagnosis)}
    fields |= {"ambiguous_with": [], "own": leaking.own[:1]}
    found = DiagnoseResult(**fields, start=rig, hashes=("0" * 64,), seed=0, kept=1.0 / 3.0)
    (repair,) = found.report.next_steps
    assert repair.startswith("Next: repair the joint and record again, or use rig_extended.yaml,")
    assert " ".join(found.summary().split()).endswith(repair)
    assert plain(found.report)["next_steps"] == [repair]
    undecided = dataclasses.replace(found, ambiguous_with=["valve_offset", "encoder_zero"])
    decide, _ = undecided.report.next_steps
    assert decide.startswith("Next: record once more, to decide between leak and valve offset.")
    assert "--tell-apart" in decide
    # A sealed joint has no valves that excite could move.
    sealed = dataclasses.replace(undecided, start=load_rig("sealed_joint"))
    assert all("--tell-apart" not in step for step in sealed.report.next_steps)
    # The same leak, beside curves that are a guess.
    guessed = rig.replaced(priors={"effects.valve_offset.voltage_1": 0.5})
    measure = dataclasses.replace(found, start=guessed).report.next_steps[-1]
    assert measure.startswith("Next: measure the valves' curves before you repair anything")
    assert warnings.guessed_curves(guessed, ["leak", "friction"])[0].count("leak") == 1
    assert not warnings.guessed_curves(rig, ["leak"]) and not warnings.guessed_curves(guessed, ["friction"])
    nothing = dataclasses.replace(found, verdict="unexplained", effects=())
    assert "use rig_extended.yaml: it is shin2022 with its parameters fitted" in nothing.report.next_steps[-1]
    errors = dataclasses.replace(found.errors, extended=found.errors.as_configured)
    as_bad = dataclasses.replace(nothing, errors=errors)
    assert as_bad.report.next_steps[-1].startswith("Next: keep the rig file of shin2022")


def test_what_a_locked_joint_cannot_show_is_said(leaking) -> None:
    assert any("friction" in line and "locked" in line for line in leaking.unseen)


def test_the_likelihood_of_what_was_found_is_not_flat(leaking) -> None:
    profile = next(item for item in leaking.profiles if item.parameter == "leak.area_1")
    assert not profile.flat
    places = (np.array(profile.values) - profile.value) / profile.std
    rise = dict(zip(np.round(places, 2).tolist(), profile.rise, strict=True))
    # Half of it is beyond doubt, and so is none; nearby it bends as the standard error says.
    assert min(rise[at] for at in rise if at < -3.5) > 100.0
    assert all(0.3 < (rise[-at] + rise[at]) / (2.0 * at**2) < 3.0 for at in (1.5, 3.0))


def test_an_uncertain_size_is_still_a_size(leaking) -> None:
    """Where size and shape stand for one another neither is certain, and what was found has a value nevertheless."""
    vague = tuple(dataclasses.replace(fitted, covariance=1e8 * fitted.covariance) for fitted in leaking.extended.fits)
    model = dataclasses.replace(leaking.extended, fits=vague)
    effects, values, _ = findings.found_effects(leaking.experiments, model, {"leak": 9.0}, {"leak": 0.9})
    size, std, _ = effects[0].parameters["area_1"]
    assert (effects[0].muscle, effects[0].recordings) == (1, leaking.effects[0].recordings)
    assert size == values["effects.leak.area_1"] == leaking.effects[0].parameters["area_1"][0]
    assert std > 2.0 * size


def test_a_wrong_parameter_is_no_effect(rig, recorded) -> None:
    found = diagnose([recorded()], rig, joint="locked", jobs=1, estimator=False)
    assert found.verdict == "none"
    assert found.effects == ()
    assert found.errors.recalibrated == found.errors.extended


def test_what_is_in_no_catalogue_is_unexplained(rig, recorded) -> None:
    faulty = recorded("exchange", None, "chambers exchange air", 25.0, seconds=24.0)
    found = diagnose([faulty], rig, joint="locked", jobs=1, estimator=False)
    assert found.verdict == "unexplained"
    assert found.effects == ()
    assert found.remaining
    assert found.rig_extended.effects == {}


def test_recordings_that_are_too_short_are_refused(rig, recorded) -> None:
    with pytest.raises(BadInput, match="too short"):
        diagnose([recorded(seconds=12.0)], rig, joint="locked")


def test_no_recording_is_refused(rig) -> None:
    with pytest.raises(BadInput, match="no recording"):
        diagnose([], rig)


@pytest.fixture(scope="module")
def kept(tmp_path_factory) -> Checkpoint:
    """What the fits of pressures alone came to: two tests ask of them."""
    return Checkpoint(tmp_path_factory.mktemp("kept"))


@pytest.mark.slow(15)
def test_pressures_alone_say_so(rig, recorded, kept) -> None:
    bare = dataclasses.replace(
        recorded("valve_offset", 2, "shift and gain", 15.0, seconds=24.0), angle=None, torque=None
    )
    found = diagnose([bare], rig, joint="locked", jobs=1, profiles=False, estimator=False, store=kept)
    assert any("Pressures alone" in line for line in found.unseen)
    assert found.errors.extended.torque is None
    assert found.effects and found.effects[0].name in ("valve_offset", "pressure_sensor", "leak")
    assert np.isfinite(found.share)
    decided = next(line for line in found.warnings if "innovations" in line)
    evidence = float(decided.rsplit("(", 1)[1].split(")")[0])
    assert evidence > 6.0 and "innovations support" in decided


def test_innovations_that_do_not_agree_have_the_last_word(rig, recorded, kept, monkeypatch) -> None:
    """The pressures of a model that is run alone may call for an effect that tells an estimator nothing."""
    monkeypatch.setattr(held_out, "innovation_evidence", lambda prepared, compared, jobs: 5.0)
    bare = dataclasses.replace(
        recorded("valve_offset", 2, "shift and gain", 15.0, seconds=24.0), angle=None, torque=None
    )
    found = diagnose([bare], rig, joint="locked", jobs=1, profiles=False, estimator=False, store=kept)
    assert found.verdict == "unexplained" and not found.effects
    assert found.share == 0.0  # the extended model is the recalibrated one
    assert any("innovations on the held-out part do not (+5)" in line for line in found.warnings)
