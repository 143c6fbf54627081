"""Draw a validation: each set's mean error over the time since the prediction started."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from cfid.drawing.style import figure, legend, name_panel, styled
from cfid.flight.rows import ROW_S
from cfid.units import COVERAGE_95
from cfid.validation.predictions import HORIZONS, QUANTITIES, UNITS

Array = npt.NDArray[np.float64]


@styled
def validation_figure(each: Mapping[str, Mapping[str, Array]], *, title: str) -> Figure:
    """Return mean errors of sets by horizon, with the uncertainty of the mean over segments."""
    page, grid = figure(len(QUANTITIES), 1, heights_in=[2.0] * len(QUANTITIES), title=title)
    after_s = ROW_S * np.array(HORIZONS)
    for place, quantity in enumerate(QUANTITIES):
        axes = page.add_subplot(grid[place, 0])
        name_panel(axes, f"({'abc'[place]}) {quantity}", x="time since the begin (s)", y=f"error ({UNITS[quantity]})")
        for name, found in each.items():
            errors = found[quantity]
            half = COVERAGE_95 * errors.std(axis=0, ddof=1) / np.sqrt(len(errors))
            axes.errorbar(after_s, errors.mean(axis=0), yerr=half, marker="o", ms=3, capsize=2, lw=1.1, label=name)
        axes.set_xscale("log")
        axes.set_yscale("log")
        legend(axes)
    return page
