"""Drag as `cfid fit drag` tells it: parameters of the contract, lines, and the figures that judge the models."""

from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from cfid.drag.estimation import DragFit
    from cfid.drag.experiments import DragExperiments
    from cfid.drag.normalisation import Normalised
    from cfid.drag.selection import DragResult
    from cfid.records.covariances import Covariance
    from cfid.records.parameters import Parameter

Grouping = Literal["each", "lateral", "command", "wind", "angle"]

NORMALISED = (
    "normalised as equation 4.10 prints it: its third term is weighted by the mean speed sum, where the mean of its "
    "square was meant; --json has those too (quality.normalised_squared)."
)

_UNITS = ("kg/rad", "kg/m", "N s^2/rad^2", "kg/s", "N s/rad", "N")


def drag_parameters(found: "DragResult", grouping: Grouping | None) -> "dict[str, Parameter]":
    """Return all that was found, by the contract's keys."""
    from cfid.records.parameters import Parameter

    kept = {
        "drag.simple_kg_per_rad": Parameter(
            value=found.simple_kg_per_rad, std=found.simple_std_kg_per_rad, unit=_UNITS[0]
        )
    }
    if found.complex_ is not None:
        kept |= _complex(found.complex_, found.experiments)
    if found.cross is not None:
        fit = found.cross.fit
        kept["drag.cross_coupling_kg_per_rad"] = Parameter(value=fit.value, std=fit.std, unit=_UNITS[0])
    kept |= {f"drag.sse_n2.{name}": Parameter(value=value, unit="N^2") for name, value in found.sse_n2.items()}
    for name, fit in found.fits.items():
        kept |= _beside(name, fit, found.experiments)
    if grouping is not None and found.groups is not None:
        kept["drag.groups"] = Parameter(value=group_rows(found, grouping), unit="as named")
    return kept


def drag_covariances(found: "DragResult") -> "tuple[Covariance, ...]":
    """Return the covariances of the simple and of the cross-coupling model's numbers."""
    from cfid.records.covariances import covariance_between

    simple = {"drag.simple_kg_per_rad": found.simple_kg_per_rad.tolist()}
    if found.cross is None:
        return covariance_between(simple, found.simple_covariance)
    fit = found.cross.fit
    cross = {"drag.cross_coupling_kg_per_rad": fit.value.tolist()}
    return covariance_between(simple, found.simple_covariance) + covariance_between(cross, fit.value_covariance)


def group_rows(found: "DragResult", grouping: Grouping) -> list[dict[str, Any]]:
    """Return coefficients of the simple model in one of the groupings of C.3.1, a row each."""
    groups, runs = found.groups, found.experiments
    assert groups is not None
    if grouping not in ("each", "lateral"):
        chosen = {"command": groups.by_command, "wind": groups.by_wind, "angle": groups.by_angle}[grouping]
        return [{name: value for name, value in group._asdict().items() if value is not None} for group in chosen]
    places = zip(runs.angle_deg.tolist(), runs.command.tolist(), runs.wind_mps.tolist(), strict=True)
    settings = [{"angle_deg": angle, "command": command, "wind_mps": wind} for angle, command, wind in places]
    if grouping == "lateral":
        return [{**at, "kg_per_rad": value} for at, value in zip(settings, groups.lateral.tolist(), strict=True)]
    axes = ("x_kg_per_rad", "y_kg_per_rad", "z_kg_per_rad")
    return [{**at, **dict(zip(axes, row, strict=True))} for at, row in zip(settings, groups.each.tolist(), strict=True)]


def drag_quality(found: "DragResult") -> dict[str, Any]:
    """Return what judges the models."""
    runs, compared = found.experiments, found.comparison
    return {
        "chosen": next(name for name, fit in found.fits.items() if fit is found.chosen),
        "experiments": len(runs.command),
        "wind_settings": runs.settings,
        "mean_wind_mps": runs.wind_mps.mean(),
        "mean_speed_sum_rad_s": runs.speed_sum_rad_s.mean(),
        "kappa_4_times": _sideways(found),
        "unresolved": found.cross.unresolved if found.cross else (),
        "margin_nats": compared.margin if compared else None,
        "normalised_squared": _normalised(found.complex_.value, runs).squared if found.complex_ else None,
        "models": {name: _judged(found, fit) for name, fit in found.fits.items()},
    }


