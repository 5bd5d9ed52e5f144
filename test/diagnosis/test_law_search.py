"""The search for a law that nobody wrote: its place, what it depends on, a table; and none where nothing is wrong."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from pam_antagonist import diagnose, load_rig, simulate
from pam_antagonist.diagnosis import law_evidence, law_findings, law_search, learned_law, pipeline, sentences
from pam_antagonist.diagnosis.description import describe
from pam_antagonist.diagnosis.judged import JudgedJoint
from pam_antagonist.diagnosis.law_forms import LawForm
from pam_antagonist.diagnosis.law_search import FittedLaws, LawSearch, search
from pam_antagonist.diagnosis.learned_law import is_better, leaves_excess
from pam_antagonist.diagnosis.models import Model, recalibrated
from pam_antagonist.diagnosis.preparation import Settings, Timings
from pam_antagonist.diagnosis.result import Diagnosis, FoundEffect
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.gauss_newton import refit
from pam_antagonist.inference.trial import make_trial
from pam_antagonist.inference.valve_driven import ValveDriven
from pam_antagonist.recording import Recording
from pam_antagonist.report import html
from pam_antagonist.report.close_loop import DiagnoseResult
from pam_antagonist.rig import Rig
from pam_antagonist.rig.learned import Law, laws_of, with_law
from pam_antagonist.simulation.excitation import profile

EXCHANGE = Law(
    "exchange", (-3e5, -1e5, 0.0, 1e5, 3e5), (-1.8e-6, -1.2e-6, 0.0, 1.2e-6, 1.8e-6), None, "pressure_difference"
)
COGGING = Law("torque", (-0.2, -0.1, 0.0, 0.1, 0.2), (0.05, -0.05, 0.05, -0.05, 0.05), None, "angle")
ENGAGING = Law("torque", (-0.3, 0.05, 0.3), (0.0, 0.0, -0.25), None, "angle")


def rig() -> Rig:
    return load_rig("shin2022").replaced(sample_period=0.004)


def recorded(*laws: Law, duration: float = 36.0) -> Recording:
    """A free joint that has some laws."""
    own = rig()
    for law in laws:
        own = with_law(own, law)
    return simulate(own, profile("steps", duration, 0.004, seed=5), mismatch=0.01, seed=8)


def recalibrated_on(recording: Recording, own: Rig) -> Model:
    """The model of a rig, recalibrated on the first two thirds of a recording of a free joint."""
    trial = make_trial(recording, own, "free", 0.0, "free")
    return recalibrated([ValveDriven(own, trial, 2 * len(trial) // 3)])


def learned_from(recording: Recording, own: Rig) -> LawSearch:
    """What the search finds in a recording of a free joint."""
    return search(recalibrated_on(recording, own), lambda text: None)


@dataclasses.dataclass
class Course:
    """What a diagnosis went through: its result, the verdicts on the way, and the laws that were learned."""

    result: DiagnoseResult
    verdicts: list[JudgedJoint]
    learned: list[LawSearch]

    def like(self, *names: str) -> JudgedJoint:
        """The first verdict, as if it had named effects that leave all of the excess, the weaker ones first."""
        (part,) = self.verdicts[0].parts
        seen = (part.group.experiments[0].trial.name,)
        effects = (FoundEffect(name, None, {}, 20.0 + k, 0.1, seen) for k, name in enumerate(names))
        return dataclasses.replace(
            self.verdicts[0], parts=(dataclasses.replace(part, verdict="effect", effects=tuple(effects)),)
        )

    def described(self, before: JudgedJoint) -> Diagnosis:
        """The result, had that been the verdict before the law."""
        with_law = dataclasses.replace(self.verdicts[1], base=before.base, before=before, learned=self.learned[0])
        return describe(with_law, Settings(profiles=False, estimator=False), Timings())


@pytest.fixture(scope="module")
def exchange() -> Course:
    """What ``diagnose`` makes of two chambers that exchange air."""
    seen: dict[str, list[Any]] = {"_verdict": [], "search": []}
    with pytest.MonkeyPatch.context() as patch:
        for module, name in ((pipeline, "_verdict"), (learned_law, "search")):
            patch.setattr(module, name, _noting(getattr(module, name), seen[name]))
        found = diagnose(recorded(EXCHANGE), rig(), profiles=False, estimator=False)
    assert isinstance(found, DiagnoseResult)
    return Course(found, seen["_verdict"], seen["search"])


def _noting(function: Any, results: list[Any]) -> Any:
    def noted(*args: Any, **options: Any) -> Any:
        results.append(function(*args, **options))
        return results[-1]

    return noted


@pytest.mark.thorough(33)
def test_place_and_argument_of_a_law_that_is_in_no_catalogue_are_found(exchange: Course) -> None:
    assert exchange.learned[0].places[0].name == "exchange"
    assert [effect.name for effect in exchange.result.effects] == ["learned"]
    law = exchange.result.effects[0].law
    assert law is not None
    assert (law.place, law.argument, law.operator) == ("exchange", "pressure_difference", "none")
    assert law.value(1e5) == pytest.approx(1.2e-6, rel=0.1)


@pytest.mark.thorough(1)
def test_errors_are_those_before_the_law_and_those_with_it(exchange: Course) -> None:
    before, after = (describe(one, Settings(estimator=False), Timings()) for one in exchange.verdicts)
    assert exchange.result.errors.as_configured == before.errors.as_configured
    assert exchange.result.errors.recalibrated == before.errors.recalibrated
    assert exchange.result.errors.extended == after.errors.extended
    angle, extended = exchange.result.errors.recalibrated.angle, exchange.result.errors.extended.angle
    assert angle is not None
    assert extended is not None
    assert extended.rmse < 0.2 * angle.rmse
    assert exchange.result.next_rig == "rig_extended.yaml"


@pytest.mark.thorough(1)
def test_a_report_has_place_argument_and_table_of_a_law(exchange: Course) -> None:
    report = exchange.result.to_json()
    assert report["verdict"] == "effect"
    entry = report["effects"][0].to_json()
    assert (entry["name"], entry["place"], entry["arguments"]) == ("learned", "exchange", ["pressure_difference"])
    table = entry["law"]
    assert len(table["nodes"]) == len(table["values"]) == len(table["std"])
    assert table["unit"] == "kg/s"
    assert entry["like"] == ["leak"]
    assert all(law in report["sentence"] for law in entry["alternatives"])
    assert "sits in the flow from muscle 1 to muscle 2 and depends on P1 - P2" in report["sentence"]
    assert "errors on held-out data fall from" in report["sentence"]
    page = html.render(exchange.result.document())
    assert "Found: a law of the flow from muscle 1 to muscle 2" in page
    assert "no effect explains it" not in page
    assert "Learned law: the flow from muscle 1 to muscle 2 depends on P1 - P2" in page


@pytest.mark.thorough(1)
def test_an_effect_that_leaves_a_clear_excess_does_not_end_the_search(exchange: Course) -> None:
    assert leaves_excess(exchange.like("thermal"))
    assert not leaves_excess(exchange.verdicts[1])
    (part,) = exchange.like("leak").parts
    begins = dataclasses.replace(part, effects=(dataclasses.replace(part.effects[0], onset_s=10.0),))
    assert not leaves_excess(dataclasses.replace(exchange.verdicts[0], parts=(begins,)))


@pytest.mark.thorough(1)
def test_a_torque_that_comes_and_goes_alone_may_be_a_law(exchange: Course) -> None:
    pushed = exchange.like("external_torque")
    assert leaves_excess(pushed)
    assert not leaves_excess(exchange.like("external_torque", "leak"))
    assert is_better(pushed, exchange.verdicts[1].model, [EXCHANGE])
    assert not is_better(pushed, pushed.base, [EXCHANGE])


def test_a_law_that_takes_less_than_a_tenth_of_a_channels_error_is_not_added(
    exchange: Course, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, model = exchange.verdicts[0], exchange.verdicts[1].model
    assert law_evidence.largest_share_of_a_channel(before.base, model) > 0.8
    assert law_evidence.largest_share_of_a_channel(before.base, before.base) == 0.0
    assert is_better(before, model, [EXCHANGE])
    monkeypatch.setattr(law_evidence, "largest_share_of_a_channel", lambda *_models: 0.05)
    assert not is_better(before, model, [EXCHANGE])


@pytest.mark.thorough(1)
def test_a_law_by_time_has_to_be_the_explanation(exchange: Course, monkeypatch: pytest.MonkeyPatch) -> None:
    before, model = exchange.verdicts[0], exchange.verdicts[1].model
    by_time = dataclasses.replace(EXCHANGE, argument="time")
    assert is_better(before, model, [by_time])
    monkeypatch.setattr(law_evidence, "share_of_all", lambda *_models: 0.36)
    assert is_better(before, model, [EXCHANGE]) and not is_better(before, model, [by_time])


def test_a_law_is_said_by_its_place_and_argument() -> None:
    effect = FoundEffect("learned", None, {}, 20.0, 0.6, law=EXCHANGE)
    said = "the flow from muscle 1 to muscle 2 depends on P1 - P2, seen from -300 kPa to 300 kPa (a learned law)"
    assert sentences.in_words(effect) == said


def test_a_law_of_a_rate_is_none_at_rest() -> None:
    # At rest there is nothing to damp, so no constant stands for a force of the base.
    assert LawForm("force_1", "length_rate").law(np.array([-1.0, 1.0]), np.array([2.0, 6.0])).value(0.0) == 0.0


@pytest.mark.thorough(1)
@pytest.mark.parametrize(("name", "names"), [("leak", ["leak", "learned"]), ("thermal", ["learned"])])
def test_an_effect_that_acts_where_the_law_does_names_it(exchange: Course, name: str, names: Sequence[str]) -> None:
    found = exchange.described(exchange.like(name))
    assert [effect.name for effect in found.effects] == names
    assert found.effects[-1].delta_bic > 40.0
    assert not any(item.taken and item.effect == "thermal" for item in found.ranking)
    said = "leak, in another form than the catalogue's law" if name == "leak" else "alone, thermal explained most"
    assert said in found.sentence


@pytest.mark.thorough(1)
def test_a_law_has_the_name_of_one_effect(exchange: Course, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(law_findings, "like", lambda *_args: ("valve_offset", "leak"))
    found = exchange.described(exchange.like("valve_offset", "leak"))
    assert [effect.name for effect in found.effects] == ["leak", "learned"]
    assert ": leak, in another form" in found.sentence


@pytest.mark.thorough(1)
def test_a_law_that_does_not_hold_on_held_out_data_is_not_added(
    exchange: Course, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(learned_law, "search", lambda *_args: exchange.learned[0])
    first = exchange.verdicts[0]
    found = learned_law.with_laws(lambda *_args: first, [recorded()], [], rig(), print, first)
    assert (found.verdict, found.effects, found.laws) == ("unexplained", (), ())
    assert "does not hold on data that no fit used" in describe(found, Settings(estimator=False), Timings()).sentence


@pytest.mark.thorough(1)
def test_a_law_that_cannot_be_tried_is_said(exchange: Course, monkeypatch: pytest.MonkeyPatch) -> None:
    first = exchange.verdicts[0]

    def verdict(*_args: Any) -> JudgedJoint:
        raise BadInput("too short with it")

    monkeypatch.setattr(learned_law, "search", lambda *_: exchange.learned[0])
    found = learned_law.with_laws(verdict, [recorded()], [], rig(), print, first)
    assert "A law was learned" in found.why and "cannot be tried: too short with it." in found.why
    assert found.verdict == first.verdict == "unexplained"


@pytest.mark.thorough(1)
def test_beside_a_law_an_effect_is_measured_by_what_was_there_before_it(
    exchange: Course, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(learned_law, "search", lambda *_args: exchange.learned[0])
    before: list[Any] = []

    def verdict(_fitted: Any, _kept: Any, _rig: Any, first: Any) -> JudgedJoint:
        before.append(first)
        return exchange.verdicts[1]

    learned_law.with_laws(verdict, [recorded()], [], rig(), print, exchange.verdicts[0])
    assert before == [exchange.verdicts[0].base]


@pytest.mark.thorough(2)
def test_where_two_laws_do_not_hold_the_better_one_is_tried(exchange: Course, monkeypatch: pytest.MonkeyPatch) -> None:
    best = exchange.learned[0].found
    assert best is not None
    absurd = dataclasses.replace(COGGING, values=tuple(20.0 * value for value in COGGING.values))
    two = dataclasses.replace(best, laws=(*best.laws, absurd), groups=(*best.groups, LawForm.of(absurd)))
    learned = dataclasses.replace(exchange.learned[0], found=two, single=best)
    monkeypatch.setattr(learned_law, "search", lambda *_args: learned)
    asked: list[Rig] = []

    def verdict(_fitted: Any, _kept: Any, own: Rig, _first: Any) -> JudgedJoint:
        asked.append(own)
        return exchange.verdicts[1]

    found = learned_law.with_laws(verdict, [recorded()], [], rig(), print, exchange.verdicts[0])
    assert [laws_of(own)[1].place for own in asked] == ["exchange"] and all(len(laws_of(own)) == 1 for own in asked)
    assert found.laws == best.laws


@pytest.mark.thorough(1)
def test_a_second_law_is_looked_for_beside_the_first(exchange: Course, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Model] = []

    def looked_for(model: Model, _progress: Any) -> LawSearch:
        asked.append(model)
        return exchange.learned[0] if len(asked) == 1 else LawSearch(())

    monkeypatch.setattr(learned_law, "search", looked_for)
    monkeypatch.setattr(learned_law, "leaves_excess", lambda _found: True)
    first, after = exchange.verdicts

    def found() -> JudgedJoint:
        return learned_law.with_laws(lambda *_args: after, [recorded()], [], rig(), print, first)

    # What leaves no more than an imperfect table does is not followed by another one.
    assert [law.place for law in found().laws] == ["exchange"] and asked == [first.base]
    monkeypatch.setattr(learned_law, "share_of_all", lambda *_models: 0.5)
    asked.clear()
    assert [law.place for law in found().laws] == ["exchange"]
    assert asked == [first.base, after.base]


@pytest.mark.thorough(5)
def test_a_second_law_is_found_beside_the_first() -> None:
    law = learned_from(recorded(EXCHANGE, COGGING, duration=24.0), with_law(rig(), EXCHANGE)).law
    assert law is not None
    assert (law.place, law.argument) == ("torque", "angle")
    assert law.value(0.0) - law.value(0.1) == pytest.approx(0.1, rel=0.2)


@pytest.mark.thorough(12)
@pytest.mark.parametrize("kept", [law_search._MOST_KEPT, 0])
def test_two_laws_are_found_at_once(kept: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Alone, each would take on what the other lacks, and neither would hold; also where no columns are kept."""
    monkeypatch.setattr(law_search, "_MOST_KEPT", kept)
    found = learned_from(recorded(EXCHANGE, COGGING), rig())
    one, other = sorted(found.laws, key=lambda law: law.place)
    assert (one.place, one.argument) == ("exchange", "pressure_difference")
    assert (other.place, other.argument) == ("torque", "angle")
    assert one.value(1e5) == pytest.approx(1.2e-6, rel=0.2)
    assert other.value(0.0) - other.value(0.1) == pytest.approx(0.1, rel=0.2)
    in_rig = found.in_rig(rig())
    assert [law.place for law in laws_of(in_rig).values()] == [law.place for law in found.laws]


