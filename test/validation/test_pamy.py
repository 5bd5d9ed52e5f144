"""The page of the measured arm, on a small simulated one with the columns of the real file."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from pam_antagonist.recording.csv_import import read_csv
from pam_antagonist.recording.csv_map import load_map
from validation import pamy
from validation.frame import in_markdown

EPISODES, ROWS, PERIOD = 60, 70, 0.01
FREQUENCY, DAMPING = 40.0, 0.5


def arm(folder: Path) -> Path:
    """A file: the angle follows the pressures as a damped swing with friction, these lag behind their setpoints."""
    rng = np.random.default_rng(4)
    first = np.arange(EPISODES + 1) * ROWS
    time = np.tile(PERIOD * np.arange(ROWS), EPISODES)
    asked = np.stack([0.5 + 0.2 * np.cumsum(rng.standard_normal((EPISODES, ROWS)) * 0.15, axis=1) for _ in "12"])
    step = expm(np.array([[0.0, 1.0], [-(FREQUENCY**2), -2.0 * DAMPING * FREQUENCY]]) * PERIOD)
    setpoints = [np.clip(one, 0.0, 1.0).ravel() for one in asked]
    held = [_held(np.reshape(one, (EPISODES, ROWS)), step).ravel() for one in setpoints]
    # A row of the file holds what was asked for up to it.
    written = [np.column_stack([one[:, :1], one[:, :-1]]).ravel() for one in np.reshape(setpoints, (2, EPISODES, ROWS))]
    angle = np.zeros(EPISODES * ROWS)
    for begin in first[:-1]:
        position = speed = 0.0
        for k in range(begin + 1, begin + ROWS):
            for s in range(10):
                late = (s + 0.5) / 10
                pull = sum(
                    sign * ((1 - late) * one[k - 1] + late * one[k]) for sign, one in zip((1, -1), held, strict=True)
                )
                free = speed + PERIOD / 10 * (90.0 * pull - 60.0 * position - 8.0 * speed)
                speed = math.copysign(max(abs(free) - PERIOD / 10 * 5.0, 0.0), free)
                position += PERIOD / 10 * speed
            angle[k] = position
    number = np.repeat(np.arange(EPISODES), ROWS)
    other = 0.5 + 0.1 * rng.standard_normal((2, EPISODES))[:, number]
    names = "episode,t_s,angle_rad,p1,p2,joint1_p1,joint1_p2,p1_set,p2_set"
    np.savetxt(
        folder / "arm.csv", np.column_stack([number, time, angle, *held, *other, *written]), "%.6f", ",",
        header=names, comments="",
    )  # fmt: skip
    return folder / "arm.csv"


def _held(asked: np.ndarray, step: np.ndarray) -> np.ndarray:
    """A lag of second order behind setpoints (E, R) that hold from each row to the next; exact."""
    state = np.stack([asked[:, 0], np.zeros(len(asked))])
    out = [asked[:, 0]]
    for k in range(1, asked.shape[1]):
        goal = np.stack([asked[:, k - 1], np.zeros(len(asked))])
        state = goal + step @ (state - goal)
        out.append(state[0])
    return np.column_stack(out)


@pytest.mark.thorough(17)
def test_the_page_says_what_was_measured(tmp_path: Path) -> None:
    options = ["--out", str(tmp_path / "out"), "--docs", str(tmp_path / "pamy.md"), "--no-figures"]
    assert pamy.main([str(arm(tmp_path)), *options]) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert [effect["name"] for effect in report["effects"]] == ["friction"]
    assert report["errors_deg"][-1]["later"][0] < 0.2
    assert report["baselines_deg"][0]["later"][0] > 5.0 * report["errors_deg"][-1]["later"][0]
    found = report["regulators"]["values"]
    assert found["effects.regulator_lag.frequency_1"][0] == pytest.approx(FREQUENCY, rel=0.02)
    assert found["effects.regulator_lag.damping"][0] == pytest.approx(DAMPING, rel=0.05)
    text = (tmp_path / "pamy.md").read_text()
    assert (
        "What the model lacks is constant (Coulomb) friction" in text and "| static map of the two pressures |" in text
    )


def test_the_log_book_has_an_entry_for_each_part_of_the_day(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = read_csv(arm(tmp_path), load_map("pamy_joint0"))
    assert pamy.by_parts(recording, 1) is None  # too few episodes for eight parts
    monkeypatch.setattr(pamy, "PARTS", 2)
    book = pamy.by_parts(recording, 1)
    assert book is not None
    spans = [span for entry in book.book.entries for span in entry.recordings]
    assert [Path(span.name).name for span in spans] == ["part_1", "part_2"]
    assert "| joint.stiffness | 1/s² | 2 |" in in_markdown(pamy.of_the_day(book))
