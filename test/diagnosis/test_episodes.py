"""A regulator-driven joint: friction that goes with another joint's pressures is found, and nothing where nothing is.

The joint of these tests is simulated by a few lines of its own (semi-implicit Euler, Coulomb friction as a bound on the
velocity), not by the package's model.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pam_antagonist
from pam_antagonist import load_rig
from pam_antagonist.cli.close_loop import main
from pam_antagonist.diagnosis.episodes import WEAK_LAWS, diagnose, search
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation.further import PLACES
from pam_antagonist.identification.episodes import is_fair
from pam_antagonist.inference.bootstrap import Interval, drawn, ratio, rmse
from pam_antagonist.inference.episode_search import ABOVE_NOISE, with_effect
from pam_antagonist.inference.held_episodes import held_out
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.inference.weak_features import coefficients
from pam_antagonist.inference.weak_laws import WeakFit, WeakModel
from pam_antagonist.model.drive import Inputs
from pam_antagonist.recording import Recording, write_bag
from pam_antagonist.recording.recording import FurtherSignal
from pam_antagonist.report import episodes as report
from pam_antagonist.report.document import number
from pam_antagonist.report.episodes import EpisodesDiagnoseResult
from pam_antagonist.report.identify_episodes import interval, units_findings
from pam_antagonist.rig.units import unread
from pam_antagonist.strict_json import dumps

RIG = load_rig("regulator_joint", regulators=True)
EPISODES, ROWS, PERIOD = 120, 60, 0.0125
GAIN, STIFFNESS, VISCOUS = 2.4e-4, 60.0, 6.0  # [rad/s² by Pa], [1/s²], [1/s]
SUBSTEPS = 25


def joint(by_signal: float, coulomb: float | np.ndarray = 8.0, seed: int = 1, by_late: float = 0.0) -> Recording:
    """Episodes of a joint whose friction grows with one of two signals by so many rad/s² a Pa, or with time.

    A torque grows with what of that signal fades within 0.1 s, by ``by_late`` [rad/s² by Pa].
    """
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(ROWS)
    parts: dict[str, list[np.ndarray]] = {"pressure": [], "angle": [], "other": [], "decoy": []}
    for constant in np.broadcast_to(coulomb, EPISODES):
        waves = [
            350e3 + 150e3 * rng.uniform() * np.sin(rng.uniform(4.0, 16.0) * time + rng.uniform(0.0, 6.3)) for _ in "12"
        ]
        other, decoy = (rng.uniform(250e3, 550e3) + 40e3 * np.sin(rng.uniform(5.0, 12.0) * time) for _ in "12")
        parts["pressure"].append(np.column_stack(waves))
        parts["other"].append(other)
        parts["decoy"].append(decoy)
        friction = constant + by_signal * (other - 400e3)
        parts["angle"].append(
            _moved(waves[0] - waves[1] + by_late * _late(other) / GAIN, friction) + 2e-4 * rng.standard_normal(ROWS)
        )
    whole = {name: np.concatenate(values) for name, values in parts.items()}
    stamps = 10**18 + np.concatenate([e * 3 * 10**9 + np.rint(time * 1e9).astype(np.int64) for e in range(EPISODES)])
    return Recording(
        Path("arm"), stamps, whole["pressure"], np.zeros((len(stamps), 2)), whole["angle"],
        signals={name: FurtherSignal(whole[name], "Pa") for name in ("other", "decoy")}, episode_ns=stamps[::ROWS],
    )  # fmt: skip


def _late(values: np.ndarray) -> np.ndarray:
    """What of a signal fades within 0.1 s (R,)."""
    held = values.copy()
    for k in range(1, len(values)):
        held[k] += (held[k - 1] - held[k]) * math.exp(-PERIOD / 0.1)
    return values - held


def _moved(difference: np.ndarray, friction: np.ndarray) -> np.ndarray:
    angle, velocity, out = 0.0, 0.0, [0.0]
    h = PERIOD / SUBSTEPS
    for k in range(1, ROWS):
        for s in range(SUBSTEPS):
            late = (s + 0.5) / SUBSTEPS
            pull, bound = ((1.0 - late) * a[k - 1] + late * a[k] for a in (difference, friction))
            free = (velocity + h * (GAIN * pull - STIFFNESS * angle)) / (1.0 + h * VISCOUS)
            velocity = math.copysign(max(abs(free) - h * max(bound, 0.0), 0.0), free)
            angle += h * velocity
        out.append(angle)
    return np.array(out)


@pytest.fixture(scope="module")
def tied() -> Recording:
    return joint(by_signal=6e-5)


@pytest.mark.slow(8)
def test_friction_is_traced_to_the_signal_that_it_goes_with(tied: Recording, tmp_path: Path) -> None:
    result = pam_antagonist.diagnose(tied, "regulator_joint", also=["decoy", "other"])
    assert isinstance(result, EpisodesDiagnoseResult)
    episodes, found = result.joint, result.found
    assert "friction that grows with other" in result.sentence
    # That no other command reads the signal is said where the rig file is proposed.
    step = result.summary().split("Next: ")[1]
    assert "in identify, close_loop, replay and the estimator" in step and "do not read" in step
    assert "every command" not in step
    assert set(found.effects) == {"friction", "friction_by_signal: other"}
    base, coulomb, extended = found.rows[1:]
    assert extended.later.high < 0.5 * coulomb.later.low < base.later.low
    assert extended.interleaved.value < 0.25 * coulomb.interleaved.value
    inertia = episodes.rig.joint.inertia
    slope = found.values["effects.friction_by_signal.slope2"]
    assert slope.value / inertia == pytest.approx(6e-5, rel=0.1)
    assert found.values["joint.stiffness"].value / inertia == pytest.approx(STIFFNESS, rel=0.05)
    assert found.values["joint.viscous_friction"].value / inertia == pytest.approx(VISCOUS, rel=0.15)

    assert result.report["verdict"] == "effect" and result.report["share_explained"] > 0.99
    # The report has the keys of all others.
    kept = json.loads((Path(__file__).parents[1] / "golden" / "close_loop.json").read_text(encoding="utf-8"))
    assert list(result.report)[: len(kept)] == list(kept)
    assert list(result.report["ranking"][0]) == list(kept["ranking"][0])

    # What counts is the gain over the rig that the user had.
    given = found.rows[0].later.value
    assert f"falls from {number(given)}° as configured to" in result.sentence and result.next_rig == "rig_extended.yaml"
    assert f"to {number(base.later.value)}° by a fit without that" in result.sentence
    no_better = replace(result, found=replace(found, rows=(extended, base, coulomb, extended)))
    assert no_better.next_rig is None and "Next: keep the rig file of regulator_joint" in no_better.summary()
    no_better.save(tmp_path / "out", figures=False)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["report.html", "report.json"]


@pytest.mark.slow(4)
def test_an_effect_that_explains_a_part_only_is_no_explanation(tied: Recording) -> None:
    """Friction that goes with a signal, which nobody names: constant friction takes a third of the error."""
    result = pam_antagonist.diagnose(tied, "regulator_joint")
    assert isinstance(result, EpisodesDiagnoseResult)
    report = result.report
    assert report["verdict"] == "unexplained" and report["share_explained"] < 0.4
    assert result.sentence.startswith("The model lacks more than what was found: constant (Coulomb) friction explains")
    (left,) = report["left"]
    assert left["channel"] == "angle" and left["times_noise"] > 100.0
    assert "named by --also" in report["next_steps"][-1] and "What is left" in result.summary()


@pytest.mark.slow(8)
def test_nothing_is_found_where_friction_is_constant_but_that() -> None:
    episodes = PressureDriven.of(joint(by_signal=0.0, seed=2), RIG, ["decoy", "other"])
    searched = search(episodes, held_out(len(episodes), 1.0 / 3.0).pool, lambda text: None)
    assert [item.name for item in searched.tried if item.taken] == ["friction"]
    assert list(searched.model.effects) == ["effects.friction.coulomb"]


@pytest.mark.thorough(13)
def test_of_few_episodes_nothing_is_named_that_is_hardly_more_than_noise() -> None:
    """What this simulation's own steps leave is explained by creep, to half; readings are no better than that."""
    count = 24
    whole = PressureDriven.of(joint(by_signal=0.0, coulomb=0.0, seed=4), RIG)
    searched = search(whole.take(np.arange(count)), held_out(count, 1.0 / 3.0).pool, lambda text: None)
    assert not [item.name for item in searched.tried if item.taken]
    assert searched.left.low < ABOVE_NOISE and any(item.removed and item.removed.low > 0.0 for item in searched.tried)
    rough = PressureDriven.of(joint(by_signal=0.0, coulomb=3.0, seed=4), whole.rig)
    searched = search(rough.take(np.arange(count)), held_out(count, 1.0 / 3.0).pool, lambda text: None)
    assert [item.name for item in searched.tried if item.taken][0].startswith("friction")


