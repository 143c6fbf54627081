"""Which figures `cfid tf identify` draws: Bode, step, and of each series one run."""

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cfid.transfer.identification import Identified
    from cfid.transfer.thesis import ThesisFit
    from cfid.transfer.thesis_options import AsThesis

_EXAMPLE_HZ = 1.5  # l = 12 of N = 4000, which the thesis shows


def fit_drawings(found: "Identified", *, thesis: "ThesisFit | None", settle_s: float) -> "dict[str, Figure]":
    """Return the figures of a fit by file name."""
    from cfid.transfer.figures import bode_figure, step_figure
    from cfid.transfer.panels import sine_run_figure

    figures = {"tf_bode": bode_figure(found.fit, thesis=thesis), "tf_step": step_figure(found.fit, thesis=thesis)}
    for name, series in found.aligned.items():
        place = min(
            range(len(series.runs)),
            key=lambda i: abs(math.log(series.runs[i].frequency_rad_s / (2 * math.pi * _EXAMPLE_HZ))),
        )
        figures[f"tf_run_{name}"] = sine_run_figure(
            series.runs[place], found.used[name][place].reports, settle_s=settle_s
        )
    return figures


def thesis_drawings(found: "AsThesis") -> "dict[str, Figure]":
    """Return the figure of the thesis' calculation by file name."""
    from cfid.transfer.figures import thesis_bode_figure
    from cfid.transfer.sines.reports import SAMPLE_S

    return {"tf_bode_thesis": thesis_bode_figure(found.each, found.joint, sample_s=SAMPLE_S)}
