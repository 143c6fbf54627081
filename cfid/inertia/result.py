"""The inertia matrix and its axis inertias in the contract's keys, its budget and advice in words."""

from typing import TYPE_CHECKING, Any

from cfid.console.inputs import Workplace
from cfid.findings import note, rejection, warning
from cfid.inertia.swings import SwingSet
from cfid.records.covariances import covariance_between
from cfid.records.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cfid.inertia.estimation import InertiaFit
    from cfid.records.parameters import Parameter
    from cfid.swing.axis_inertias import AxisInertias

_UNIT = "kg m^2"
_MATRIX = "inertia.matrix_kg_m2"


def inertia_outcome(
    axis_inertias: "AxisInertias",
    fit: "InertiaFit",
    swings: SwingSet,
    workplace: Workplace,
    *,
    method: str,
    plan: bool,
) -> Result:
    """Return the result of `cfid fit inertia`."""
    axes = [swing.axis for swing in axis_inertias.swings]
    matrix = {_MATRIX: fit.matrix_kg_m2.tolist()}

    def drawings() -> "dict[str, Figure]":
        from cfid.inertia.figures import budget_figure

        return {"inertia": budget_figure(fit, axes=axes)}

    return Result(
        command="fit inertia",
        method=method,
        quantities=_parameters(axes, fit),
        covariances=covariance_between(matrix, fit.covariance),
        common={cause: {_MATRIX: column.tolist()} for cause, column in fit.common.items()},
        quality=_quality(axes, fit, swings),
        findings=(
            *(note("thesis-geometry", text) for text in workplace.notes),
            *(warning("inertia-warning", text) for text in (*swings.warnings, *fit.warnings, *_quirks(axis_inertias))),
            *(rejection("inertia-rejected", text, "inertia.*") for text in (*swings.doubts, *fit.doubts)),
        ),
        sources=swings.sources,
        lines=(*swings.lines, *_budget_lines(fit), *(_plan_lines(axis_inertias, axes, fit) if plan else ())),
        drawings=drawings,
        folder=workplace.figures_beside(swings.files),
    )


def _parameters(axes: list[str], fit: "InertiaFit") -> "dict[str, Parameter]":
    from cfid.records.parameters import Parameter

    spread = fit.std_kg_m2 if fit.std_kg_m2.any() else None
    found = {_MATRIX: Parameter(value=fit.matrix_kg_m2, std=spread, unit=_UNIT)}
    for name, values, deviations in (
        ("axis", fit.about_axis_kg_m2, fit.about_axis_std_kg_m2),
        ("centre", fit.about_centre_kg_m2, fit.about_centre_std_kg_m2),
    ):
        for axis in dict.fromkeys(axes):
            swung = [i for i, other in enumerate(axes) if other == axis]
            value, std = _combined(values[swung], deviations[swung])
            found[f"inertia.{name}_kg_m2.{axis}"] = Parameter(value=value, std=std or None, unit=_UNIT)
    return found


def _combined(values: Any, deviations: Any) -> tuple[float, float]:
    """Return the weighted mean of one mount's swings and its deviation.

    They share mass and geometry, which averaging does not better: the smallest deviation stands.
    """
    if not deviations.all():
        return float(values.mean()), 0.0
    return float(values @ deviations**-2.0 / (deviations**-2.0).sum()), float(deviations.min())


def _quality(axes: list[str], fit: "InertiaFit", swings: SwingSet) -> dict[str, Any]:
    import numpy as np

    return {
        "rms": None if fit.residual is None else float(np.sqrt(np.mean(fit.residual**2))),
        "chi_squared": fit.chi_squared,
        "degrees_of_freedom": fit.freedom,
        "eigenvalues_kg_m2": np.linalg.eigvalsh(fit.matrix_kg_m2),
        "consistent": fit.raw_matrix_kg_m2 is None,
        "raw_matrix_kg_m2": fit.raw_matrix_kg_m2,
        "condition": fit.condition,
        "budget_kg_m2": dict(fit.budget),
        "swings": swings.quality,
        "mounts": [
            {
                "axis": axis,
                "distance_m": fit.distance_m[i],
                "best_distance_m": fit.best_distance_m[i],
                "sensitivity_kg_m": fit.sensitivity_kg_m[i],
                "residual_in_std": None if fit.residual is None else fit.residual[i],
            }
            for i, axis in enumerate(axes)
        ],
    }


def _quirks(axis_inertias: "AxisInertias") -> tuple[str, ...]:
    """Say where a mount measures its distance along another axis than it solves the matrix with."""
    split = [
        name
        for name in dict.fromkeys(swing.axis for swing in axis_inertias.swings)
        if axis_inertias.body.mounts[name].distance_direction is not None
    ]
    return tuple(
        f"mount {name} has one direction for the distance and another for the matrix, as in the thesis: "
        "the sign of the product of inertia that rests on it is doubtful."
        for name in split
    )


def _budget_lines(fit: "InertiaFit") -> list[str]:
    import numpy as np

    if not fit.budget:
        return ["uncertainty budget: nothing given has a standard deviation"]
    lines = ["uncertainty budget, contribution to the diagonal (mean) and to the products (mean), 1e-9 kg m^2:"]
    for group, share in fit.budget.items():
        diagonal = 1e9 * np.mean(np.diag(share))
        products = 1e9 * np.mean([share[0, 1], share[0, 2], share[1, 2]])
        lines.append(f"  {group:<18}{diagonal:9.1f}{products:9.1f}")
    return lines


def _plan_lines(axis_inertias: "AxisInertias", axes: list[str], fit: "InertiaFit") -> list[str]:
    from cfid.inertia.estimation import icosahedron_axes, off_diagonal_gain

    lines = ["distances: where an error of 0.1 mm in the mount does not matter"]
    for i, axis in enumerate(axes):
        felt = 1e9 * 1e-4 * abs(fit.sensitivity_kg_m[i])
        lines.append(
            f"  {axis:<6} now {1e3 * fit.distance_m[i]:6.2f} mm (0.1 mm moves I_G by {felt:6.1f}e-9 kg m^2), "
            f"best {1e3 * fit.best_distance_m[i]:6.2f} mm"
        )
    gain = off_diagonal_gain(axis_inertias.evaluate(axis_inertias.values).direction)
    lines.append(f"axes: the six diagonals of an icosahedron make the products' deviations {100 * gain:.0f} % smaller:")
    lines += [f"  direction = [{x:+.4f}, {y:+.4f}, {z:+.4f}]" for x, y, z in icosahedron_axes()]
    return lines