@pytest.mark.thorough(9)
def test_a_signal_that_goes_with_another_one_is_not_told_apart_from_it(tied: Recording) -> None:
    other = tied.signals["other"]
    noise = 2e3 * np.random.default_rng(7).standard_normal(len(tied))
    both = replace(tied, signals={"other": other, "alike": FurtherSignal(other.values + noise, "Pa")})
    episodes = PressureDriven.of(both, RIG, ["other", "alike"])
    found = diagnose(episodes, 1.0 / 3.0)
    assert set(found.effects) < {"friction", "friction_by_signal: other", "friction_by_signal: alike"}
    (one, place, row), *_ = [item for item in found.others if item[0].startswith("friction_by_signal")]
    assert {one, place} == {"friction_by_signal: other", "friction_by_signal: alike"}
    assert row.later.value < 0.1 * found.rows[1].later.value
    assert row.later.value == pytest.approx(found.rows[-1].later.value, rel=0.5)
    said = [
        item.text
        for item in report.findings(found, episodes)
        if item.text.startswith("The episodes do not decide between two effects")
    ]
    assert any("friction that grows with other" in text and "friction that grows with alike" in text for text in said)


@pytest.mark.thorough(10)
def test_a_friction_that_grows_over_the_recording_is_said_to_drift() -> None:
    """Coulomb friction grows from 4 to 12 rad/s²; how the torque goes with the pressures stays."""
    episodes = PressureDriven.of(joint(by_signal=0.0, coulomb=np.linspace(4.0, 12.0, EPISODES), seed=6), RIG)
    found = diagnose(episodes, 1.0 / 3.0)
    assert found.weak is not None and found.removed is not None and found.removed.low > 0.5
    *_, alone, drifting = found.rows
    assert drifting.later.value < 0.8 * alone.later.value
    assert drifting.interleaved.value < 0.5 * alone.interleaved.value
    slopes = {(one.of, one.by): one for one in found.slopes}
    inertia = episodes.rig.joint.inertia
    levels = [part.value / inertia for part in slopes["friction", "level"].parts]
    # Two thirds of the recording are fitted, a third of them is a part.
    assert levels == pytest.approx([4.9, 6.7, 8.4], abs=0.8)
    assert not slopes["friction", "level"].agrees
    for muscle, sign in ((1, 1.0), (2, -1.0)):
        slope = slopes["torque", f"pressure_{muscle}"]
        assert slope.agrees
        assert [part.value / inertia for part in slope.parts] == pytest.approx([sign * GAIN] * 3, rel=0.15)
        assert all(part.low < sign * GAIN * inertia < part.high for part in slope.parts)


