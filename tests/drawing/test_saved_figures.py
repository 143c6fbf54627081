"""Files of figures: who owns them, their contents, and equal files for equal figures."""

import os
import subprocess
import sys
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

from cfid.drawing.save import save_figure
from cfid.drawing.style import draw_line, figure, name_panel, styled
from cfid.errors import ConfigError
from tests.lab import ROOT


@styled
def _drawing(slope: float = 1.0) -> Figure:
    page, grid = figure(1, 1, heights_in=(1.0,), title="a line")
    axes = page.add_subplot(grid[0, 0])
    name_panel(axes, "(a)", x="time (s)", y="angle (rad)")
    draw_line(axes, np.arange(9.0), slope * np.arange(9.0))
    axes.fill_between([2.0, 3.0], 4.0, 5.0, hatch="//")
    return page


def test_a_name_with_dots_is_kept_whole(tmp_path: Path) -> None:
    assert [path.name for path in save_figure(_drawing(), tmp_path / "x.0.8rad")] == ["x.0.8rad.png", "x.0.8rad.svg"]


def test_a_figure_replaces_its_own_files(tmp_path: Path) -> None:
    before = [path.read_bytes() for path in save_figure(_drawing(), tmp_path / "line")]
    after = [path.read_bytes() for path in save_figure(_drawing(slope=-2.0), tmp_path / "line")]
    assert before[0] != after[0]
    assert before[1] != after[1]


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


@pytest.mark.skipif(os.name != "posix", reason="pipes of Unix")
def test_a_pipe_of_that_name_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "figure.png")
    with pytest.raises(ConfigError, match="no figure can be written there: a pipe or a device"):
        save_figure(_drawing(), tmp_path / "figure")


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


def test_drawing_neither_loads_pyplot_nor_touches_its_settings() -> None:
    code = """
import sys, matplotlib
before = dict(matplotlib.rcParams.copy())
import docs.make_figures as drawn, numpy as np
drawn.bias_figure(*np.ones((4, 5)))
assert dict(matplotlib.rcParams.copy()) == before
assert "matplotlib.pyplot" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def test_an_svg_that_was_edited_since_is_somebody_elses(tmp_path: Path) -> None:
    _, svg = save_figure(_drawing(), tmp_path / "line")
    # A drawing program keeps the metadata and writes its own header.
    svg.write_bytes(b'<?xml version="1.0"?>\n<svg ' + svg.read_bytes().split(b"<svg", 1)[1])
    with pytest.raises(ConfigError):
        save_figure(_drawing(), tmp_path / "line")
