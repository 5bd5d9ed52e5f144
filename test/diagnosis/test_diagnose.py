"""The verdict, on joints whose fault is known and written in another form than the catalogue's."""

from __future__ import annotations

import dataclasses
import json
import re

import numpy as np
import pytest

from pam_antagonist import simulate
from pam_antagonist.api.diagnose import DiagnoseResult
from pam_antagonist.api.history import entry
from pam_antagonist.diagnosis import Diagnosis, diagnose, findings, held_out, warnings
from pam_antagonist.diagnosis.errors import Errors, ModelErrors, Noise, RigErrors
from pam_antagonist.diagnosis.hypotheses import ResumeFolder
from pam_antagonist.diagnosis.result import FoundCalibration
from pam_antagonist.diagnosis.rig_choice import RigFile
from pam_antagonist.diagnosis.sentences import course_in_words
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation.metrics import ChannelErrors
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.replays.result import TORQUE
from pam_antagonist.report.close_loop_findings import calibration_findings
from pam_antagonist.report.document import Tiles
from pam_antagonist.rig import load_rig
from pam_antagonist.rig.learned import Law


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


@pytest.fixture
def result(rig, leaking) -> DiagnoseResult:
    """The diagnosis with its inputs."""
    fields = {item.name: getattr(leaking, item.name) for item in dataclasses.fields(Diagnosis)}
    fields |= {"ambiguous_with": [], "own": leaking.own[:1]}
    return DiagnoseResult(**fields, start=rig, hashes=("a" * 64,), seed=0, kept=1.0 / 3.0)


def times(errors: RigErrors, factor: float, filtered: float = 1.0) -> RigErrors:
    """Errors of the model alone and of the filter, each times a factor."""

    def scaled(one: Errors, factor: float) -> Errors:
        torque = dataclasses.replace(one.torque, rmse=factor * one.torque.rmse)
        return dataclasses.replace(one, torque=torque, rmse_pa=tuple(factor * value for value in one.rmse_pa))

    return dataclasses.replace(errors, model=scaled(errors.model, factor), ukf=scaled(errors.ukf, filtered))


def with_errors(found: DiagnoseResult, **factors: tuple[float, float]) -> DiagnoseResult:
    """The same with other errors by one rig: factors of those as configured, of the model alone and of the filter."""
    given = found.of_one_rig["as_configured"]
    return dataclasses.replace(
        found, of_one_rig={**found.of_one_rig, **{name: times(given, *each) for name, each in factors.items()}}
    )


def test_a_rig_with_which_anything_is_worse_is_neither_written_nor_proposed(result, tmp_path) -> None:
    assert result.rig_files == ("rig_extended.yaml",) and result.choice.proposed.name == "rig_extended.yaml"
    # On a stranger's joint the model was better and the filter worse; on a measured one it was the other way round.
    for number, factors in enumerate(((0.5, 1.2), (1.9, 0.5), (0.5, float("nan")))):
        worse = with_errors(result, extended=factors, recalibrated=(1.0, 1.0))
        assert worse.rig_files == () and worse.choice.proposed is None
        said = worse.next_steps
        assert said[0].startswith("There is no rig_extended.yaml, since this rig would be worse than shin2022 (the ")
        assert said[-1].endswith("until then, keep the rig file of shin2022.") and worse.next_rig is None
        worse.save(tmp_path / str(number), figures=False)
        assert sorted(path.name for path in (tmp_path / str(number)).iterdir()) == ["report.html", "report.json"]
    # Near the noise, one error of the model alone may grow a little where the filter gains much.
    assert with_errors(result, extended=(1.1, 0.5), recalibrated=(1.0, 1.0)).next_rig == "rig_extended.yaml"
    assert with_errors(result, extended=(1.1, 1.0), recalibrated=(1.0, 1.0)).rig_files == ()