@pytest.mark.thorough(17)
def test_the_command_writes_a_rig_that_does_as_well(tied: Recording, tmp_path: Path, capsys: Any) -> None:
    tied = tied.slice(0.0, 3.0 * 40 - 1.0)
    write_bag(tmp_path / "bag", tied)
    run = ["--rig", "regulator_joint", "--also", "other", "--no-figures"]
    assert main([str(tmp_path / "bag"), *run, "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "friction that grows with other" in said
    numbers = json.loads((tmp_path / "out" / "report.json").read_text())
    rig = load_rig(tmp_path / "out" / "rig_extended.yaml", regulators=True)
    assert rig.drive == "regulator" and list(rig.signals) == ["other"]
    again = replace(PressureDriven.of(tied, rig), longest_step=numbers["longest_step_s"])
    later = again.take(held_out(len(again), 1.0 / 3.0).later)
    error = np.degrees(later.squares(later.residual(later.as_configured)).rmse)
    row = numbers["errors_deg"][-1]
    assert error == pytest.approx(row["later"][0], rel=1e-6)


@pytest.mark.parametrize(
    ("options", "rig", "says"),
    [
        (["--also", "elbow"], "regulator_joint", "no signal 'elbow'; expected one of decoy, other"),
        (["--also", "other"], "shin2022", "--also: not for short trials of a joint"),
        (
            ["--dask", "tcp://127.0.0.1:1"],
            "regulator_joint",
            "--dask: not for many episodes of a joint with pressure regulators",
        ),
    ],
)
def test_what_cannot_be_is_refused(
    tied: Recording, tmp_path: Path, capsys: Any, options: list[str], rig: str, says: str
) -> None:
    write_bag(tmp_path / "bag", tied)
    assert main([str(tmp_path / "bag"), "--rig", rig, *options, "--out", str(tmp_path / "out")]) == 2
    assert says in capsys.readouterr().err


def test_a_recording_in_one_piece_is_refused(tied: Recording) -> None:
    with pytest.raises(BadInput, match="1 whole episodes of 1; expected at least 20"):
        PressureDriven.of(tied.slice(0.0, 0.5), RIG)


def test_episodes_of_a_few_rows_are_left_out(tied: Recording) -> None:
    """A bag may have them: the last one of a single row, and one of three."""
    marks = np.append(tied.episode_ns, [tied.stamp_ns[-4], tied.stamp_ns[-1]])
    found = PressureDriven.of(replace(tied, episode_ns=marks), RIG)
    assert (len(found), found.left_out) == (EPISODES, 2)
    assert np.isfinite(found.residual(found.as_configured)).all()


def test_setpoints_in_the_place_of_measured_pressures_are_refused(tied: Recording) -> None:
    signals = {**tied.signals, "p1_set": FurtherSignal(tied.pressure[:, 0], "Pa")}
    with pytest.raises(BadInput, match="pressure_1 is p1_set, row by row"):
        PressureDriven.of(replace(tied, signals=signals), RIG)


def test_only_who_is_ready_for_it_gets_a_rig_with_regulators() -> None:
    with pytest.raises(BadInput, match=r"pressure regulators \(drive: regulator\), expected one with valves"):
        load_rig("regulator_joint")


def test_rows_of_any_period_give_the_same_course() -> None:
    """Inner steps: a row in the place of four changes little where the pressures are linear between them."""
    time = np.linspace(0.0, 1.0, 201)
    pressure = np.column_stack([300e3 + 200e3 * time, 400e3 - 100e3 * time])
    p, start = RIG.parameters(), np.array([0.1])
    fine, coarse = (
        along.driven(along.settled(start, pressure[:1], p), p)[0][:, 0]
        for along in (Inputs.at(time[::every], 1e-3, pressure=pressure[::every]) for every in (1, 4))
    )
    assert coarse == pytest.approx(fine[::4], abs=1e-4)
    assert np.ptp(fine) > 0.05


def test_episodes_are_held_out_whole_and_once() -> None:
    held = held_out(100, 0.3)
    assert sorted([*held.pool, *held.interleaved, *held.later]) == list(range(100))
    assert held.later.min() == 70 and len(held.interleaved) == 14


def test_neighbouring_episodes_are_drawn_together() -> None:
    """Episodes that err alike in tens tell as little as a tenth of them: the interval is as wide."""
    rng = np.random.default_rng(3)
    tens = np.repeat(rng.uniform(0.5, 1.5, 40), 10)
    alone = ratio(rng.uniform(0.5, 1.5, 400), np.ones(400))
    together = ratio(tens, np.ones(400))
    assert together.high - together.low > 2.0 * (alone.high - alone.low)
    assert drawn(400).shape == (1000, 400) and np.all(drawn(403).sum(axis=0) > 0.0)


def test_no_interval_excludes_its_own_value() -> None:
    """A step into a bound, or along numbers that replace each other, leads away from the value in every draw."""
    for value, draws in ((0.951, np.zeros(300)), (2.0, np.linspace(70.0, 90.0, 300))):
        lost = Interval.of(value, draws)
        assert lost.value == value and not lost.is_known
        assert interval(lost) == f"{number(value)} (not determined)"
        assert json.loads(dumps(lost)) == [value, None, None]
    assert Interval.of(1.0, np.linspace(0.0, 2.0, 301)).is_known and Interval.of(0.3, np.full(9, 0.1 + 0.2)).is_known
    # One episode in a part that no draw of whole blocks had: its error was in the value and never in the draws.
    sums = np.append(np.full(29, 1e-4), 1.0)
    assert rmse(sums, np.ones(30)).is_known


def test_numbers_that_replace_each_other_have_no_interval(tied: Recording) -> None:
    """Two signals that are one: how much goes with each of them is not determined, and no number says it is."""
    both = replace(tied, signals=dict.fromkeys(("other", "alike"), tied.signals["other"]))
    episodes = PressureDriven.of(both, RIG, ["other", "alike"]).take(np.arange(30))
    model = episodes.fit(with_effect(episodes.as_configured, episodes.candidates({})["friction"], {}), 2)
    values = episodes.intervals(model)
    assert all(not one.is_known or one.low <= one.value <= one.high for one in values.values())


def test_a_rig_that_was_fitted_to_the_episodes_is_not_compared_with_as_if_it_was_not(tied: Recording) -> None:
    unseen = PressureDriven.of(tied, RIG)
    assert is_fair(unseen) and is_fair(PressureDriven.of(tied, RIG.replaced(identified="first, second")))
    seen = PressureDriven.of(tied, RIG.replaced(identified=f"first, {unseen.name}"))
    assert not is_fair(seen)
    assert any("not fair: the values of regulator_joint are from this recording" in item.text
               for item in units_findings(seen))  # fmt: skip


def test_what_does_not_read_a_further_signal_is_said() -> None:
    rig = load_rig("regulator_joint", regulators=True)
    needs = rig.replaced(signals={"other": 4e5, "more": 3e5}, effects={"friction_by_signal": {"slope1": 1e-9}})
    assert unread(rig) == "" and "plant, controller and simulate do not read other and more (they" in unread(needs)


@pytest.mark.thorough(25)
def test_what_no_effect_of_the_catalogue_follows_is_left_to_weak_laws(tmp_path: Path) -> None:
    """A torque goes with what of another joint's pressure fades within 0.1 s."""
    recording = joint(by_signal=0.0, coulomb=2.0, seed=8, by_late=2e-4)
    result = pam_antagonist.diagnose(recording, "regulator_joint", also=["decoy", "other"])
    assert isinstance(result, EpisodesDiagnoseResult)
    found = result.found
    assert found.effects[-1] == WEAK_LAWS and found.removed is not None and found.removed.low > 0.5
    alone, extended = found.rows[-2], found.rows[-1]
    assert extended.later.high < 0.5 * alone.later.low
    assert found.weak is not None
    fit, numbers = found.weak[0], found.weak[1].numbers / found.weak[0].stds
    largest = fit.terms[int(np.argmax(np.abs(numbers)))]
    assert (PLACES[largest.place], largest.feature) == ("torque", "other within 0.1 s")
    # Few episodes, whose residuals the fit has made a little too small.
    assert min(found.coverage) >= 0.85, found.coverage
    assert "all fitted at once" in result.summary() and "leave out weak laws" in result.summary()
    result.save(tmp_path / "out")
    assert "Slopes of torque and friction" in (tmp_path / "out" / "report.html").read_text()

    # The rig file has what the joint was fitted with, and other commands that read it say what they leave out.
    rig = load_rig(tmp_path / "out" / "rig_extended.yaml", regulators=True)
    again = replace(PressureDriven.of(recording, rig), longest_step=found.longest_step)
    later = again.take(held_out(len(again), 1.0 / 3.0).later)
    error = np.degrees(later.squares(later.residual(later.as_configured)).rmse)
    assert error == pytest.approx(extended.later.value, rel=1e-6)
    assert "weak laws" in unread(rig)


def test_the_first_order_of_weak_laws_is_that_of_small_changes(tied: Recording) -> None:
    """Friction that holds the joint makes difference quotients a little rough."""
    whole = PressureDriven.of(tied, RIG, ["other"])
    pool = np.arange(30)
    model = whole.take(pool).fit(with_effect(whole.as_configured, whole.candidates({})["friction"], {}))
    fit = WeakFit.of(whole, model, pool)
    at_rest = WeakModel(model, np.zeros(len(fit.terms)), np.zeros((0, 0)))
    part, columns = fit.part(pool, at_rest.numbers)
    left, slopes = part.residual(model)[:, 0], fit.slopes(part, columns, model)
    chosen = [
        ("torque", "pressure_1*pressure_2"), ("torque*angle", "other"), ("torque*angle^2", "constant"),
        ("torque", "other within 0.1 s"), ("drag", "pressure_1"), ("friction", "constant"), ("friction", "other*other"),
        ("friction*slow", "pressure_2"), ("friction*fast", "other"), ("friction", "pressure_1 within 0.3 s*other"),
    ]  # fmt: skip
    known = [(PLACES[term.place], term.feature, term.ramp) for term in fit.terms]
    for place, feature in chosen:
        k = known.index((place, feature, -1))
        moved, _ = fit.part(pool, 0.05 * fit.stds * (np.arange(len(fit.terms)) == k))
        quotient = (moved.residual(model)[:, 0] - left) / 0.05
        assert np.linalg.norm(slopes[:, k] - quotient) < 0.2 * np.linalg.norm(quotient), (place, feature)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"numbers": {"torsion": {"constant": 1.0}}}, "weak_laws.numbers: .*torsion.*expected torque"),
        ({"numbers": {"torque": {"pressure_3": 1.0}}}, "weak_laws.numbers.torque: .*pressure_3"),
        ({"middle": {"pressure_1": 3e5}}, "inputs pressure_1; expected pressure_1, pressure_2"),
    ],
)
def test_weak_laws_of_what_there_is_not_are_refused(change: dict[str, Any], says: str) -> None:
    known = {"pressure_1": 3e5, "pressure_2": 3e5}
    laws = {"middle": known, "range": known, "numbers": {"torque": {"constant": 0.5, "pressure_1": 2.0}}}
    acts = {"weak_laws": {"amount": 1.0}}
    pressure, time = np.array([[3e5, 3e5], [6e5, 3e5]]), np.array([0.0, 0.01])
    given = (pressure, np.zeros((2, 0)), np.array([0, 2]), time)
    rig = RIG.replaced(effects={**RIG.effects, **acts}, weak_laws=laws)
    assert coefficients(rig, *given)[:, 0].tolist() == [0.5, 2.5]
    with pytest.raises(BadInput, match=says):
        coefficients(RIG.replaced(effects={**RIG.effects, **acts}, weak_laws={**laws, **change}), *given)
