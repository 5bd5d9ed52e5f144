"""Pictures of figures: what stands at which pixel."""

from __future__ import annotations

import io
import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.report.figure import (
    TIME,
    Axis,
    Band,
    Bars,
    Figure,
    Line,
    Panel,
    Points,
    Reference,
    Region,
    Series,
)
from validation.pictures import SHARPNESS, WIDTH, made_here, picture

Pixels = NDArray[np.int64]
RED, GREEN, BLUE = "#d01010", "#10a010", "#1010d0"
LEFT, RIGHT, TOP, BOTTOM = 66, 14, 34, 44
"""Margins of time series [px]."""


def pixels(figure: Figure) -> Pixels:
    """(rows, columns, 3), from above."""
    image = pytest.importorskip("PIL.Image").open(io.BytesIO(picture(figure)))
    return np.asarray(image.convert("RGB"), dtype=np.int64)


def found(image: Pixels, color: str, tolerance: int = 30) -> NDArray[np.bool_]:
    """Where a colour is."""
    wanted = np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)])
    return np.abs(image - wanted).max(axis=2) <= tolerance


def column(share: float) -> int:
    """Of a place on the time axis, 0 at its left end and 1 at its right."""
    return round((LEFT + share * (WIDTH - LEFT - RIGHT)) * SHARPNESS)


def row(share: float, height: int) -> int:
    """Of a place on the upper panel of some height, 0 at its lower end and 1 at its upper."""
    return round((TOP + (1.0 - share) * height) * SHARPNESS)


def time(count: int) -> NDArray[np.float64]:
    return np.linspace(0.0, 1.0, count)


def line(name: str, y: NDArray[np.float64], color: str, **style: Any) -> Line:
    return Line(name, time(len(y)), y, color, **style)


def band(name: str, lower: NDArray[np.float64], upper: NDArray[np.float64], color: str, quiet: bool = False) -> Band:
    return Band(name, time(len(lower)), lower, upper, color, quiet)


def alone(*panels: Panel, beside: bool = False) -> Figure:
    return Figure("title", "about", panels, "", beside)


def series(*parts: Series, bounds: tuple[float, float] | None = (0.0, 1.0), log: bool = False) -> Figure:
    return alone(Panel(TIME, Axis("y [V]", log=log, bounds=bounds), parts, 200))


def level(value: float, count: int = 101) -> NDArray[np.float64]:
    return np.full(count, value)


def test_a_line_lies_where_its_values_are() -> None:
    image = pixels(series(line("a", level(0.25), RED, quiet=True)))
    red = found(image, RED)
    assert set(np.flatnonzero(red.any(axis=1))) <= set(range(row(0.25, 200) - 3, row(0.25, 200) + 4))
    columns = np.flatnonzero(red.any(axis=0))
    assert columns[0] == pytest.approx(column(0.0), abs=3)
    assert columns[-1] == pytest.approx(column(1.0), abs=3)
    assert len(columns) == columns[-1] - columns[0] + 1


def test_a_gap_is_left_white() -> None:
    values = level(0.5)
    values[40:61] = np.nan
    image = pixels(series(line("a", values, RED, quiet=True)))
    red = found(image, RED).any(axis=0)
    assert not red[column(0.41) : column(0.59)].any()
    assert red[column(0.05) : column(0.38)].all() and red[column(0.62) : column(0.95)].all()


def test_a_level_has_a_line_and_a_label_unless_it_is_out_of_range() -> None:
    nothing = line("a", level(np.nan), RED, quiet=True)
    image = pixels(series(nothing, Reference(0.5, "limit", GREEN)))
    green = found(image, GREEN, 60)
    on_line = green[row(0.5, 200) - 1 : row(0.5, 200) + 1]
    assert 0.4 < on_line.any(axis=0)[column(0.0) : column(1.0)].mean() < 0.6, "dashed, over the whole width"
    label = green[row(0.6, 200) : row(0.5, 200) - 3]
    assert label[:, column(0.9) :].any() and not label[:, : column(0.9)].any()
    assert not found(pixels(series(nothing, Reference(1.05, "limit", GREEN))), GREEN, 60).any()
    free = pixels(series(nothing, Reference(2.0, "limit", GREEN), bounds=None))
    assert found(free, GREEN, 60).any(), "where nothing bounds it, the axis reaches to its level lines"


def test_a_long_legend_makes_the_picture_taller_and_hides_nothing() -> None:
    colors = [f"#{20 * k:02x}40a0" for k in range(12)]
    short, long = (
        pixels(series(*(line(f"{word} {k}", level(0.5), color) for k, color in enumerate(colors))))
        for word in ("a", "a name of some length")
    )
    assert short.shape[0] == round((TOP + 200 + BOTTOM) * SHARPNESS)
    taller = long.shape[0] - short.shape[0]
    assert taller > 30
    margin = long[: taller + row(1.0, 200) - 2]
    for color in colors:
        assert found(margin, color, 12).any(), color
    assert (long[:, -4:] == 255).all(), "nothing runs out of the picture"


