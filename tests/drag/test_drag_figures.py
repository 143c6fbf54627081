"""Figures of drag: forces over wind and rotor speed, coefficients, and the models' forces."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from cfid.drag.comparison import DragModels, fit_models
from cfid.drag.figures import coefficients_figure, drag_figures, models_figure
from tests.drag.thesis_campaign import SIMPLE_AIR, measured

Look = Callable[[Figure], Any]


@pytest.fixture(scope="module")
def found() -> DragModels:
    return fit_models(measured(SIMPLE_AIR, np.random.default_rng(3)))


def panels(page: Figure) -> list[Axes]:
    return [axes for axes in page.axes if axes.axison]


def curves(axes: Axes) -> list[Any]:
    """Return the lines that show winds, without lines across the panel."""
    return [line for line in axes.get_lines() if len(np.asarray(line.get_xdata())) > 2]


def test_the_model_is_drawn_as_lines_through_the_measured_forces_and_squared_errors_are_listed(
    found: DragModels, look: Look
) -> None:
    page = models_figure(found)
    first = panels(page)[0]
    marks, model = curves(first)[:5], curves(first)[5:]

    assert len(model) == 5
    assert {line.get_linestyle() for line in marks} == {"None"}
    written = " ".join(text.get_text() for axes in page.axes for text in axes.texts)
    assert f"{found.fits['simple'].sse_n2:.4g} N²" in written
    assert "simple, by the Bayesian information criterion" in written
    assert not look(page).overlapping()


def test_forces_and_coefficients_have_bars_of_their_uncertainty(found: DragModels) -> None:
    forces, models = drag_figures(found)["drag_forces"], models_figure(found)
    runs, (sideways, along_z) = found.experiments, found.fits[found.chosen].noise_scale
    stated = np.hypot(runs.force_std_n, runs.reference_std_n) * np.array([sideways, sideways, along_z])

    assert np.sort(bars(panels(forces)[6:])) == pytest.approx(np.sort(stated[:, 2]))
    assert np.sort(bars(panels(models))) == pytest.approx(np.sort(np.repeat(stated[:, 2], 2)))
    assert len(bars(panels(coefficients_figure(found)))) >= len(runs.command)


def bars(several: list[Axes]) -> list[float]:
    """Return half the heights of the error bars of several panels."""
    drawn = [one for axes in several for one in axes.collections if isinstance(one, LineCollection)]
    return [float(np.ptp(np.asarray(bar)[:, 1])) / 2 for one in drawn for bar in one.get_segments() if len(bar)]