@pytest.mark.thorough(10)
def test_a_law_is_no_second_one_where_one_is_missing() -> None:
    assert [law.place for law in learned_from(recorded(EXCHANGE), rig()).laws] == ["exchange"]


@pytest.mark.slow(6)
def test_a_law_is_found_with_regulators_and_without_a_torque_meter() -> None:
    known = load_rig("shin2022_regulators", regulators=True).replaced(sample_period=0.004)
    true = simulate(with_law(known, ENGAGING), duration=24.0, mismatch=0.01, seed=8)
    found = learned_from(dataclasses.replace(true, torque=None), known).law
    assert found is not None
    assert (found.place, found.argument) == ("torque", "angle")
    assert found.value(0.05) - found.value(0.25) == pytest.approx(ENGAGING.value(0.05) - ENGAGING.value(0.25), rel=0.3)


@pytest.mark.thorough(5)
def test_recordings_are_corrected_by_the_error_of_an_encoder() -> None:
    true = recorded(duration=24.0)
    assert true.angle is not None
    wrong = 4e-3 * np.interp(true.angle, COGGING.nodes, np.sign(COGGING.values))
    read = dataclasses.replace(true, angle=true.angle + wrong)
    law = learned_from(read, rig()).law
    assert law is not None
    assert (law.place, law.argument) == ("encoder", "angle")
    corrected = learned_law.corrected([read], [law])[0].angle
    assert corrected is not None
    # In the part that it was learned from: later the joint turns further.
    seen = slice(2 * len(true) // 3)
    assert np.std((corrected - true.angle)[seen]) < 0.2 * np.std(wrong[seen])


def test_an_error_of_readings_is_what_the_model_shows_wrongly() -> None:
    """What was measured stays: a law that shrank it would leave less of any error."""
    trial = make_trial(recorded(duration=12.0), rig(), "free", 0.0, "free")
    right = ValveDriven(rig(), trial, 2 * len(trial) // 3)
    point = right.origin
    model = Model((right,), (refit(right, point, rounds=0),))
    (wrong,) = law_evidence.with_it(model, Law("encoder", (-0.1, 0.1), (0.01, 0.03), None, "angle")).experiments
    assert wrong.trial is trial
    shown, misread = right.simulated(point), wrong.simulated(point)
    assert misread[:, 0] - shown[:, 0] == pytest.approx(np.interp(shown[:, 0], (-0.1, 0.1), (0.01, 0.03)))
    assert np.array_equal(misread[:, 1:], shown[:, 1:])


def test_what_is_as_likely_by_all_evidence_is_said_beside_the_best_law(monkeypatch: pytest.MonkeyPatch) -> None:
    """To first order one leads clearly; fitted to the recordings, what was held out makes the other as likely."""
    places = {
        "passage_1": ("open_rate", 60.0, 15.0),
        "command_1": ("voltage", 40.0, 34.0),
        "flow_1": ("none", 50.0, 0.0),
    }
    laws = [
        FittedLaws(
            (LawForm(at, argument),), (Law(at.split("_")[0], (0.0, 1.0), (0.0, 1.0), 1, argument),), (0.0,), gain
        )
        for at, (argument, gain, _) in places.items()
    ]

    class Part:
        """A part in which these are found."""

        has_significant_excess = True

        def every_law(self) -> list[FittedLaws]:
            return sorted(laws, key=lambda one: -one.gain)

        def refined(self, one: FittedLaws) -> FittedLaws:
            return dataclasses.replace(one, held_out=places[one.group.place][2])

        def takes_two(self, _found: Any, best: FittedLaws) -> FittedLaws:
            return best

    monkeypatch.setattr(law_search, "parts", lambda _model: [Part()])
    monkeypatch.setattr(law_search, "_ModelPart", lambda part: part)
    model = recalibrated_on(recorded(duration=12.0), rig())
    found = search(model, lambda text: None)
    assert [law.place for law in found.laws] == ["passage"]
    assert [law.place for law in found.alternatives] == ["command"]


def test_no_law_is_added_where_nothing_is_wrong() -> None:
    nothing = learned_from(recorded(), rig())
    assert nothing.law is None


@pytest.mark.slow(6)
def test_a_law_of_the_air_is_found_without_a_measured_angle() -> None:
    found = learned_from(dataclasses.replace(recorded(EXCHANGE, duration=24.0), angle=None), rig())
    assert found.law is not None
    # Without the angle little tells it from a flow into both muscles by their lengths: then both are said.
    as_good = {(law.at, law.argument) for law in (found.law, *found.alternatives)}
    assert ("exchange", "pressure_difference") in as_good
