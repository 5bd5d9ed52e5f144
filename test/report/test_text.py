"""JSON that every reader accepts, and tables that line up."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pam_antagonist.report.document import number, percent
from pam_antagonist.strict_json import dumps, plain, write_json


def _refuse(text: str) -> Any:
    raise AssertionError(f"{text} is not JSON")


def test_what_is_not_finite_becomes_null(tmp_path: Path) -> None:
    value = {
        "nan": float("nan"),
        "list": [math.inf, np.float64(1.5), -np.inf],
        "array": np.array([1.0, np.nan]),
        "scalars": [np.int32(3), np.bool_(True), np.float32(0.5), None, "µ", True, 2**60],
        1: (),
    }
    write_json(tmp_path / "x.json", value)
    text = (tmp_path / "x.json").read_text(encoding="utf-8")
    assert json.loads(text, parse_constant=_refuse) == {
        "nan": None,
        "list": [None, 1.5, None],
        "array": [1.0, None],
        "scalars": [3, True, 0.5, None, "µ", True, 2**60],
        "1": [],
    }


@dataclass(frozen=True)
class Errors:
    """A dataclass with the keys of its fields."""

    rmse: float
    parts: tuple[Any, ...] = ()


class Renamed(Errors):
    """One that names its own keys."""

    def to_json(self) -> dict[str, float]:
        return {"rmse_deg": self.rmse}


def test_a_dataclass_becomes_an_object() -> None:
    value = plain({"all": Errors(math.nan, (Renamed(1.0), Errors(2.0)))})
    assert value == {"all": {"rmse": None, "parts": [{"rmse_deg": 1.0}, {"rmse": 2.0, "parts": []}]}}


def test_what_has_no_form_is_refused() -> None:
    with pytest.raises(TypeError, match="complex"):
        dumps({"z": 1j})


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (0.0, 3, "0"),
        (0.32534, 3, "0.325"),
        (0.32534, 2, "0.33"),
        (12.3456, 3, "12.3"),
        (1234.5, 3, "1234"),
        (-0.0805, 2, "-0.081"),
        (3.2e-9, 3, "3.20e-09"),
        (None, 3, "–"),
        (float("nan"), 3, "–"),
    ],
)
def test_numbers_have_the_digits_that_mean_something(value: float | None, digits: int, text: str) -> None:
    assert number(value, digits) == text


def test_a_share_is_never_minus_nothing() -> None:
    assert [percent(value) for value in (-1e-5, 0.1234, -0.02, None)] == ["0.0 %", "12.3 %", "-2.0 %", "–"]
