"""Figures of a raw record: its unit, its gaps, its notes."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from matplotlib.figure import Figure

from cfid.drawing.recordings import recording_figure
from cfid.findings import of_recording
from cfid.recordings.angle import AngleRecord
from cfid.records.parameters import Source
from cfid.records.run import Label

Look = Callable[[Figure], Any]
Array = npt.NDArray[np.float64]


def _record(time_s: Array, angle_rad: Array, *notes: str) -> AngleRecord:
    return AngleRecord(
        path=Path("a.csv"),
        source=Source("a.csv", ""),
        label=Label(),
        time_s=time_s,
        angle_rad=angle_rad,
        findings=of_recording("a.csv", notes),
    )


TIME_S = np.arange(0.0, 4.0, 0.002)


def test_a_swing_is_drawn_in_degrees(look: Look) -> None:
    page = look(recording_figure(_record(TIME_S, 0.5 * np.sin(9.0 * TIME_S), "one note."), title="a"))
    panel = page.panel("(a)")
    assert panel.get_ylabel() == "angle (°)"
    assert panel.get_lines()[-1].get_ydata().max() == pytest.approx(np.degrees(0.5), rel=1e-4)
    assert page.panel("(b)").get_lines()[-1].get_ydata().max() == pytest.approx(4.5, rel=0.01)
    assert "Note: a.csv: one note." in [text.get_text() for text in page.texts()]
    assert page.red() == ""
    assert page.overlapping() == []


def test_a_gap_in_the_record_is_marked(look: Look) -> None:
    kept = (TIME_S < 1.0) | (TIME_S > 1.3)
    page = look(recording_figure(_record(TIME_S[kept], np.sin(TIME_S[kept])), title="a"))
    (gaps,) = page.panel("(a)").collections
    (corners,) = (path.vertices for path in gaps.get_paths())
    assert (corners[:, 0].min(), corners[:, 0].max()) == pytest.approx((0.998, 1.302))
    assert page.red().startswith("1 over")
