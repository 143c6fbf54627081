"""Make the figures of docs/explanation from simulated swings: `python docs/make_figures.py`.

Two of them show why a damped cosine fitted to a real pendulum finds too high an inertia.
"""

import functools
import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from cfid.drawing.save import save_figure
from cfid.drawing.style import INK, KEY_IN, MODEL, MUTED, RECORDED, figure, key_row, name_panel, styled
from cfid.sim.plants import HandRelease, Pendulum, swing
from cfid.swing.estimation import fit_swing
from cfid.swing.figures import swing_figure
from cfid.swing.thesis import fit_damped_cosine
from cfid.swing.window import FreeSwing, find_swing

Array = npt.NDArray[np.float64]

FIGURES = Path(__file__).parent / "explanation" / "figures"

# The pendulum whose damped-cosine fits come nearest to table 2.3's two rows for the x axis.
MOMENT_NM = 0.028 * 9.81 * 0.022855127980389874
INERTIA_KG_M2, VISCOUS, COULOMB, RELEASE_DEG = 3.0185e-5, 1.564e-5, 4.564e-5, 49.6
_MICRO = 1e6
_LEAST = 1e-6  # the lower end of the logarithmic scale; a smaller bias is rounding
TABLE_2_3 = {8: 3.144988e-5, 11: 3.119770e-5}


@functools.cache
def record(degrees: float) -> tuple[Array, Array]:
    """Return time and angle of the pendulum released at an angle, rounded to the steps of a 13-bit encoder."""
    pendulum = Pendulum(
        axis_inertia_kg_m2=INERTIA_KG_M2,
        gravity_moment_nm=MOMENT_NM,
        viscous_nms_per_rad=VISCOUS,
        coulomb_nm=COULOMB,
    )
    release = HandRelease(angle_rad=math.radians(degrees), tremor_rad=0.0, wait_s=0.05, lift_s=0.3, hold_s=0.2)
    motion = swing([pendulum], [release], duration_s=9.0, step_s=1e-3, store_every=1)
    step = 2 * math.pi / 8192
    return motion.time_s, step * np.round(motion.angle_rad[:, 0] / step)


def swung(degrees: float, peaks: int | None = None) -> FreeSwing:
    """Return the free swing of a record."""
    return find_swing(*record(degrees), peaks=peaks)


def inertias(degrees: float, peaks: int | None = None) -> tuple[float, float]:
    """Return the axis inertia by the damped cosine and by the output-error fit."""
    found = swung(degrees, peaks)
    cosine = fit_damped_cosine(found).frequencies.natural_frequency_squared_s2
    return MOMENT_NM / cosine, MOMENT_NM / fit_swing(found).coefficients.natural_frequency_squared_s2


def main() -> None:
    """Write all figures."""
    degrees = np.arange(10.0, 71.0, 5.0)
    by_angle = np.array([inertias(angle) for angle in degrees]) / INERTIA_KG_M2 - 1
    amplitude = np.radians(degrees)
    theory = (1 + amplitude**2 / 16 + 11 * amplitude**4 / 3072) ** 2 - 1
    peaks = np.arange(4, len(swung(RELEASE_DEG).peak_time_s) + 1)
    by_peaks = np.array([inertias(RELEASE_DEG, int(count)) for count in peaks])
    FIGURES.mkdir(parents=True, exist_ok=True)
    for name, page in {
        "bias_against_amplitude": bias_figure(degrees, by_angle[:, 0], by_angle[:, 1], theory),
        "inertia_against_peaks": peaks_figure(peaks, by_peaks[:, 0], by_peaks[:, 1], INERTIA_KG_M2),
        "swing": swing_figure(swung(RELEASE_DEG), fit_swing(swung(RELEASE_DEG)), title="A simulated swing"),
    }.items():
        save_figure(page, FIGURES / name)
    for angle, (cosine, error) in zip(degrees, by_angle, strict=True):
        print(f"{angle:4.0f} degrees: damped cosine {100 * cosine:+6.2f} %, output error {100 * error:+8.4f} %")
    for count, (cosine, ours) in zip(peaks, by_peaks, strict=True):
        printed = f", table 2.3: {1e5 * TABLE_2_3[count]:.4f}" if count in TABLE_2_3 else ""
        print(f"{count:3d} peaks: damped cosine {1e5 * cosine:.4f}, output error {1e5 * ours:.4f} 1e-5 kg m^2{printed}")


@styled
def bias_figure(
    amplitude_deg: Array,
    relative_bias_of_cosine: Array,
    relative_bias_of_output_error: Array,
    theory: Array,
    *,
    title: str = "Bias of the inertia against the release angle",
) -> Figure:
    """Draw relative biases (n,) of the inertia against the release angle (n,), and their sizes on a log scale.

    `theory` is the bias of a body that keeps its release amplitude A: (T/T0)^2 - 1 with the series of the period
    T/T0 = 1 + A^2/16 + 11 A^4/3072. Damping reduces the amplitude, so this bias is a bound.
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
    """Draw axis inertias (n,) from the first peaks (n,) of one record, and their differences from the truth.

    The more small swings a fit of a damped cosine includes, the lower its inertia; that of a pendulum fit does not
    depend on them.
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


if __name__ == "__main__":
    main()
