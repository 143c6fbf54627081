"""Collect drag coefficients as a result: quantities, findings, how the models compare, and figures."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.drag.causes import distorted
from cfid.drag.comparison import DragModels, Method, fit_models, quantities_of, resolves_kappa_4
from cfid.drag.data import WindReading, read_runs
from cfid.drag.estimation import DragFit
from cfid.drag.model import CROSS_MENDED, DragExperiments
from cfid.drag.thesis import Grouping, group_rows, normalise
from cfid.estimate.common_causes import moved_by, with_common_causes
from cfid.quantities.registry import Range, unit_of
from cfid.records.covariances import Covariance, covariance_between
from cfid.records.parameters import Parameter
from cfid.records.plausibility import Given, implausible_inputs
from cfid.records.result import Dependent, Figures, Result
from cfid.records.rig_file import NONE_STATED, LoadCellMount, RigFacts, Tachometer, WindStand
from cfid.records.run import Run

Array = npt.NDArray[np.float64]

_WIND = Range(0.1, 25, "a fan gives 1 to 10, and no small quadrocopter flies in more")
_SIMPLE, _CROSS = "drag.simple_kg_per_rad", "drag.cross_coupling_kg_per_rad"


def fit(
    measured: DragExperiments | Sequence[Run | Path | str],
    *,
    index: Path | None = None,
    azimuth_deg: float | None = None,
    yaw_deg: float | None = None,
    markers: int | None = None,
    flip_fz: bool | None = None,
    rig: RigFacts = NONE_STATED,
    mended: bool = False,
    intercepts: bool = False,
    parasitic: bool = False,
    grouping: Grouping | None = None,
    method: Method = "default",
) -> Result:
    """Fit the simple, the cross-coupling and the complex model of drag, and choose the one that the data support.

    `measured` are runs of `cfid log wind`, together with the recordings that an `index` lists, or experiments from
    `read_forces`. Azimuth of the wind generator, yaw and sign of the load cell and the tachometer's markers replace
    those that a run states; recordings of an index have the facts of `rig`. See `fit_models` for the models and
    methods, `group_rows` for `grouping`.

    Raises ConfigError for intercepts with a parasitic term, DataError for what cannot be read, and FitError when not
    even the simple model is determined.
    """
    if isinstance(measured, DragExperiments):
        experiments = measured
    else:
        given = RigFacts(
            loadcell=LoadCellMount(flip_fz=flip_fz),
            tachometer=Tachometer(markers=markers),
            wind=WindStand(azimuth_deg=azimuth_deg, yaw_deg=yaw_deg),
        )
        experiments = read_runs(measured, index=index, how=WindReading(method, given, rig))
    models = fit_models(experiments, method=method, mended=mended, intercepts=intercepts, parasitic=parasitic)
    quantities = drag_quantities(models, grouping)
    fastest = Given("wind", float(experiments.wind_mps.max()), _WIND, "m/s")
    result = Result(
        command="fit drag",
        method=method,
        quantities=quantities,
        wanted=quantities_of(models.chosen),
        beside=(
            "drag.sse*",
            *(key for name in models.fits if name != models.chosen for key in quantities_of(name)),
        ),
        findings=(*models.findings, *implausible_inputs([fastest], None, "drag.*")),
        merits=drag_merits(models, quantities),
        sources=experiments.sources,
        covariances=drag_covariances(models),
        lines=tuple(drag_lines(models, quantities)),
        drawings=lambda: _drawings(models),
    )
    effects = {}
    for cause, runs in distorted(experiments).items():
        fits = {name: fit.moved_to(runs) for name, fit in models.fits.items()}
        moved = drag_quantities(replace(models, experiments=runs, fits=fits))
        effects[cause] = moved_by(quantities, moved) if cause.std else {}
    return with_common_causes(result, effects)


def _drawings(models: DragModels) -> Figures:
    """Draw forces, coefficients and models, and how the vehicle was mounted if all runs state the same."""
    from cfid.drag.figures import drag_figures
    from cfid.drawing.rig import load_cell_figure

    runs = models.experiments
    mounts = {(rig.yaw_in_wind_deg, rig.wind.azimuth_deg) for rig in runs.rigs}
    yaw_deg, azimuth_deg = mounts.pop() if len(mounts) == 1 else (None, None)
    if yaw_deg is None:
        return drag_figures(models)
    angles_deg = np.unique(np.round(runs.angle_deg)).tolist()
    title = "Load cell and wind, as rig.toml and the runs state them"
    rig = load_cell_figure(yaw_deg, azimuth_deg=azimuth_deg, angles_deg=angles_deg, title=title)
    return {**drag_figures(models), "drag_rig": rig}


def drag_quantities(models: DragModels, grouping: Grouping | None = None) -> dict[str, Parameter]:
    """Return all fitted quantities, by key."""
    fits, runs = models.fits, models.experiments
    values: dict[str, tuple[Any, Any]] = {_SIMPLE: (fits["simple"].value, fits["simple"].std)}
    if "complex" in fits:
        value, std = fits["complex"].value, fits["complex"].std
        forms = {"": (value, std), "normalised.": (_normalised(value, runs), _normalised(std, runs))}
        for form, (value, std) in forms.items():
            values |= {f"drag.complex.{form}k{i + 1}": (value[i], std[i]) for i in range(6)}
    if "cross" in fits:
        values[_CROSS] = fits["cross"].value, fits["cross"].std
    values |= {f"drag.sse_n2.{name}": (fit.sse_n2, None) for name, fit in fits.items()}
    for name, fit in fits.items():
        if fit.parasitic:
            values[f"drag.parasitic_kg_per_m.{name}"] = fit.parasitic_kg_per_m
        if fit.intercepts:
            values[f"drag.intercepts_n.{name}"] = _intercepts(fit, runs), None
    if grouping is not None:
        values["drag.groups"] = group_rows(runs, grouping), None
    return {key: Parameter(value=value, std=std, unit=unit_of(key)) for key, (value, std) in values.items()}


def _normalised(coefficients: Array, runs: DragExperiments, *, squared: bool = False) -> Array:
    return normalise(coefficients, wind_mps=runs.wind_mps, speed_sum_rad_s=runs.speed_sum_rad_s, squared=squared)


def _intercepts(fit: DragFit, runs: DragExperiments) -> list[dict[str, float]]:
    """Return the constant force in each wind setting, one row each."""
    first = np.unique(runs.setting, return_index=True)[1]
    return [
        {"angle_deg": float(runs.angle_deg[row]), "wind_mps": float(runs.wind_mps[row]), "x_n": x, "y_n": y, "z_n": z}
        for row, (x, y, z) in zip(first, fit.intercepts_n.tolist(), strict=True)
    ]


def drag_covariances(models: DragModels) -> tuple[Covariance, ...]:
    """Return the covariances of the values of the simple and of the cross-coupling model."""
    fits = {key: models.fits[name] for key, name in ((_SIMPLE, "simple"), (_CROSS, "cross")) if name in models.fits}
    return tuple(
        block
        for key, fit in fits.items()
        for block in covariance_between({key: fit.value.tolist()}, fit.value_covariance)
    )


def drag_merits(models: DragModels, quantities: Mapping[str, Parameter]) -> dict[str, Any]:
    """Return the figures of merit of the models."""
    runs, cross = models.experiments, models.fits.get("cross")
    merits = {
        "chosen": models.chosen,
        "experiments": len(runs.command),
        "wind_settings": runs.settings,
        "mean_wind_mps": runs.wind_mps.mean(),
        "mean_speed_sum_rad_s": runs.speed_sum_rad_s.mean(),
        "kappa_4_times": None,
        "unresolved": (),
        "normalised_squared": None,
        "models": [
            {
                "model": name,
                "bic": models.bic[name],
                "condition": fit.condition,
                "degrees_of_freedom": fit.degrees_of_freedom,
                "noise_scale": fit.noise_scale,
            }
            for name, fit in models.fits.items()
        ],
    }
    if cross is not None:
        merits["kappa_4_times"] = "|v_xy|" if cross.model is CROSS_MENDED else "v_x + v_y"
        merits["unresolved"] = () if resolves_kappa_4(runs) else ("kappa_4",)
    if "complex" in models.fits:
        squared = _normalised(models.fits["complex"].value, runs, squared=True)
        merits["normalised_squared"] = Dependent(
            squared, *(key for key in quantities if key.startswith("drag.complex."))
        )
    return merits


def drag_lines(models: DragModels, quantities: Mapping[str, Parameter]) -> list[str | Dependent]:
    """Return lines on how the models compare, and tables of the requested values."""
    runs, least = models.experiments, models.bic[models.chosen]
    lines: list[str | Dependent] = [
        f"{counted(len(runs.command), 'experiment')} in {counted(runs.settings, 'wind setting')}; squared "
        "errors of each model in N^2, and its information criterion (BIC) above the smallest:"
    ]
    for name, fit in models.fits.items():
        chosen = "  <- chosen" if name == models.chosen and len(models.fits) > 1 else ""
        line = (
            f"  {name:8} {fit.sse_n2:.4g}, BIC +{models.bic[name] - least:.1f} (condition {fit.condition:.3g}, "
            f"{len(fit.model.terms)} coefficients){chosen}"
        )
        lines.append(Dependent(line, f"drag.sse_n2.{name}"))
    for key, what in (("drag.intercepts_n.simple", "constant forces of the simple model:"), ("drag.groups", "")):
        if key in quantities:
            rows = [", ".join(f"{name} {value:.5g}" for name, value in row.items()) for row in quantities[key].value]
            lines += [Dependent(row, key) for row in ([what] if what else []) + [f"  {row}" for row in rows]]
    return lines
