"""Collect drag coefficients as a result: quantities, findings, how the models compare, and figures."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.drag.causes import distorted
from cfid.drag.checks import quantities_of, resolves_kappa_4
from cfid.drag.comparison import DragModels, Method, fit_each, fit_models
from cfid.drag.data import read_runs
from cfid.drag.estimation import DragFit, Uncertain
from cfid.drag.experiments import DragExperiments
from cfid.drag.model import CROSS_MENDED
from cfid.drag.thesis import Grouping, Normalised, group_rows, normalise
from cfid.drag.wind.data import WindReading
from cfid.estimate.common_causes import Effects, moved_by, with_common_causes
from cfid.findings import Finding, note
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
_NORMALISED = note(
    "drag-normalised-as-printed",
    "k1 to k6 are normalised as equation 4.10 prints it: its third term is weighted by the mean speed sum, where the "
    "mean of its square was meant; quality.normalised_squared has those too.",
    "drag.complex.normalised.*",
)


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
    again = partial(fit_each, method=method, mended=mended, intercepts=intercepts, parasitic=parasitic)
    found = fit_models(experiments, method=method, mended=mended, intercepts=intercepts, parasitic=parasitic)
    quantities = drag_quantities(found, grouping)
    fastest = Given("wind", float(experiments.wind_mps.max()), _WIND, "m/s")
    findings = (
        *found.findings,
        *([_NORMALISED] if "complex" in found.fits else []),
        *implausible_inputs([fastest], None, "drag.*"),
    )
    result = Result(
        command="fit drag",
        method=method,
        quantities=quantities,
        wanted=quantities_of(found.chosen),
        findings=findings,
        merits=drag_merits(found),
        sources=experiments.sources,
        covariances=drag_covariances(found),
        lines=tuple(drag_lines(found, quantities)),
        drawings=lambda: _drawings(found),
    )
    return with_common_causes(result, _effects(found, again))


_Again = Callable[[DragExperiments], tuple[dict[str, DragFit], list[Finding]]]


def _effects(found: DragModels, again: _Again) -> Effects:
    """Return the effect of each scale and angle of the rig on the quantities: their change in a fit `again`."""
    quantities = drag_quantities(found)

    def effect(runs: DragExperiments) -> dict[str, Array]:
        return moved_by(quantities, drag_quantities(replace(found, experiments=runs, fits=again(runs)[0])))

    return {cause: effect(runs) if cause.std else {} for cause, runs in distorted(found.experiments).items()}


def _drawings(found: DragModels) -> Figures:
    from cfid.drag.figures import drag_figures

    return {**drag_figures(found), **_of_the_rig(found.experiments)}


def _of_the_rig(runs: DragExperiments) -> Figures:
    """Draw how the vehicle was mounted, if all runs state the same."""
    from cfid.drawing.rig import load_cell_figure

    stated = {(rig.yaw_in_wind_deg, rig.wind.azimuth_deg) for rig in runs.rigs}
    yaw_deg, azimuth_deg = stated.pop() if len(stated) == 1 else (None, None)
    if yaw_deg is None:
        return {}
    angles_deg = np.unique(np.round(runs.angle_deg)).tolist()
    title = "Load cell and wind, as rig.toml and the runs state them"
    return {"drag_rig": load_cell_figure(yaw_deg, azimuth_deg=azimuth_deg, angles_deg=angles_deg, title=title)}


def drag_quantities(found: DragModels, grouping: Grouping | None = None) -> dict[str, Parameter]:
    """Return all fitted quantities, by key."""
    fits, runs = found.fits, found.experiments
    kept: dict[str, tuple[Any, Any]] = {_SIMPLE: (fits["simple"].value, fits["simple"].std)}
    if "complex" in fits:
        kept |= _complex(fits["complex"], runs)
    if "cross" in fits:
        kept[_CROSS] = fits["cross"].value, fits["cross"].std
    kept |= {f"drag.sse_n2.{name}": (fit.sse_n2, None) for name, fit in fits.items()}
    for name, fit in fits.items():
        if fit.parasitic_kg_per_m is not None:
            kept[f"drag.parasitic_kg_per_m.{name}"] = fit.parasitic_kg_per_m
        if fit.intercepts_n is not None:
            kept[f"drag.intercepts_n.{name}"] = _intercepts(fit.intercepts_n, runs), None
    if grouping is not None:
        kept["drag.groups"] = group_rows(runs, grouping), None
    return {key: Parameter(value=value, std=std, unit=unit_of(key)) for key, (value, std) in kept.items()}


def drag_covariances(found: DragModels) -> tuple[Covariance, ...]:
    """Return the covariances of the values of the simple and of the cross-coupling model."""
    fits = {key: found.fits[name] for key, name in ((_SIMPLE, "simple"), (_CROSS, "cross")) if name in found.fits}
    return tuple(
        one for key, fit in fits.items() for one in covariance_between({key: fit.value.tolist()}, fit.value_covariance)
    )


def drag_merits(found: DragModels) -> dict[str, Any]:
    """Return the figures of merit of the models."""
    runs, cross, complex_ = found.experiments, found.fits.get("cross"), found.fits.get("complex")
    sideways = "|v_xy|" if cross is not None and cross.model is CROSS_MENDED else "v_x + v_y"
    return {
        "chosen": found.chosen,
        "experiments": len(runs.command),
        "wind_settings": runs.settings,
        "mean_wind_mps": runs.wind_mps.mean(),
        "mean_speed_sum_rad_s": runs.speed_sum_rad_s.mean(),
        "kappa_4_times": sideways if cross is not None else None,
        "unresolved": () if cross is None or resolves_kappa_4(runs) else ("kappa_4",),
        "margin_nats": found.comparison.margin if found.comparison else None,
        "normalised_squared": None
        if complex_ is None
        else Dependent(_normalised(complex_.value, runs).squared, *_complex(complex_, runs)),
        "models": {name: _judged(found, fit) for name, fit in found.fits.items()},
    }


def drag_lines(found: DragModels, quantities: Mapping[str, Parameter]) -> list[str | Dependent]:
    """Return lines on how the models compare, and tables of the requested values."""
    runs = found.experiments
    lines: list[str | Dependent] = [
        f"{counted(len(runs.command), 'experiment')} in {counted(runs.settings, 'wind setting')}; squared "
        "errors of each model in N^2:"
    ]
    for name, fit in found.fits.items():
        left_out = _judged(found, fit)["left_out_sse_n2"]
        predicted = "" if left_out is None else f", {left_out:.4g} where its wind setting was left out"
        chosen = "  <- chosen" if name == found.chosen and found.comparison is not None else ""
        line = (
            f"  {name:8} {fit.sse_n2:.4g}{predicted} (condition {fit.condition:.3g}, "
            f"{fit.model.unknowns} coefficients){chosen}"
        )
        lines.append(Dependent(line, f"drag.sse_n2.{name}"))
    for key, what in (("drag.intercepts_n.simple", "constant forces of the simple model:"), ("drag.groups", "")):
        if key in quantities:
            rows = [what] * bool(what) + [_row_line(row) for row in quantities[key].value]
            lines += [Dependent(row, key) for row in rows]
    return lines


def _row_line(row: Mapping[str, float]) -> str:
    return "  " + ", ".join(f"{name} {value:.5g}" for name, value in row.items())


def _complex(fit: DragFit, runs: DragExperiments) -> dict[str, tuple[Any, Any]]:
    """Return k1 to k6, and their values normalised as in eq. 4.10, with standard uncertainties."""
    value, std = (_normalised(each, runs).thesis for each in (fit.value, fit.std))
    forms = {"": (fit.value, fit.std), "normalised.": (value, std)}
    return {
        f"drag.complex.{form}k{i + 1}": (values[i], stds[i]) for form, (values, stds) in forms.items() for i in range(6)
    }


def _normalised(coefficients: Any, runs: DragExperiments) -> Normalised:
    return normalise(coefficients, wind_mps=runs.wind_mps, speed_sum_rad_s=runs.speed_sum_rad_s)


def _intercepts(intercepts_n: Uncertain, runs: DragExperiments) -> list[dict[str, float]]:
    """Return the constant force in each wind setting, one row each."""
    first = [runs.setting.tolist().index(setting) for setting in range(runs.settings)]
    return [
        {"angle_deg": float(runs.angle_deg[row]), "wind_mps": float(runs.wind_mps[row]), "x_n": x, "y_n": y, "z_n": z}
        for row, (x, y, z) in zip(first, intercepts_n.value.tolist(), strict=True)
    ]


def _judged(found: DragModels, fit: DragFit) -> dict[str, Any]:
    predicted = found.comparison.of(fit.model) if found.comparison else None
    return {
        "condition": fit.condition,
        "degrees_of_freedom": fit.degrees_of_freedom,
        "noise_scale": fit.noise_scale,
        "surprise_nats": float(predicted.surprise.mean()) if predicted else None,
        "left_out_sse_n2": float(predicted.sse_n2.sum()) if predicted else None,
    }
