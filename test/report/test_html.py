"""The page holds all it needs, and nothing in it loads anything from elsewhere."""

from __future__ import annotations

import base64
import gzip
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from pam_antagonist.report import figure, html, replay_figures
from pam_antagonist.report.document import (
    Columns,
    Definitions,
    Document,
    Findings,
    Section,
    Statement,
    Table,
    Text,
    Tile,
    Tiles,
)
from pam_antagonist.report.figure import TIME, Axis, Band, Bars, Figure, Line, Panel, Points, Reference, Region
from pam_antagonist.report.html import render


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

    def unpacked(self, name: str) -> str:
        """What the page's script finds in an element."""
        return gzip.decompress(base64.b64decode(self.texts[name])).decode()


def _time(count: int) -> np.ndarray:
    return replay_figures.seconds(np.arange(count) * 1_000_000, 0)


def _figure(values: np.ndarray, title: str = "Angle") -> Figure:
    line = Line("UKF", _time(len(values)), values, "#d55e00")
    return Figure(title, "About", (Panel(TIME, Axis("Angle [°]"), (line,)),), "one")


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
    read = Reader(render(Document("k", "t", (_figure(np.arange(10.0)), _figure(np.arange(10.0))))))
    assert sum(found.get("id") == "plotly" for _, found in read.tags) == 1
    assert len(re.findall(r"plotly\.js v\d", read.unpacked("plotly"))) == 1
    assert len(re.findall(r"plotly\.js v\d", "".join(read.texts.values()))) == 0
    without = render(Document("k", "t", (Text("nothing to draw"),)))
    assert len(without) < 20_000
    assert "<script" not in without


def test_figure_data_can_be_read_back_and_cannot_end_the_script() -> None:
    line = Line("</script><b>", np.arange(2.0), np.array([0.5, np.nan]), "#000000")
    panel = Panel(Axis(), Axis("<i> [V]"), (line,))
    figure = Figure("</script><b>", "About & <i>", (panel,), 'a"b')
    read = Reader(render(Document("k", "t", (figure,))))
    plot = json.loads(read.unpacked("figure-1-data"))
    assert plot["data"][0]["y"] == [0.5, None]
    # The library would obey HTML.
    assert plot["data"][0]["name"] == "&lt;/script&gt;&lt;b&gt;"
    assert plot["layout"]["yaxis"]["title"]["text"] == "&lt;i&gt; [V]"
    assert not any(tag in ("b", "i") for tag, _ in read.tags)


def test_text_is_escaped_everywhere() -> None:
    bad = "<script>alert(1)</script>"
    document = Document(
        bad,
        bad,
        (
            Text(bad),
            Findings((Statement("warn", bad),)),
            Tiles((Tile(bad, bad, bad),)),
            Columns(Text(bad), Table((bad, bad), ((bad, bad),), bad)),
            Section(bad, (Definitions(((bad, bad),)),), folded=True),
        ),
        bad,
    )
    assert not any(tag == "script" for tag, _ in Reader(render(document)).tags)


def test_a_trace_has_few_points_and_keeps_its_spike() -> None:
    values = np.sin(np.arange(60_000) / 1000.0)
    values[12_345] = 7.0
    trace = html.plot(_figure(values))["data"][0]
    assert len(trace["x"]) == len(trace["y"]) <= html.LIMIT
    assert max(trace["y"]) == 7.0
    assert trace["x"][int(np.argmax(trace["y"]))] == pytest.approx(12.345)


def test_a_pause_in_the_recording_is_a_gap_in_the_line_and_in_the_band() -> None:
    stamps = np.concatenate((np.arange(50), np.arange(200, 250))) * 1_000_000
    x, ones = replay_figures.seconds(stamps, 0), np.ones(100)
    parts = (Line("a", x, ones, "#000"), Band("b", x, -ones, ones, "#111"))
    line, band = html.plot(Figure("t", "", (Panel(TIME, Axis("x [V]"), parts),)))["data"]
    assert line["y"].count(None) == 1
    assert band["y"].count(None) == 2  # one closed outline for each stretch
    assert max(band["x"][: band["x"].index(None)]) == pytest.approx(0.049)


def test_a_strip_shows_the_categories_that_occur() -> None:
    panel = replay_figures.strip(("1: a", "2: b", "3: c"), np.array([0, 0, 2, 2]), _time(4), columns=2)
    plot = html.plot(Figure("t", "", (panel,)))
    assert plot["layout"]["yaxis"]["ticktext"] == ["1", "3"]
    assert plot["data"][0]["z"] == [[1.0, None], [None, 1.0]]
    assert [row[0] for row in plot["data"][0]["text"]] == ["1: a", "3: c"]
    assert plot["data"][0]["hovertemplate"] == "%{text}<br>%{x} s: %{z:.0%} of the time<extra></extra>"


def test_every_kind_of_series_has_its_trace_or_shape() -> None:
    x = np.array([1.0, 2.0])
    parts = (
        Line("line", x, x, "#000000", "dash"),
        Points("points", x, x, "#000000", hollow=True, half_width=0.1 * x),
        Bars("bars", x, x, "#000000"),
        Reference(1.5, "level"),
        Reference(1.0, "begin", vertical=True),
        Region(1.0, 2.0),
    )
    plot = html.plot(Figure("t", "", (Panel(Axis("x [m]"), Axis("y [m]", log=True), parts),)))
    line, points, bars = plot["data"]
    assert line["line"]["dash"] == "dash" and line["mode"] == "lines"
    assert points["marker"]["symbol"] == "circle-open" and points["error_x"]["array"] == [0.1, 0.2]
    assert bars["type"] == "bar"
    level, vertical, region = plot["layout"]["shapes"]
    assert (level["xref"], level["y0"], level["y1"]) == ("x domain", 1.5, 1.5)
    assert (vertical["yref"], vertical["x0"], vertical["x1"]) == ("y domain", 1.0, 1.0)
    assert (region["type"], region["x0"], region["x1"], region["layer"]) == ("rect", 1.0, 2.0, "below")
    # plotly gives logarithms for texts on such an axis, but not for lines.
    above, beside = plot["layout"]["annotations"]
    assert above["y"] == pytest.approx(np.log10(1.5)) and (beside["x"], beside["yref"]) == (1.0, "y domain")


def test_every_colour_of_the_light_theme_that_a_dark_page_would_hide_has_a_dark_one() -> None:
    def brightness(color: str) -> float:
        parts = [int(color[k : k + 2], 16) for k in (1, 3, 5)]
        return float(np.dot(parts, (0.3, 0.59, 0.11))) / 255.0

    named = [value for value in vars(figure).values() if isinstance(value, str) and value.startswith("#")]
    background = brightness(figure.DARK[figure.PAPER])
    for color in {*named, *figure.PALETTE} - {figure.PAPER, figure.PALE, figure.GRID, figure.EDGE}:
        assert brightness(figure.DARK.get(color, color)) - background > 0.2, color
