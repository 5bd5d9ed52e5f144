"""The page holds all it needs, and nothing in it loads anything from elsewhere."""

from __future__ import annotations

import builtins
import json
import re
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.report import decimate, figures
from pam_antagonist.report.document import Columns, Definitions, Document, Finding, Findings, Section, Text, Tile, Tiles
from pam_antagonist.report.html import Figure, render
from pam_antagonist.report.table import Table


class Reader(HTMLParser):
    """Collects what a browser would load, and the elements."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: dict[str, str] = {}
        self._open = ""
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.tags.append((tag, found))
        self.loads += [str(found[key]) for key in ("src", "href", "srcset", "data", "action") if key in found]
        self._open = str(found.get("id") or tag)

    def handle_data(self, data: str) -> None:
        self.texts[self._open] = self.texts.get(self._open, "") + data


def _clock(count: int) -> figures.Clock:
    return figures.Clock.from_stamps(np.arange(count) * 1_000_000, 0, 1e-3)


def _figure(values: np.ndarray, title: str = "Angle") -> Figure:
    panel = figures.Panel("Angle [°]", [figures.Line("UKF", values, "#d55e00")])
    return Figure(title, "About", figures.stack([panel], _clock(len(values))), "one")


def test_a_page_loads_nothing_from_elsewhere() -> None:
    page = render(Document("Kicker", "Title", (_figure(np.arange(10.0)), _figure(np.arange(10.0)))))
    read = Reader(page)
    assert [load for load in read.loads if not load.startswith("#")] == []
    assert "@import" not in page.split("<script>")[0]
    policies = [found for tag, found in read.tags if tag == "meta" and "http-equiv" in found]
    assert [policy["http-equiv"] for policy in policies] == ["Content-Security-Policy"]
    # Nothing but what stands in the file itself, whatever the library in it might like to fetch.
    assert str(policies[0]["content"]).startswith("default-src 'none'")
    assert "http" not in str(policies[0]["content"])


def test_the_library_is_there_once_and_only_for_figures() -> None:
    with_two = render(Document("k", "t", (_figure(np.arange(10.0)), _figure(np.arange(10.0)))))
    assert len(re.findall(r"plotly\.js v\d", with_two)) == 1
    without = render(Document("k", "t", (Text("nothing to draw"),)))
    assert len(without) < 20_000
    assert "<script" not in without


def test_figure_data_can_be_read_back_and_cannot_end_the_script() -> None:
    figure = Figure("</script><b>", "About & <i>", {"data": [{"name": "</script>"}], "layout": {"height": 99}}, 'a"b')
    read = Reader(render(Document("k", "t", (figure,))))
    assert json.loads(read.texts["figure-1-data"])["data"] == [{"name": "</script>"}]
    assert not any(tag in ("b", "i") for tag, _ in read.tags)


def test_text_is_escaped_everywhere() -> None:
    bad = "<script>alert(1)</script>"
    document = Document(
        bad,
        bad,
        (
            Text(bad),
            Findings((Finding("warn", bad),)),
            Tiles((Tile(bad, bad, bad),)),
            Columns(Text(bad), Table((bad, bad), ((bad, bad),), bad)),
            Section(bad, (Definitions(((bad, bad),)),), folded=True),
        ),
        bad,
    )
    assert not any(tag == "script" for tag, _ in Reader(render(document)).tags)


def test_findings_are_told_by_sign_and_not_by_colour_alone() -> None:
    page = render(Document("k", "t", (Findings((Finding("good", "a"), Finding("warn", "b"), Finding("note", "c"))),)))
    assert [sign in page for sign in (">✓<", ">!<", ">i<")] == [True] * 3
    assert [f'aria-label="{word}"' in page for word in ("good", "attention", "note")] == [True] * 3


def test_without_plotly_a_page_with_figures_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *arguments: Any, **keywords: Any) -> Any:
        if name.startswith("plotly"):
            raise ImportError(name)
        return real(name, *arguments, **keywords)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(BadInput, match="--no-figures"):
        render(Document("k", "t", (_figure(np.arange(10.0)),)))


def test_a_trace_has_few_points_and_keeps_its_spike() -> None:
    values = np.sin(np.arange(60_000) / 1000.0)
    values[12_345] = 7.0
    trace = _figure(values).plot["data"][0]
    assert len(trace["x"]) == len(trace["y"]) <= decimate.LIMIT
    assert max(trace["y"]) == 7.0
    assert trace["x"][int(np.argmax(trace["y"]))] == pytest.approx(12.345)


def test_a_pause_in_the_recording_is_a_gap_in_the_line_and_in_the_band() -> None:
    stamps = np.concatenate((np.arange(50), np.arange(200, 250))) * 1_000_000
    clock = figures.Clock.from_stamps(stamps, 0, 1e-3)
    ones = np.ones(100)
    parts = [figures.Line("a", ones, "#000"), figures.Band("b", -ones, ones, "#111")]
    line, band = figures.stack([figures.Panel("x [V]", parts)], clock)["data"]
    assert np.isnan(line["y"]).sum() == 1
    assert np.isnan(band["y"]).sum() == 2  # one closed outline for each stretch
    first = np.array(band["x"])[: int(np.flatnonzero(np.isnan(band["x"]))[0])]
    assert first.max() == pytest.approx(0.049)


def test_a_moving_mean_by_hand() -> None:
    mean = figures.moving_mean(np.array([1.0, 2.0, np.nan, 6.0]), 3)
    assert mean == pytest.approx([1.5, 1.5, 4.0, 6.0])
    assert np.isnan(figures.moving_mean(np.full(3, np.nan), 1)).all()


def test_a_strip_shows_the_categories_that_occur() -> None:
    plot = figures.strip(("1: a", "2: b", "3: c"), np.array([0, 0, 2, 2]), _clock(4), columns=2)
    assert plot["data"][0]["y"] == ["1", "3"]
    assert plot["data"][0]["z"][0][0] == 1.0
    assert np.isnan(plot["data"][0]["z"][0][1])
