"""Figures of transfer functions: responses with intervals and model, a step, one run, and a run with its simulation."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from cfid.transfer.alignment import RecordedSine, SineSeries, align
from cfid.transfer.estimation import MeasuredSeries, TransferFit, fit_transfer, measure
from cfid.transfer.figures import bode_figure, sine_run_figure, step_figure
from cfid.transfer.thesis import ThesisFit, fit_thesis
from tests.transfer.sine_recordings import GAIN_N, LAG_S, recorded, simulated

Look = Callable[[Figure], Any]


@pytest.fixture(scope="module")
def runs() -> list[RecordedSine]:
    return recorded(simulated((2, 6, 12, 30, 80)), channel="arm")


@pytest.fixture(scope="module")
def series(runs: list[RecordedSine]) -> SineSeries:
    return align(runs)


@pytest.fixture(scope="module")
def measured(series: SineSeries) -> MeasuredSeries:
    return measure("first", series)


@pytest.fixture(scope="module")
def fit(measured: MeasuredSeries) -> TransferFit:
    return fit_transfer([measured])


@pytest.fixture(scope="module")
def thesis(runs: list[RecordedSine]) -> ThesisFit:
    return fit_thesis(runs)


def test_a_bode_page_shows_every_response_with_its_interval_the_model_and_the_thesis(
    look: Look, fit: TransferFit, thesis: ThesisFit
) -> None:
    page = look(bode_figure(fit, thesis=thesis))
    size = page.panel("(a)")
    points = next(line for line in size.get_lines() if line.get_marker() == "o")

    np.testing.assert_allclose(points.get_ydata(), [1e6 * abs(own.value) for own in fit.measured[0].responses])
    assert len(size.collections) == 1  # the intervals
    curve = next(line for line in size.get_lines() if len(line.get_xdata()) > 100)
    assert curve.get_ydata()[0] == pytest.approx(1e6 * GAIN_N, rel=0.03)
    phases = page.panel("(b)")
    labels = {str(own.get_label()) for own in (*phases.get_lines(), *phases.containers)}
    assert {"model", "thesis method", "first, as stamped", "first"} <= labels
    assert page.red() == ""
    assert not page.overlapping()


@pytest.mark.parametrize("shape", ["first+delay", "second"])
def test_a_step_ends_at_the_static_gain_with_its_interval(
    look: Look, measured: MeasuredSeries, thesis: ThesisFit, shape: Any
) -> None:
    fit = fit_transfer([measured], shape=shape)
    page = look(step_figure(fit, thesis=thesis))
    axes = page.panel("thrust after a step")
    model = next(line for line in axes.get_lines() if line.get_label() == "model")
    (band,) = axes.collections

    assert model.get_ydata()[0] == 0
    assert model.get_ydata()[-1] == pytest.approx(1e6 * fit.gain_n, rel=0.01)
    edge = band.get_paths()[0].vertices
    last = edge[np.isclose(edge[:, 0], edge[:, 0].max()), 1]
    assert np.ptp(last) == pytest.approx(2 * 1.96e6 * fit.std[0], rel=0.25)
    assert not page.overlapping()


def test_a_run_is_shown_with_its_line_in_both_spectra(look: Look, series: SineSeries, runs: list[RecordedSine]) -> None:
    page = look(sine_run_figure(series.runs[2], runs[2].reports))

    for panel, height in (("(c)", 20000), ("(d)", 20000 * GAIN_N / np.hypot(1, 2 * np.pi * 1.5 * LAG_S))):
        tops = [segment[1][1] for segment in page.panel(panel).collections[0].get_segments()]
        assert max(tops) == pytest.approx(height, rel=0.02)
    assert not page.overlapping()
