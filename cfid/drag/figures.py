"""Draw drag: forces over wind and rotor speed (4.10), coefficients (4.11), and the models' forces (4.12)."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cfid.drag.comparison import DragModels, quantities_of
from cfid.drag.model import DragExperiments
from cfid.drag.thesis import lateral_kg_per_rad, ratios_kg_per_rad
from cfid.drawing.style import DASHES, INK, KEY_IN, MUTED, SERIES, figure, key_row, name_panel, styled, words

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]

_SPEED = "sum of rotor speeds (rad/s)"
_PALEST = 0.65  # of white in the colour of the strongest wind: fast winds are pale, as in figure 4.11
_AXES = ("x", "y", "z")
_MOST_ANGLES = 3  # next to each other on a page


class _Wind(NamedTuple):
    """Experiments (rows) of one wind setting in the order of their speeds, and the style to draw them in."""

    rows: Rows
    angle_deg: float
    speed_mps: float
    colour: tuple[float, float, float]


def drag_figures(models: DragModels) -> Mapping[str, Figure]:
    """Return all figures by file name."""
    return {
        "drag_forces": forces_figure(models.experiments, std_n=_force_std_n(models)),
        "drag_models": models_figure(models),
        "drag_coefficients": coefficients_figure(models),
    }


@styled
def forces_figure(experiments: DragExperiments, *, std_n: Array | None = None) -> Figure:
    """Return each component of the drag force over the rotors' speed, with one line per wind, one column per angle.

    Bars are the standard uncertainties (n, 3) of the forces.
    """
    angles, winds = _angles(experiments), list(_winds(experiments))
    page, grid = figure(
        4,
        len(angles),
        heights_in=(2 * KEY_IN, 1.9, 1.9, 2.1),
        title="Drag force in wind, less the thrust without it",
        notes=_not_drawn(experiments),
    )
    key_row(page.add_subplot(grid[0, :]), *_key(angles))
    for row, axis in enumerate(_AXES):
        first: Axes | None = None
        for column, angle in enumerate(angles):
            first = axes = page.add_subplot(grid[1 + row, column], sharey=first)
            last = row == len(_AXES) - 1
            name_panel(
                axes,
                f"wind from {angle:g}°" if row == 0 else "",
                x=_SPEED if last else "",
                y=f"f{axis} (N)" if column == 0 else "",
            )
            axes.axhline(0.0, color=MUTED, lw=0.8)
            std = None if std_n is None else std_n[:, row]
            _draw_winds(axes, winds, angle, experiments, experiments.force_n[:, row], std=std)
            axes.tick_params(labelbottom=last, labelleft=column == 0)
    page.align_ylabels()
    return page


@styled
def coefficients_figure(models: DragModels) -> Figure:
    """Return the simple model's coefficients of every experiment over the rotors' speed, and those of the fit.

    Coefficients of x and y are from both axes together, and from winds from the side alone. Bands are one standard
    uncertainty of the fit; bars are that of an experiment from its forces' noise and its wind speed.
    """
    experiments, simple = models.experiments, models.fits["simple"]
    angles, winds = _angles(experiments), list(_winds(experiments))
    page, grid = figure(
        3,
        1,
        heights_in=(2 * KEY_IN, 2.6, 2.6),
        title="Drag coefficients of the simple model",
        notes=_not_drawn(experiments),
    )
    key_row(page.add_subplot(grid[0, :]), *_key(angles), Line2D([], [], color=INK, label="all together"))
    first: Axes | None = None
    noise = np.abs(ratios_kg_per_rad(replace(experiments, force_n=_force_std_n(models))))
    z = ratios_kg_per_rad(experiments)[:, 2]
    lateral = np.sqrt(np.nansum(noise[:, :2] ** 2, axis=1)) / np.maximum(np.isfinite(noise[:, :2]).sum(axis=1), 1)
    panels = (("(a) x and y", lateral_kg_per_rad(experiments), lateral, 0), ("(b) z", z, noise[:, 2], 2))
    for row, (title, coefficient, noise_std, place) in enumerate(panels):
        first = axes = page.add_subplot(grid[1 + row, 0], sharex=first)
        name_panel(axes, title, x=_SPEED if row else "", y="coefficient (kg/rad)")
        value, std = simple.value[place], simple.std[place]
        axes.axhspan(value - std, value + std, fc=INK, alpha=0.15, lw=0)
        axes.axhline(value, color=INK, lw=1.1)
        std_of_each = np.hypot(noise_std, experiments.wind_relative_std * coefficient)
        for angle in angles:
            _draw_winds(axes, winds, angle, experiments, coefficient, std=std_of_each)
        axes.ticklabel_format(axis="y", style="sci", scilimits=(0, 0))
    page.align_ylabels()
    return page


@styled
def models_figure(models: DragModels) -> Figure:
    """Return the force along z as measured (marks) and as the chosen model predicts it (lines), with its residuals."""
    experiments, chosen = models.experiments, models.fits[models.chosen]
    angles, winds = _angles(experiments), list(_winds(experiments))
    key = quantities_of(models.chosen)[0]
    rejections = [
        finding.text for finding in models.findings if finding.severity == "rejection" and finding.concerns(key)
    ]
    page, grid = figure(
        4,
        len(angles),
        heights_in=(2 * KEY_IN, 2.6, 1.7, 0.42 + 0.165 * (len(models.fits) + 1)),
        title=f"Drag force along z, measured and by the {models.chosen} model",
        rejections=[f"Rejected: {text}" for text in rejections],
        notes=_not_drawn(experiments),
    )
    key_row(page.add_subplot(grid[0, :]), *_key(angles), *_marks())
    residual = chosen.residual_n[:, 2]
    predicted = experiments.force_n[:, 2] - residual
    rows = (("fz (N)", experiments.force_n[:, 2]), ("residual (N)", residual))
    for row, (label, marks) in enumerate(rows):
        first: Axes | None = None
        for column, angle in enumerate(angles):
            first = axes = page.add_subplot(grid[1 + row, column], sharey=first)
            name_panel(
                axes,
                f"wind from {angle:g}°" if row == 0 else "",
                x=_SPEED if row else "",
                y=label if column == 0 else "",
            )
            axes.axhline(0.0, color=MUTED, lw=0.8)
            line = "" if row == 0 else ":"
            _draw_winds(axes, winds, angle, experiments, marks, line=line, std=_force_std_n(models)[:, 2])
            if row == 0:
                _draw_winds(axes, winds, angle, experiments, predicted, marker="")
            axes.tick_params(labelbottom=row == 1, labelleft=column == 0)
    words(page.add_subplot(grid[3, :]), "sum of squared errors over x, y and z", _comparison(models))
    page.align_ylabels()
    return page


def _force_std_n(models: DragModels) -> Array:
    """Return the standard uncertainty (n, 3) of each force from its noise and its reference's, as scaled by the fit."""
    sideways, along_z = models.fits[models.chosen].noise_scale
    stated = np.hypot(models.experiments.force_std_n, models.experiments.reference_std_n)
    return np.asarray(stated * np.array([sideways, sideways, along_z]))


