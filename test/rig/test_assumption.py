"""What the intervals of a report rest on: said of a rig that was not identified, and of no other."""

from __future__ import annotations

import pytest

from pam_antagonist.report.document import in_first_lines
from pam_antagonist.rig import load_rig
from pam_antagonist.rig.assumption import assumption

RIG = load_rig("shin2022")


def test_what_a_file_claims_is_called_an_assumption() -> None:
    text = assumption(RIG)
    assert text is not None and text.startswith("Assumption: rig shin2022 was not identified.")
    assert "friction.shaft ± 2.0 %" in text and "muscle_2.force.w2 ± 2.9 %" in text
    assert "NIS tests the pressures only" in text
    assert [block.text for block in in_first_lines(text)] == [text]


@pytest.mark.parametrize(("tuning", "uncertainty"), [("published", RIG.uncertainty), ("default", {})])
def test_a_filter_that_knows_of_no_uncertainty_claims_exact_parameters(tuning: str, uncertainty: dict) -> None:  # type: ignore[type-arg]
    text = assumption(RIG.replaced(uncertainty=uncertainty), tuning)
    assert text is not None and "known exactly" in text and "±" not in text


def test_beside_an_identified_rig_it_is_said_of_which_rig_it_is() -> None:
    text = assumption(RIG, identified=True)
    assert text is not None and "As configured, its 95 % intervals" in text
    assert "intervals of the identified rig follow from the recordings" in text
    assert "As configured" not in (assumption(RIG) or "")


def test_an_identified_rig_assumes_nothing() -> None:
    assert load_rig("sealed_joint").identified
    assert assumption(RIG.replaced(identified="free, locked")) is None
    assert in_first_lines(None) == ()