def test_the_best_of_the_three_rigs_is_proposed_and_the_only_one_that_is_named(result, tmp_path) -> None:
    base = with_errors(result, extended=(1.0, 1.3), recalibrated=(0.4, 0.4))
    assert base.rig_files == ("rig_recalibrated.yaml",) and base.next_rig == "rig_recalibrated.yaml"
    assert "or use rig_recalibrated.yaml, which" in base.next_steps[-1]
    assert "the filter's torque error" in base.next_steps[-1]
    base.save(tmp_path / "out", figures=False)
    assert not load_rig(tmp_path / "out" / "rig_recalibrated.yaml").effects
    # Its parameters were fitted to the effect as well: a little better here may be worse elsewhere.
    assert with_errors(result, extended=(1.0, 1.3), recalibrated=(0.8, 0.8)).choice.proposed is None
    # A filter that is as good as before is no reason to change a file, however good the model alone is.
    same = with_errors(result, extended=(0.1, 1.0), recalibrated=(0.1, 1.0))
    assert same.choice.proposed is None and same.rig_files == ("rig_extended.yaml",)


def test_a_law_by_the_time_since_the_start_is_written_but_not_proposed_for_other_days(result) -> None:
    def with_law_by(argument: str) -> DiagnoseResult:
        law = Law("force", (0.0, 40.0), (0.0, 3.0), 1, argument)
        found = with_errors(result, extended=(0.4, 0.3), recalibrated=(0.6, 0.5))
        return dataclasses.replace(found, effects=(dataclasses.replace(found.effects[0], name="learned", law=law),))

    by_length, by_time = with_law_by("length"), with_law_by("time")
    assert by_length.next_rig == by_length.rig_files[0] == by_time.rig_files[0] == "rig_extended.yaml"
    assert by_time.next_rig == "rig_recalibrated.yaml"
    assert "its law depends on the time since the start" in by_time.next_steps[0]
    assert not any("time since the start" in step for step in by_length.next_steps)


def test_recalibration_is_compared_with_what_the_user_had(result) -> None:
    nothing = dataclasses.replace(result, verdict="none", effects=())
    (use,) = with_errors(nothing, extended=(0.5, 0.5)).next_steps
    assert use.startswith("Next: nothing to repair; use rig_extended.yaml, which every command")
    assert use.endswith("it is shin2022, recalibrated by these recordings.")
    (keep,) = with_errors(nothing, extended=(1.0, 1.0)).next_steps
    assert keep == "Next: nothing; keep the rig file of shin2022."
    # A file whose interval is too narrow is not kept without a word.
    given = nothing.of_one_rig["as_configured"]
    sure = dataclasses.replace(given.ukf, torque=dataclasses.replace(given.ukf.torque, coverage95=0.19))
    narrow = {**nothing.of_one_rig, "as_configured": dataclasses.replace(given, ukf=sure)}
    (keep,) = with_errors(dataclasses.replace(nothing, of_one_rig=narrow), extended=(1.0, 1.0)).next_steps
    assert keep.endswith(
        "keep the rig file of shin2022, whose 95 % interval holds only 19.0 % of the torques that were held out."
    )
    # Where nothing explains the recordings, the file has to halve an error of the filter, and none may be larger.
    unexplained = dataclasses.replace(nothing, verdict="unexplained")
    for factors in ((0.4, 0.7), (1.6, 0.4), (0.4, 1.1)):
        assert with_errors(unexplained, extended=factors).choice.proposed is None
    halved = with_errors(unexplained, extended=(0.6, 0.4))
    assert halved.next_rig == "rig_extended.yaml" and "use rig_extended.yaml, which" in halved.next_steps[-1]


def test_a_rig_that_no_command_would_read_is_not_proposed(result) -> None:
    impossible = result.rig_extended.replaced(uncertainty={"friction.shaft": 1.0})
    refused = with_errors(dataclasses.replace(result, rig_extended=impossible), recalibrated=(1.0, 1.0))
    assert refused.rig_files == () and "no command would read it (" in refused.choice.no_common
    assert refused.next_rig is None


