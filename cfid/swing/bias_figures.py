"""Why a damped cosine fitted to a real pendulum finds too high an inertia, for the documentation's pages.

Draws numbers that it is given; nothing here simulates or fits.
"""

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from cfid.drawing.style import INK, KEY_IN, MODEL, MUTED, RECORDED, figure, key_row, name_panel, styled

Array = npt.NDArray[np.float64]

_MICRO = 1e6
_LEAST = 1e-6  # of a logarithmic scale: a bias below it is rounding


@styled
def bias_figure(
    amplitude_deg: Array,
    relative_bias_of_cosine: Array,
    relative_bias_of_output_error: Array,
    theory: Array,
    *,
    title: str = "Bias of the inertia against the release angle",
) -> Figure:
    """Return relative biases (n,) of the inertia against the release angle (n,), and their sizes on a log scale.

    `theory` is the bias if the body kept swinging as far as at its release: (T/T0)^2 - 1 with the period's
    series T/T0 = 1 + A^2/16 + 11 A^4/3072. Damping takes the swing to smaller angles, so it is a bound.
    """
    page, grid = figure(2, 2, heights_in=(KEY_IN, 2.9), title=title)
    key_row(page.add_subplot(grid[0, :]), *_key("(T/T₀)² − 1, period T at the release angle"))
    linear, log = page.add_subplot(grid[1, 0]), page.add_subplot(grid[1, 1])
    name_panel(linear, "(a) bias", x="release angle (°)", y="bias of the inertia (%)")
    name_panel(log, "(b) its size", x="release angle (°)", y="|bias| of the inertia (%)")
    linear.axhline(0.0, color=INK, lw=0.6)
    _draw(linear, amplitude_deg, 100 * relative_bias_of_cosine, 100 * relative_bias_of_output_error)
    cosine, output_error = (
        100 * np.maximum(np.abs(bias), _LEAST) for bias in (relative_bias_of_cosine, relative_bias_of_output_error)
    )
    _draw(log, amplitude_deg, cosine, output_error)
    for axes in (linear, log):
        axes.plot(amplitude_deg, 100 * theory, color=MUTED, ls="--", zorder=1.5)
    log.set_yscale("log")
    return page


@styled
def peaks_figure(
    peaks: Array,
    inertia_of_cosine_kg_m2: Array,
    inertia_of_output_error_kg_m2: Array,
    true_kg_m2: float,
    *,
    title: str = "Inertia against the number of peaks used",
) -> Figure:
    """Return axis inertias (n,) found from the first peaks (n,) of one record, and what they differ by from the truth.

    The more small swings a damped cosine sees, the lower its inertia; a pendulum's does not depend on them.
    """
    page, grid = figure(2, 2, heights_in=(KEY_IN, 2.9), title=title)
    key_row(page.add_subplot(grid[0, :]), *_key("true inertia"))
    inertia, error = page.add_subplot(grid[1, 0]), page.add_subplot(grid[1, 1])
    name_panel(inertia, "(a) inertia", x="peaks used (-)", y="inertia (10⁻⁶ kg m²)")
    name_panel(error, "(b) its difference from the truth", x="peaks used (-)", y="difference (%)")
    found = inertia_of_cosine_kg_m2, inertia_of_output_error_kg_m2
    _draw(inertia, peaks, *(_MICRO * each for each in found))
    _draw(error, peaks, *(100 * (each / true_kg_m2 - 1) for each in found))
    for axes, truth in ((inertia, _MICRO * true_kg_m2), (error, 0.0)):
        axes.axhline(truth, color=MUTED, ls="--", zorder=1.5)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    return page


def _draw(axes: Axes, x: Array, cosine: Array, output_error: Array) -> None:
    axes.plot(x, cosine, color=RECORDED, marker="o", ms=4)
    axes.plot(x, output_error, color=MODEL, marker="s", ms=4)
    axes.margins(y=0.08)


def _key(reference: str) -> list[Line2D]:
    return [
        Line2D([], [], color=RECORDED, marker="o", ms=4, label="damped cosine (thesis)"),
        Line2D([], [], color=MODEL, marker="s", ms=4, label="equation of motion (cfid)"),
        Line2D([], [], color=MUTED, ls="--", label=reference),
    ]