def test_bars_stand_beside_each_other_on_zero() -> None:
    x, bounds = np.array([1.0, 2.0]), (Reference(0.2), Reference(-0.2))
    bars = (Bars("one", x, np.array([0.5, 0.5]), RED), Bars("two", x, np.array([-0.5, 0.5]), BLUE))
    image = pixels(alone(Panel(Axis("Lag [ms]"), Axis("Correlation [-]"), (*bars, *bounds), 182)))
    area = image[row(1.0, 180) + 2 :]
    red, blue = found(area, RED), found(area, BLUE)
    height = 260 - TOP - BOTTOM
    for mask, start in ((red, 0.25 - 0.65 / 4), (blue, 0.25)):
        first = np.flatnonzero(mask[:, : column(0.5)].any(axis=0))
        assert first[0] == pytest.approx(column(start), abs=3)
        assert np.ptp(first) == pytest.approx((WIDTH - LEFT - RIGHT) * SHARPNESS * 0.65 / 4, abs=4)
    zero = row(0.5, height) - row(1.0, 180) - 2
    assert not red[zero + 3 :].any()
    assert blue[zero + 3 :, : column(0.5)].any() and not blue[: zero - 3, : column(0.5)].any()
    # The bounds at -0.2 and 0.2 on an axis from -0.555 to 0.555.
    gap = np.flatnonzero(found(area, "#8a8f98", 40)[: zero + 50, column(0.45) : column(0.55)].any(axis=1))
    assert {round(abs(k - zero) / (height * SHARPNESS), 1) for k in gap} >= {0.2}


def test_a_region_is_shaded_behind_everything_and_does_not_widen_the_axis() -> None:
    image = pixels(
        series(Region(0.5, 2.0, "rgba(16, 16, 208, 0.5)"), line("a", level(0.5), RED, width=3.0, quiet=True))
    )
    shaded, red = found(image, "#8787e7", 12), found(image, RED)
    assert shaded[row(0.9, 200) : row(0.7, 200), column(0.52) : column(0.98)].mean() > 0.85, "all but the grid"
    assert not shaded[:, : column(0.48)].any()
    assert red.any(axis=0)[column(0.02) : column(0.98)].all()


GOOD = series(line("a", level(0.5), RED), Reference(0.5, "limit"))
PANEL = GOOD.panels[0]
UNKNOWN: dict[str, Panel] = {
    "pie": replace(PANEL, series=("pie",)),  # type: ignore[arg-type]
    "wavy": replace(PANEL, series=(line("a", level(0.5), RED, dash="wavy"),)),
    "reddish": replace(PANEL, series=(line("a", level(0.5), "reddish"),)),
    "bluish": replace(PANEL, series=(Points("a", level(0.5), level(0.5), "bluish"),)),
    "greenish": replace(PANEL, series=(Reference(0.5, "limit", "greenish"),)),
    "letters": replace(PANEL, y=Axis("\u6f22 [V]")),
}


@pytest.mark.parametrize("word", UNKNOWN)
def test_what_a_picture_cannot_show_is_refused(word: str) -> None:
    picture(GOOD)
    with pytest.raises(BadInput, match="str" if word == "pie" else word) as caught:
        picture(alone(UNKNOWN[word]))
    assert "expected" in str(caught.value) and "\n" not in str(caught.value)


def test_equal_figures_give_equal_bytes_whatever_the_users_settings() -> None:
    matplotlib = pytest.importorskip("matplotlib")
    figure = series(line("a", level(0.5), RED), band("b", level(0.2), level(0.3), "rgba(0,0,0,0.2)"))
    first = picture(figure)
    with matplotlib.rc_context({"font.size": 30.0, "axes.facecolor": "black", "lines.antialiased": False}):
        assert picture(figure) == first
        assert matplotlib.rcParams["font.size"] == 30.0
    assert picture(series(line("a", level(0.6), RED))) != first


def test_a_picture_is_known_by_its_mark() -> None:
    image = pytest.importorskip("PIL.Image").new("RGB", (8, 8))
    other = io.BytesIO()
    image.save(other, "png")
    assert made_here(picture(series(line("a", level(0.5), RED))))
    assert not made_here(other.getvalue())
    assert not made_here(b"tEXtSoftware\0pam_antagonist")


def test_nodes_never_load_what_draws_and_pictures_open_no_window() -> None:
    code = (
        "import sys\n"
        "from pam_antagonist.report import figure\nfrom validation import pictures\n"
        "import importlib.util, validation.paper.command, pam_antagonist.cli.replay\n"
        "if importlib.util.find_spec('rclpy'):\n"
        "    from pam_antagonist.nodes import bridge, controller, estimator, plant, recorder\n"
        "assert not {'matplotlib', 'PIL'} & set(sys.modules)\n"
        "import numpy as np\n"
        "points = figure.Points('a', np.ones(3), np.ones(3), '#000000')\n"
        "panel = figure.Panel(figure.Axis('x'), figure.Axis(), (points,))\n"
        "pictures.picture(figure.Figure('t', '', (panel,)))\n"
        "assert 'matplotlib' in sys.modules and 'matplotlib.pyplot' not in sys.modules\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr


def test_an_interval_is_a_bar_around_its_point_and_rows_have_names() -> None:
    points = Points("p", np.array([0.0]), np.array([0.0]), RED, half_width=np.array([1.0]), quiet=True)
    image = pixels(alone(Panel(Axis("x [%]", bounds=(-2.0, 2.0)), Axis(labels=("gain", "offset")), (points,), 200)))
    red = found(image, RED)
    columns = np.flatnonzero(red.any(axis=0))
    area = (WIDTH - LEFT - RIGHT) * SHARPNESS
    assert np.ptp(columns) == pytest.approx(area / 2, rel=0.02), "from -1 to 1 on an axis from -2 to 2"
    assert np.flatnonzero(red.any(axis=1)).mean() == pytest.approx((10 + 50) * SHARPNESS, abs=3), "the upper row"