def test_a_calibration_beyond_every_option_is_said_and_written_nowhere(result) -> None:
    scale = FoundCalibration("torque_scale", -0.84, 0.01, "-", 99.0, {})
    found = dataclasses.replace(result, calibrations=(scale,), typed=Corrections(torque_scale=0.3))
    assert found.corrections == () and "its calibration would be larger than" in found.choice.no_common
    (finding,) = calibration_findings(found)
    assert finding.text.endswith("Together with the options given, that is too much.")


def test_headline_and_tiles_start_from_what_the_user_had(result) -> None:
    """A rig that was good before recalibration: what the effect regains is no gain for its user."""
    start, _, end = result.errors.all
    assert f"{start.torque.rmse:.2g} N m" in result.sentence and f"{end.torque.rmse:.2g} N m" in result.sentence
    shown = next(item for item in result.document(False).blocks if isinstance(item, Tiles)).items
    (torque,) = (tile for tile in shown if tile.label.startswith("Torque"))
    written = [TORQUE.write(errors.torque.rmse) for errors in result.errors.all]
    assert (torque.value, torque.note) == (written[2], f"as configured {written[0]}, recalibrated {written[1]}")


def test_an_effect_has_what_it_took_off_and_recalibration_the_rest(result) -> None:
    def said(*angles: float) -> str:
        each = [dataclasses.replace(result.errors.extended, angle=ChannelErrors("deg", rmse, rmse, 0.1), torque=None)
                for rmse in angles]  # fmt: skip
        return course_in_words(ModelErrors(*each), "this effect").replace(", 0.61 and 0.6 kPa", "")

    start, base, end = (f"{errors.torque.rmse:.2g} N m" for errors in result.errors.all)
    assert re.search(f"fall from {start}.* as configured to {base}.* by recalibration, and to {end}.* with this effect",
                     result.sentence)  # fmt: skip
    # An effect that changes nothing had all that recalibration gained.
    assert re.fullmatch(r"fall from 5.5°.* as configured to 1.3°.* by recalibration, and are 1.3°.* with this effect",
                        said(5.51, 1.33, 1.34))  # fmt: skip


def angle_and_torque(angle: float, torque: float, pressure: float = 600.0) -> RigErrors:
    """Errors of the filter and of the model alone, beside sensors with a noise of 0.003°, 0.01 N m and 600 Pa."""
    one = Errors(
        ChannelErrors("deg", angle, angle, 0.1), ChannelErrors("nm", torque, torque, 0.1), (pressure, pressure),
        noise=Noise(0.003, 0.01, 600.0),
    )  # fmt: skip
    return RigErrors(one, one)


@pytest.mark.parametrize(
    ("after", "better", "halved"),
    [
        # The angle falls to a fifteenth, and a torque and pressures at their noise cannot fall.
        (angle_and_torque(0.018, 0.0102, 610.0), True, True),
        (angle_and_torque(0.018, 0.0108, 640.0), True, True),
        (angle_and_torque(0.200, 0.0102), True, False),
        (angle_and_torque(0.018, 0.0150), False, False),
        (angle_and_torque(0.018, 0.0102, 2000.0), False, False),
        (angle_and_torque(0.27, 0.0101), False, False),
        (angle_and_torque(float("nan"), 0.0101), False, False),
    ],
)
def test_a_rig_is_judged_by_what_is_above_noise(result, after: RigErrors, better: bool, halved: bool) -> None:
    file = RigFile("rig.yaml", result.rig_extended, None, angle_and_torque(0.27, 0.0104, 940.0), after)
    assert file.is_better(True) is better and file.is_better(False) is halved
    if halved:
        assert file.gain == "the filter's angle error 0.0180° instead of 0.270°"


