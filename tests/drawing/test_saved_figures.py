"""Figures of any length, with values to their second digit; who owns their files, and equal files for equal figures."""

from pathlib import Path

import matplotlib
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure

from cfid.drawing.numbers import plus_minus
from cfid.drawing.save import save_figure
from cfid.drawing.style import draw_line, figure, name_panel, styled, thinned
from cfid.errors import ConfigError


@styled
def _drawing(slope: float = 1.0) -> Figure:
    page, grid = figure(1, 1, heights_in=(1.0,), title="a line")
    axes = page.add_subplot(grid[0, 0])
    name_panel(axes, "(a)", x="time (s)", y="angle (rad)")
    draw_line(axes, np.arange(9.0), slope * np.arange(9.0))
    axes.fill_between([2.0, 3.0], 4.0, 5.0, hatch="//")
    return page


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_somebody_elses_file_stays_and_nothing_is_written_beside_it(tmp_path: Path, suffix: str) -> None:
    theirs = tmp_path / f"line{suffix}"
    with matplotlib.rc_context():
        _drawing().savefig(theirs)
    content = theirs.read_bytes()
    with pytest.raises(ConfigError) as refused:
        save_figure(_drawing(), tmp_path / "line")
    assert theirs.read_bytes() == content
    assert list(tmp_path.iterdir()) == [theirs]
    assert str(theirs) in str(refused.value)
    assert "`force`" in str(refused.value)
    assert "`out`" in str(refused.value)


@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n", b"\x89PNG\r\n\x1a\n\0\0\0\1tEXt", b"notes about cfid "])
def test_any_other_file_of_that_name_is_somebody_elses(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "line.png").write_bytes(content)
    with pytest.raises(ConfigError):
        save_figure(_drawing(), tmp_path / "line")


def test_equal_figures_make_equal_files_whatever_the_users_settings(tmp_path: Path) -> None:
    expected = [path.read_bytes() for path in save_figure(_drawing(), tmp_path / "one")]
    again = _drawing()
    save_figure(again, tmp_path / "two")
    assert [path.read_bytes() for path in save_figure(again, tmp_path / "two")] == expected
    with matplotlib.rc_context(
        {"font.size": 20, "lines.linewidth": 7, "svg.fonttype": "none", "savefig.bbox": "tight"}
    ):
        assert [path.read_bytes() for path in save_figure(_drawing(), tmp_path / "three")] == expected
        assert matplotlib.rcParams["lines.linewidth"] == 7
    assert b"<dc:date>" not in expected[1]


def test_an_svg_that_was_edited_since_is_somebody_elses(tmp_path: Path) -> None:
    _, svg = save_figure(_drawing(), tmp_path / "line")
    # A drawing program keeps the metadata and writes its own header.
    svg.write_bytes(b'<?xml version="1.0"?>\n<svg ' + svg.read_bytes().split(b"<svg", 1)[1])
    with pytest.raises(ConfigError):
        save_figure(_drawing(), tmp_path / "line")


@given(count=st.integers(1, 30_000), seed=st.integers(0, 9))
@settings(max_examples=30, deadline=None)
def test_a_thinned_line_keeps_its_ends_and_every_extreme(count: int, seed: int) -> None:
    time = np.arange(float(count))
    value = np.random.default_rng(seed).standard_normal(count).cumsum()
    x, y = thinned(time, value)
    assert len(x) <= 4002
    assert (x[0], x[-1]) == (0.0, count - 1.0)
    assert np.array_equal(y, value[x.astype(int)])
    assert np.all(np.diff(x) > 0)
    assert (y.min(), y.max()) == (value.min(), value.max())


@pytest.mark.parametrize(
    ("value", "std", "written"),
    [
        (206.99911, 0.00065, "206.99911 ± 0.00065"),
        (-0.045, 0.0048, "−0.0450 ± 0.0048"),
        (64.03, 1.25, "64.0 ± 1.2"),
        (1234.5, 150.0, "1234 ± 150"),
        (2.06999371234, 6.1e-9, "2.06999 ± 6e−09"),
        (7.3e-9, 1.2e-10, "7.3e−09 ± 1e−10"),
        (0.25, 0.0, "0.25"),
        (0.25, float("nan"), "0.25"),
    ],
)
def test_a_value_is_written_to_the_second_digit_of_its_deviation(value: float, std: float, written: str) -> None:
    assert plus_minus(value, std) == written
