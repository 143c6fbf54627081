"""The inertia matrix and the axis inertias: swings of one body about several mounts, quantities, findings, budget."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from uncertainties import nominal_value, std_dev

from cfid.errors import FitError
from cfid.estimate.linear import weighted_mean
from cfid.findings import Finding, rejection, warning
from cfid.inertia.data import Peaks, Swing, measure
from cfid.inertia.matrix import MATRIX, InertiaFit, distances_apart, fit_inertia
from cfid.quantities.values import ENTRIES, PRODUCTS
from cfid.records.covariances import covariance_between
from cfid.records.parameters import Parameter
from cfid.records.plausibility import (
    implausible_gravity,
    implausible_inputs,
    implausible_quantities,
    platform_of,
)
from cfid.records.result import Dependent, Figures, Result
from cfid.records.rig_file import Rig
from cfid.swing.body import FIXTURE, AxisInertias, given_numbers, moment_fault, numbers, rests_on
from cfid.swing.result import Method
from cfid.swing.window import SMALLEST_PEAK_RAD

Array = npt.NDArray[np.float64]
_AXIS = "inertia.axis_kg_m2"


def fit(
    swings: Sequence[Swing],
    *,
    rig: Rig | None = None,
    mass_kg: float | None = None,
    mass_std_kg: float | None = None,
    gravity_mps2: float | None = None,
    gravity_std_mps2: float | None = None,
    peaks: Peaks = None,
    smallest_peak_rad: float = SMALLEST_PEAK_RAD,
    method: Method = "default",
) -> Result:
    """Fit the vehicle's inertia matrix to swings, each about the mount that its label names, and known axis inertias.

    A swing labelled as the fixture is that of the empty fixture, whose effect is subtracted. Mass, mounts and gravity
    are those of `rig`, else those of the campaign in which the recordings lie. `peaks` is one number for all or one for
    each mount. Where the axes do not determine a matrix, only the axis inertias are given.

    Raises ConfigError for arguments that contradict each other, and where there is no rig; DataError for a recording
    without a swing, FitError for a swing that follows no pendulum.
    """
    measured = measure(
        swings,
        body="crazyflie",
        gives=_AXIS,
        rig=rig,
        mass=(mass_kg, mass_std_kg),
        gravity=(gravity_mps2, gravity_std_mps2),
        peaks=peaks,
        smallest_peak_rad=smallest_peak_rad,
        method=method,
    )
    rig, axes, names = measured.rig, measured.axes, measured.mounts
    findings = [*measured.findings(_resting_on), *_two_directions(axes)]
    matrix: InertiaFit | None = None
    try:
        matrix = fit_inertia(axes)
    except FitError as error:
        findings += [rejection("inertia-axes-dependent", str(error), MATRIX), *distances_apart(axes)]
    else:
        findings += matrix.findings
    quantities = {} if matrix is None else {MATRIX: _matrix_parameter(matrix)}
    for key, values in ((_AXIS, axes.about_axis_kg_m2), ("inertia.centre_kg_m2", axes.about_centre_kg_m2)):
        for name in dict.fromkeys(names):
            quantities[f"{key}.{name}"] = _combined([v for v, axis in zip(values, names, strict=True) if axis == name])
    distances_m = numbers(axes.distance_m)
    findings += implausible_inputs(
        given_numbers(axes.body, filter(None, map(float, distances_m)), platform_of(rig)), rig, "inertia.*"
    )
    for name, about_axis, centre in zip(names, axes.about_axis_kg_m2, axes.about_centre_kg_m2, strict=True):
        moments = nominal_value(about_axis), nominal_value(centre), std_dev(centre)
        findings += moment_fault(name, *moments, *_resting_on(name))
    findings += [
        *implausible_quantities(quantities, rig),
        *implausible_gravity(measured.around.gravity_mps2, "inertia.*"),
    ]

    def drawings() -> Figures:
        from cfid.inertia.figures import budget_figure, example_figures, rig_figures

        if matrix is None:
            return {}
        return {
            "inertia": budget_figure(matrix, axes=names),
            **example_figures(measured.example),
            **rig_figures(axes.body, names, rig.vehicle.body_frame),
        }

    return Result(
        command="fit inertia",
        method=method,
        quantities=quantities,
        wanted=(MATRIX,),
        beside=("inertia.axis_kg_m2.*", "inertia.centre_kg_m2.*"),
        covariances=()
        if matrix is None
        else covariance_between({MATRIX: matrix.matrix_kg_m2.tolist()}, matrix.covariance),
        common={} if matrix is None else {cause: {MATRIX: moved.tolist()} for cause, moved in matrix.common.items()},
        merits={
            **({} if matrix is None else _matrix_merits(matrix)),
            "swings": measured.merits,
            "mounts": [
                {
                    "axis": name,
                    "distance_m": float(distances_m[i]),
                    "residual_in_std": None if matrix is None or matrix.residual is None else matrix.residual[i],
                }
                for i, name in enumerate(names)
            ],
        },
        findings=tuple(findings),
        sources=measured.sources,
        suspects=() if matrix is None else matrix.suspects,
        rests_on=rests_on(names),
        lines=(*measured.lines, *([] if matrix is None else _budget_lines(matrix))),
        drawings=drawings,
    )


def _resting_on(mount: str) -> tuple[str, ...]:
    """Return the quantities that rest on the swings about a mount; all rest on those of the empty fixture."""
    return ("inertia.*",) if mount == FIXTURE else (MATRIX, f"inertia.*_kg_m2.{mount}")


def _matrix_parameter(fit: InertiaFit) -> Parameter:
    return Parameter(value=fit.matrix_kg_m2, std=fit.std_kg_m2 if fit.std_kg_m2.any() else None)


def _combined(swings: Sequence[Any]) -> Parameter:
    """Return the weighted mean of one mount's swings and its standard uncertainty.

    The swings share mass and geometry, which averaging does not improve, so the smallest uncertainty stands.
    """
    values, std = np.array([[nominal_value(swing), std_dev(swing)] for swing in swings]).T
    if not std.all():
        return Parameter(value=float(values.mean()), std=None)
    return Parameter(value=float(weighted_mean(values, std=std).values[0]), std=float(std.min()))


def _matrix_merits(fit: InertiaFit) -> dict[str, Any]:
    return {
        "rms": None if fit.residual is None else float(np.sqrt(np.mean(fit.residual**2))),
        "chi_squared": fit.chi_squared,
        "degrees_of_freedom": fit.degrees_of_freedom,
        "eigenvalues_kg_m2": Dependent(np.linalg.eigvalsh(fit.matrix_kg_m2), MATRIX),
        "consistent": fit.raw_matrix_kg_m2 is None,
        "raw_matrix_kg_m2": Dependent(fit.raw_matrix_kg_m2, MATRIX),
        "condition": fit.condition,
        "budget_kg_m2": Dependent(
            [
                {"input": name, **{entry: float(share[place]) for entry, place in ENTRIES.items()}}
                for name, share in fit.budget.items()
            ],
            MATRIX,
        ),
    }


def _two_directions(axes: AxisInertias) -> Iterator[Finding]:
    """Warn of a mount whose distance is measured along another axis than the one that the matrix is solved with."""
    for name in dict.fromkeys(swing.axis for swing in axes.swings):
        if axes.body.mounts[name].distance_direction is not None:
            text = (
                f"mount {name} has one direction for the distance and another for the matrix, as in the thesis: the "
                "sign of the product of inertia that rests on it is doubtful."
            )
            yield warning("inertia-mount-two-directions", text, MATRIX)


def _budget_lines(fit: InertiaFit) -> list[Dependent]:
    if not fit.budget:
        return [Dependent("uncertainty budget: no input has a standard uncertainty", MATRIX)]
    lines = ["uncertainty budget, contribution to the diagonal (mean) and to the products (mean), 1e-9 kg m^2:"]
    for group, share in fit.budget.items():
        diagonal = 1e9 * np.mean(np.diag(share))
        products = 1e9 * np.mean([share[place] for place in PRODUCTS])
        lines.append(f"  {group:<20}{diagonal:9.1f}{products:9.1f}")
    return [Dependent(line, MATRIX) for line in lines]