def drag_lines(found: "DragResult", grouping: Grouping | None) -> list[str]:
    """Return for a person how the models compare, and the groups that were asked for."""
    runs = found.experiments
    lines = [f"{len(runs.command)} experiments in {runs.settings} winds; what the models leave, in N^2:"]
    for name, fit in found.fits.items():
        judged = _judged(found, fit)
        left_out = judged["left_out_sse_n2"]
        predicted = "" if left_out is None else f", {left_out:.4g} where its wind was left out"
        chosen = "  <- chosen" if fit is found.chosen and found.comparison is not None else ""
        lines.append(
            f"  {name:8} {found.sse_n2[name]:.4g}{predicted} (condition {fit.condition:.3g}, "
            f"{fit.model.unknowns} coefficients){chosen}"
        )
    if found.complex_ is not None:
        lines.append(NORMALISED)
    if found.simple.intercepts_n is not None:
        lines.append("constant forces beside the simple model:")
        lines += [_row_line(row) for row in _intercepts(found.simple.intercepts_n, runs)]
    if grouping is not None and found.groups is not None:
        lines += [_row_line(row) for row in group_rows(found, grouping)]
    return lines


def _sideways(found: "DragResult") -> str | None:
    """Return what kappa_4 multiplies beside the sum of rotor speeds."""
    if found.cross is None:
        return None
    return "|v_xy|" if found.cross.mended else "v_x + v_y"


def _complex(fit: "DragFit", runs: "DragExperiments") -> "dict[str, Parameter]":
    """Return k1 to k6, and normalised as printed in eq. 4.10."""
    from cfid.records.parameters import Parameter

    value, std = (_normalised(each, runs).thesis for each in (fit.value, fit.std))
    forms = {"": (fit.value, fit.std, _UNITS), "normalised.": (value, std, ("",) * 6)}
    return {
        f"drag.complex.{form}k{i + 1}": Parameter(value=values[i], std=deviations[i], unit=units[i])
        for form, (values, deviations, units) in forms.items()
        for i in range(6)
    }


def _normalised(coefficients: Any, runs: "DragExperiments") -> "Normalised":
    from cfid.drag.normalisation import normalise

    return normalise(coefficients, wind_mps=runs.wind_mps, speed_sum_rad_s=runs.speed_sum_rad_s)


def _beside(name: str, fit: "DragFit", runs: "DragExperiments") -> "dict[str, Parameter]":
    """Return what was fitted beside a model's own coefficients."""
    from cfid.records.parameters import Parameter

    kept = {}
    if fit.parasitic_kg_per_m is not None:
        kept[f"drag.parasitic_kg_per_m.{name}"] = Parameter(
            value=fit.parasitic_kg_per_m, std=fit.parasitic_std_kg_per_m, unit="kg/m"
        )
    if fit.intercepts_n is not None:
        kept[f"drag.intercepts_n.{name}"] = Parameter(value=_intercepts(fit.intercepts_n, runs), unit="as named")
    return kept


def _intercepts(intercepts_n: Any, runs: "DragExperiments") -> list[dict[str, float]]:
    """Return the constant force in each wind, a row each."""
    first = [runs.setting.tolist().index(setting) for setting in range(runs.settings)]
    return [
        {"angle_deg": float(runs.angle_deg[row]), "wind_mps": float(runs.wind_mps[row]), "x_n": x, "y_n": y, "z_n": z}
        for row, (x, y, z) in zip(first, intercepts_n.tolist(), strict=True)
    ]


def _judged(found: "DragResult", fit: "DragFit") -> dict[str, Any]:
    tried = [one for one in (found.comparison.candidates if found.comparison else ()) if one.model is fit.model]
    return {
        "condition": fit.condition,
        "degrees_of_freedom": fit.freedom,
        "noise_scale": fit.noise_scale,
        "surprise_nats": float(tried[0].surprise.mean()) if tried else None,
        "left_out_sse_n2": float(tried[0].left_out_sse_n2.sum()) if tried else None,
        "doubts": fit.doubts,
    }


def _row_line(row: dict[str, Any]) -> str:
    return "  " + ", ".join(f"{name} {value:.5g}" for name, value in row.items())