def test_recordings_with_different_faults_get_a_rig_each(result, tmp_path) -> None:
    rig, (entry,), (leak,) = result.rig_extended, result.by_recording, result.effects
    entries = tuple(dataclasses.replace(entry, recording=name) for name in ("one", "two"))
    both = dataclasses.replace(leak, recordings=("one", "two"))
    fields = {"own": (("one", rig), ("two", rig)), "by_recording": entries, "effects": (both,)}
    found = dataclasses.replace(result, **fields, hashes=("a" * 64,) * 2)
    assert found.rig_files == ("rig_extended.yaml", "rig_extended_1.yaml", "rig_extended_2.yaml")

    apart = tuple(dataclasses.replace(leak, muscle=k, recordings=(name,)) for k, name in ((1, "one"), (2, "two")))
    different = dataclasses.replace(found, effects=apart)
    said = "no rig suits all recordings: leak is on muscle 1 in one and on muscle 2 in two"
    assert different.choice.no_common == said
    different.save(tmp_path / "different", figures=False)
    rigs = sorted(path.name for path in (tmp_path / "different").glob("*.yaml"))
    assert rigs == ["rig_extended_1.yaml", "rig_extended_2.yaml"]
    assert "rig_extended.yaml" not in (tmp_path / "different" / rigs[0]).read_text(encoding="utf-8")
    assert "or use rig_extended_1.yaml for one, which" in different.next_steps[-1]

    alike = with_errors(found, extended=(1e6, 1.0), recalibrated=(1.0, 1.0))
    assert alike.choice.no_common.startswith("one rig for all recordings would be worse than shin2022 (the model's ")
    assert alike.rig_files == ("rig_extended_1.yaml", "rig_extended_2.yaml")
    # A recording in which the filter is much worse counts, whatever the others gain.
    given = found.of_one_rig["as_configured"]
    each = {"as_configured": (1.0, 1.0), "extended": (1.6, 0.2)}
    split = {
        name: dataclasses.replace(given, each=tuple(times(given, 1.0, factor).ukf for factor in factors))
        for name, factors in each.items()
    }
    uneven = dataclasses.replace(found, of_one_rig={**found.of_one_rig, **split})
    assert "the filter's torque error in one recording" in uneven.choice.no_common


def test_the_log_book_keeps_the_size_of_an_effect_and_a_monitor_can_be_told(rig, result) -> None:
    (size,) = [
        size for name, size in entry("close_loop", [], rig, result).values.items() if name.startswith("leak: area")
    ]
    leak = json.loads(json.dumps(result.report))["effects"][0]
    assert leak["name"] == "leak" and size.unit == "m2"
    assert size.value == next(iter(leak["parameters"].values()))["value"] > 0.0


def test_a_report_says_what_to_do_next(rig, result) -> None:
    (repair,) = result.next_steps
    assert repair.startswith("Next: repair the joint and record again, or use rig_extended.yaml,")
    assert " ".join(result.summary().split()).endswith(repair)
    assert result.report["next_steps"] == [repair] and result.report["next_rig"] == "rig_extended.yaml"
    undecided = dataclasses.replace(result, ambiguous_with=["valve_offset", "encoder_zero"])
    decide, _ = undecided.next_steps
    assert decide.startswith("Next: record once more, to decide between leak and valve offset.")
    assert "--tell-apart" in decide
    # A sealed joint has no valves that excite could move.
    sealed = dataclasses.replace(undecided, start=load_rig("sealed_joint"))
    assert all("--tell-apart" not in step for step in sealed.next_steps)
    # The same leak, beside curves that are a guess.
    guessed = rig.replaced(priors={"effects.valve_offset.voltage_1": 0.5})
    measure = dataclasses.replace(result, start=guessed).next_steps[-1]
    assert measure.startswith("Next: measure the valves' curves before you repair anything")
    assert warnings.guessed_curves(guessed, ["leak", "friction"])[0].count("leak") == 1
    assert not warnings.guessed_curves(rig, ["leak"]) and not warnings.guessed_curves(guessed, ["friction"])


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
    effects, values, _ = findings.found_effects(model, {"leak": 9.0}, {"leak": 0.9})
    size, std, _ = effects[0].parameters["area_1"]
    assert (effects[0].muscle, effects[0].recordings) == (1, leaking.effects[0].recordings)
    assert size == values["effects.leak.area_1"] == leaking.effects[0].parameters["area_1"][0]
    assert std > 2.0 * size