def _comparison(models: DragModels) -> list[tuple[str, str]]:
    squares = [(f"{name} model", f"{fit.sse_n2:.4g} N²") for name, fit in models.fits.items()]
    return [*squares, ("chosen", f"{models.chosen}, by the Bayesian information criterion")]


def _angles(experiments: DragExperiments) -> list[float]:
    """Return the angles with a column of their own: if there are many, a selection spread evenly over all."""
    angles = np.unique(experiments.angle_deg)
    drawn = np.unique(np.linspace(0, len(angles) - 1, min(len(angles), _MOST_ANGLES)).round().astype(int))
    return [float(angle) for angle in angles[drawn]]


def _not_drawn(experiments: DragExperiments) -> list[str]:
    left_out = [f"{angle:g}°" for angle in np.unique(experiments.angle_deg) if angle not in _angles(experiments)]
    return [f"wind from {', '.join(left_out)} is fitted, not drawn."] if left_out else []


def _winds(experiments: DragExperiments) -> Iterator[_Wind]:
    """Yield the wind settings to draw, each angle in its own colour, paler with faster wind."""
    angles = _angles(experiments)
    fastest = float(experiments.wind_mps.max())
    for setting in range(experiments.settings):
        rows = np.flatnonzero(experiments.setting == setting)
        rows = rows[np.argsort(experiments.speed_sum_rad_s[rows])]
        angle, speed = float(experiments.angle_deg[rows[0]]), float(experiments.wind_mps[rows[0]])
        if angle not in angles:
            continue
        base = np.array(to_rgb(SERIES[angles.index(angle) % len(SERIES)]))
        colour = base + _PALEST * speed / fastest * (1 - base)
        red, green, blue = colour.tolist()
        yield _Wind(rows, angle, speed, (red, green, blue))


def _draw_winds(
    axes: Axes,
    winds: Sequence[_Wind],
    angle_deg: float,
    experiments: DragExperiments,
    value: Array,
    *,
    line: str = "-",
    marker: str = "o",
    std: Array | None = None,
) -> None:
    for wind in winds:
        if wind.angle_deg == angle_deg:
            speed = experiments.speed_sum_rad_s[wind.rows]
            axes.plot(speed, value[wind.rows], ls=line, marker=marker, ms=3, color=wind.colour, lw=1.0)
            if std is not None:
                axes.errorbar(speed, value[wind.rows], std[wind.rows], fmt="none", ecolor=wind.colour, elinewidth=0.8)


def _key(angles: Sequence[float]) -> list[Line2D]:
    named = [
        Line2D([], [], color=SERIES[i % len(SERIES)], marker="o", ms=3, label=f"wind from {angle:g}°")
        for i, angle in enumerate(angles)
    ]
    return [*named, Line2D([], [], ls="", label="(lighter: faster)")]


def _marks() -> list[Line2D]:
    return [
        Line2D([], [], ls="", marker="o", ms=3, color=INK, label="measured"),
        Line2D([], [], ls=DASHES[0], color=INK, label="model"),
    ]
