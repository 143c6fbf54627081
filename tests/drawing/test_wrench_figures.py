"""Figures of a load cell's raw record: its axes, its lines, its losses, and small files for any length."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from matplotlib.figure import Figure

from cfid.drawing.recordings import gaps_of, lines_of, spectrum_of, wrench_figure
from cfid.findings import of_recording
from cfid.recordings.wrench import WrenchRecord
from cfid.records.parameters import Source
from cfid.records.run import Label

Look = Callable[[Figure], Any]
Array = npt.NDArray[np.float64]

RATE_HZ = 7000.0
TIME_S = np.arange(28_000) / RATE_HZ
LINES_HZ = (211.0, 324.0, 422.0, 648.0)


def _record(time_s: Array, fz_n: Array, *notes: str, lost: int | None = 0) -> WrenchRecord:
    noise = np.random.default_rng(2).standard_normal((len(time_s), 6))
    return WrenchRecord(
        path=Path("loadcell.csv"),
        source=Source("loadcell.csv", ""),
        label=Label(),
        time_s=time_s,
        force_n=0.003 * noise[:, :3] + np.column_stack([0 * fz_n + 0.3, 0 * fz_n - 0.2, fz_n]),
        torque_nm=1e-4 * noise[:, 3:],
        status=None,
        findings=of_recording("loadcell.csv", notes),
        lost=lost,
    )


def _thrust(time_s: Array, amplitude_n: float = 0.05) -> Array:
    return 0.15 + amplitude_n * sum((np.sin(2 * np.pi * f * time_s) for f in LINES_HZ), np.zeros_like(time_s))


def test_forces_and_torques_are_drawn_in_their_units_with_their_means(look: Look) -> None:
    page = look(wrench_figure(_record(TIME_S, _thrust(TIME_S), "one note."), title="a"))
    forces, torques = page.panel("(a)"), page.panel("(b)")
    assert (forces.get_ylabel(), torques.get_ylabel()) == ("force (N)", "torque (mNm)")
    means = {line.get_label(): np.mean(line.get_ydata()) for line in forces.get_lines()[3:]}
    assert means == pytest.approx({"Fx": 0.3, "Fy": -0.2, "Fz": 0.15}, abs=1e-3)
    assert "Note: loadcell.csv: one note." in [text.get_text() for text in page.texts()]
    assert page.red() == ""
    assert page.overlapping() == []


@pytest.mark.parametrize("seed", range(8))
def test_noise_has_no_lines(seed: int) -> None:
    noise = np.random.default_rng(seed).standard_normal(len(TIME_S))
    assert len(lines_of(spectrum_of(TIME_S, noise))) == 0
    assert len(lines_of(spectrum_of(TIME_S[:7000], noise[:7000]))) == 0


@pytest.mark.parametrize("stamped", ["in blocks", "late"])
def test_lines_are_found_whatever_a_computer_made_of_the_times(stamped: str) -> None:
    if stamped == "in blocks":
        time = np.floor(TIME_S / 0.01) * 0.01
    else:
        late = np.random.default_rng(4).exponential(3e-4, len(TIME_S))
        time = np.maximum.accumulate(TIME_S + late)
    spectrum = spectrum_of(time, _thrust(TIME_S))
    assert len(gaps_of(time)) == 0
    assert spectrum.frequency_hz[lines_of(spectrum)] == pytest.approx(LINES_HZ, abs=1.5)


def test_a_gap_is_marked_and_losses_are_red(look: Look) -> None:
    kept = (TIME_S < 1.0) | (TIME_S > 1.5)
    page = look(wrench_figure(_record(TIME_S[kept], _thrust(TIME_S[kept]), lost=3500), title="a"))
    for panel in ("(a)", "(b)"):
        (gaps,) = page.panel(panel).collections
        (corners,) = (path.vertices for path in gaps.get_paths())
        assert (corners[:, 0].min(), corners[:, 0].max()) == pytest.approx((1.0, 1.5), abs=1e-3)
    assert page.red() == "1, 0.5003 s in all 3500"