def test_an_effect_whose_derivative_is_0_has_a_size_and_one_that_is_0_is_not_found(leaking) -> None:
    """Friction above a level balances all torques as well as friction at it: `close_loop` ended in a traceback."""

    def model(scale: float):
        fits = []
        for fitted in leaking.extended.fits:
            effects = {path: scale * value for path, value in fitted.point.effects.items()}
            point = dataclasses.replace(fitted.point, effects=effects)
            fits.append(dataclasses.replace(fitted, point=point, effect=0.0 * fitted.effect))
        return dataclasses.replace(leaking.extended, fits=tuple(fits))

    (effect,), values, _ = findings.found_effects(model(1.0), {"leak": 9.0}, {"leak": 0.9})
    size, std, _ = effect.parameters["area_1"]
    assert effect.recordings == leaking.effects[0].recordings and std == size == values["effects.leak.area_1"]
    nothing = findings.found_effects(model(0.0), {"leak": 9.0}, {"leak": 0.9})
    assert (nothing.effects, nothing.values) == ((), {})


def test_a_wrong_parameter_is_no_effect(rig, recorded) -> None:
    found = diagnose([recorded()], rig, joint="locked", jobs=1, estimator=False)
    assert found.verdict == "none"
    assert found.effects == ()
    assert found.errors.recalibrated == found.errors.extended


@pytest.mark.slow(4)
def test_a_calibration_at_the_bound_of_its_search_is_not_taken(rig, recorded) -> None:
    """A torque in another unit, or another rig's file: this ended as an error about an option that nobody typed."""
    recording = recorded(seconds=21.0)
    found = diagnose(
        [dataclasses.replace(recording, torque=0.05 * recording.torque)], rig, joint="locked", jobs=1, profiles=False
    )
    assert (found.verdict, found.calibrations) == ("unexplained", ())


def test_what_is_in_no_catalogue_is_unexplained(rig, recorded) -> None:
    faulty = recorded("exchange", None, "chambers exchange air", 25.0, seconds=24.0)
    found = diagnose([faulty], rig, joint="locked", jobs=1, estimator=False)
    assert found.verdict == "unexplained"
    assert found.effects == ()
    assert found.remaining and all(item.end_s > item.begin_s for item in found.remaining)
    named = sorted((item for item in found.remaining if item.is_of_sensor), key=lambda item: -item.times_noise)
    assert named[0].in_short() in found.sentence and "well above" not in found.sentence
    assert found.rig_extended.effects == {}


def test_recordings_that_are_too_short_are_refused(rig, recorded) -> None:
    with pytest.raises(BadInput, match="too short"):
        diagnose([recorded(seconds=12.0)], rig, joint="locked")


@pytest.fixture(scope="module")
def kept(tmp_path_factory) -> ResumeFolder:
    """What the fits of pressures alone came to: two tests ask of them."""
    return ResumeFolder(tmp_path_factory.mktemp("kept"))


@pytest.mark.slow(4)
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
    monkeypatch.setattr(held_out, "innovation_evidence", lambda compared, jobs: 5.0)
    bare = dataclasses.replace(
        recorded("valve_offset", 2, "shift and gain", 15.0, seconds=24.0), angle=None, torque=None
    )
    found = diagnose([bare], rig, joint="locked", jobs=1, profiles=False, estimator=False, store=kept)
    assert found.verdict == "unexplained" and not found.effects
    assert found.share == 0.0  # the extended model is the recalibrated one
    assert any("innovations on the held-out part do not (+5)" in line for line in found.warnings)
