"""The inertia matrix and the axis inertias: quantities, findings, budget and mounting advice."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.errors import FitError
from cfid.estimate.linear import weighted_mean
from cfid.findings import Finding, note, rejection, warning
from cfid.inertia.data import MeasuredSwings, Peaks, Swing, measure, records_of
from cfid.inertia.directions import icosahedron_axes, off_diagonal_gain
from cfid.inertia.estimation import MATRIX, InertiaFit, MeasuredAxes, fit_inertia, measure_axes
from cfid.inertia.redundancy import distance_findings, redundancy_findings, suspects
from cfid.inertia.sensitivities import moved_by_inputs
from cfid.quantities.values import PRODUCTS
from cfid.recordings.angle import AxisRecord
from cfid.records.covariances import Covariance, covariance_between
from cfid.records.parameters import Parameter
from cfid.records.plausibility import implausible_gravity, implausible_inputs, implausible_quantities, platform_of
from cfid.records.result import Dependent, Figures, Result
from cfid.records.rig_file import BodyFrame, Rig
from cfid.swing.axis_inertias import AxisInertias, SwungBody
from cfid.swing.data import FIXTURE, check_mounts, rests_on, rig_or_thesis, surroundings, turned_about, vehicle
from cfid.swing.plausibility import given_numbers, moment_fault
from cfid.swing.release import SMALLEST_PEAK_RAD
from cfid.swing.result import Method

Array = npt.NDArray[np.float64]

_AXIS = "inertia.axis_kg_m2"
_GRAM_KG, _FIXTURE_M = 1e-3, 2e-3


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
    propose: bool = False,
) -> Result:
    """Fit the vehicle's inertia matrix to swings, each about the mount that its label names, and known axis inertias.

    A swing labelled as the fixture is that of the empty fixture, whose effect is subtracted. Mass, mounts and gravity
    are those of `rig`, else those of the campaign in which the recordings lie, else the thesis'. `peaks` is one number
    for all or one for each mount. `propose` adds distances and axes for the next swings to the lines. Where the axes do
    not determine a matrix, only the axis inertias are given.

    Raises ConfigError for arguments that contradict each other, DataError for a recording without a swing, FitError for
    a swing that follows no pendulum.
    """
    given = records_of(swings)
    rig, notes = rig_or_thesis([swing for swing in given if isinstance(swing, AxisRecord)], rig)
    body = vehicle(rig, mass_kg, mass_std_kg)
    measured = measure(
        given,
        body="crazyflie",
        mounts=body.mounts,
        gravity_mps2=rig.site.gravity_mps2 if gravity_mps2 is None else gravity_mps2,
        gives=_AXIS,
        peaks=peaks,
        smallest_peak_rad=smallest_peak_rad,
        method=method,
    )
    body, directions = turned_about(body, measured.records)
    measured = replace(measured, found=(*measured.found, *directions))
    check_mounts((swing.axis for swing in measured.mounted), body.mounts, table="mounts")
    around = surroundings(rig, gravity_mps2, gravity_std_mps2, measured.fixture)
    axis_inertias = AxisInertias(measured.mounted, body, around)
    matrix, of_matrix = _matrix_of(axis_inertias)
    about = measure_axes(axis_inertias) if matrix is None else matrix.axes
    axes = [swing.axis for swing in measured.mounted]
    quantities = _quantities(axes, about, matrix)
    findings = [
        *notes,
        *measured.findings(_resting_on),
        *_two_directions(axis_inertias),
        *of_matrix,
        *_neglected_fixture(axis_inertias, about),
        *_body_findings(body, axes, about, rig),
        *implausible_quantities(quantities, rig),
        *implausible_gravity(around.gravity_mps2, "inertia.*"),
    ]

    def drawings() -> Figures:
        from cfid.inertia.figures import budget_figure

        if matrix is None:
            return {}
        return {"inertia": budget_figure(matrix, axes=axes), **_of_the_rig(body, axes, rig.vehicle.body_frame)}

    covariances: tuple[Covariance, ...] = ()
    common = {}
    if matrix is not None:
        covariances = covariance_between({MATRIX: matrix.matrix_kg_m2.tolist()}, matrix.covariance)
        common = {cause: {MATRIX: column.tolist()} for cause, column in matrix.common.items()}
    return Result(
        command="fit inertia",
        method=method,
        quantities=quantities,
        wanted=(MATRIX,),
        covariances=covariances,
        common=common,
        merits=_merits(axes, about, matrix, measured),
        findings=tuple(findings),
        sources=measured.sources,
        suspects=() if matrix is None else suspects(axis_inertias, matrix).names,
        rests_on=rests_on(axes),
        lines=(
            *measured.lines,
            *_budget_lines(matrix),
            *(_proposals(axis_inertias, axes, about, matrix is not None) if propose else ()),
        ),
        drawings=drawings,
    )


def _matrix_of(axis_inertias: AxisInertias) -> tuple[InertiaFit | None, list[Finding]]:
    """Return the inertia matrix with its findings, None where the axes do not determine one."""
    try:
        matrix = fit_inertia(axis_inertias)
    except FitError as error:
        apart = distance_findings(axis_inertias, moved_by_inputs(axis_inertias))
        return None, [rejection("inertia-axes-dependent", str(error), MATRIX), *apart]
    return matrix, [*matrix.findings, *redundancy_findings(axis_inertias, matrix)]


def _of_the_rig(body: SwungBody, axes: Sequence[str], frame: BodyFrame) -> Figures:
    """Draw the axes about which the body swung; a pair of threads has no axis."""
    from cfid.drawing.rig import mounts_figure

    mounts = {axis: body.mounts[axis] for axis in axes if axis in body.mounts}
    hung = {axis: mount for axis, mount in mounts.items() if mount.threads is None}
    title = "Axes of the swings, as rig.toml states them"
    return {"inertia_mounts": mounts_figure(hung, frame, title=title)} if hung else {}


def _neglected_fixture(axis_inertias: AxisInertias, about: MeasuredAxes) -> list[Finding]:
    """Return a note on the effect of a fixture that rig.toml does not describe."""
    swung = [i for i, swing in enumerate(axis_inertias.swings) if not swing.known and about.distance_m[i]]
    if axis_inertias.surroundings.fixture is not None or not swung:
        return []
    frequency = np.array([axis_inertias.swings[i].value for i in swung])
    moment = _GRAM_KG * axis_inertias.surroundings.gravity_mps2 * _FIXTURE_M
    low = float(np.mean(moment / frequency / np.abs(about.about_centre_kg_m2[swung])))
    text = (
        "rig.toml describes no fixture, so that cube and axis are neglected: each gram of them, 2 mm from the axis on "
        f"the body's side, makes the inertias about {100 * low:.1f} % too low. Add [fixture], and swing it alone "
        "(fixture=FILE)."
    )
    return [note("inertia-fixture-neglected", text, "inertia.*")]


def _body_findings(body: SwungBody, axes: list[str], about: MeasuredAxes, rig: Rig) -> list[Finding]:
    """Reject values that no body, or no vehicle of the platform, can have."""
    distances_m = filter(None, map(float, about.distance_m))
    moments = zip(axes, about.about_axis_kg_m2, about.about_centre_kg_m2, about.about_centre_std_kg_m2, strict=True)
    return [
        *implausible_inputs(given_numbers(body, distances_m, platform_of(rig)), rig, "inertia.*"),
        *(
            finding
            for axis, around, centre, std in moments
            for finding in moment_fault(axis, float(around), float(centre), float(std), *_resting_on(axis))
        ),
    ]


def _resting_on(mount: str) -> tuple[str, ...]:
    """Return the quantities that rest on the swings about a mount; all rest on those of the empty fixture."""
    return ("inertia.*",) if mount == FIXTURE else (MATRIX, f"inertia.*_kg_m2.{mount}")


def _quantities(axes: list[str], measured: MeasuredAxes, fit: InertiaFit | None) -> dict[str, Parameter]:
    found = {}
    if fit is not None:
        spread = fit.std_kg_m2 if fit.std_kg_m2.any() else None
        found[MATRIX] = Parameter(value=fit.matrix_kg_m2, std=spread)
    for name, values, std in (
        ("axis", measured.about_axis_kg_m2, measured.about_axis_std_kg_m2),
        ("centre", measured.about_centre_kg_m2, measured.about_centre_std_kg_m2),
    ):
        for axis in dict.fromkeys(axes):
            own = [i for i, other in enumerate(axes) if other == axis]
            mean, mean_std = _combined(values[own], std[own])
            found[f"inertia.{name}_kg_m2.{axis}"] = Parameter(value=mean, std=mean_std or None)
    return found


def _combined(values: Array, std: Array) -> tuple[float, float]:
    """Return the weighted mean of one mount's swings and its standard uncertainty.

    The swings share mass and geometry, which averaging does not improve, so the smallest uncertainty stands.
    """
    if not std.all():
        return float(values.mean()), 0.0
    return float(weighted_mean(values, std=std).values[0]), float(std.min())


def _merits(axes: list[str], measured: MeasuredAxes, fit: InertiaFit | None, swings: MeasuredSwings) -> dict[str, Any]:
    residual = None if fit is None else fit.residual
    return {
        **({} if fit is None else _matrix_merits(fit)),
        "swings": swings.merits,
        "mounts": [
            {
                "axis": axis,
                "distance_m": measured.distance_m[i],
                "best_distance_m": Dependent(measured.best_distance_m[i], f"inertia.centre_kg_m2.{axis}"),
                "sensitivity_kg_m": Dependent(measured.sensitivity_kg_m[i], f"inertia.centre_kg_m2.{axis}"),
                "residual_in_std": None if residual is None else residual[i],
            }
            for i, axis in enumerate(axes)
        ],
    }


def _matrix_merits(fit: InertiaFit) -> dict[str, Any]:
    return {
        "rms": None if fit.residual is None else float(np.sqrt(np.mean(fit.residual**2))),
        "chi_squared": fit.chi_squared,
        "degrees_of_freedom": fit.degrees_of_freedom,
        "eigenvalues_kg_m2": Dependent(np.linalg.eigvalsh(fit.matrix_kg_m2), MATRIX),
        "consistent": fit.raw_matrix_kg_m2 is None,
        "raw_matrix_kg_m2": Dependent(fit.raw_matrix_kg_m2, MATRIX),
        "condition": fit.condition,
        "budget_kg_m2": Dependent(dict(fit.budget), MATRIX),
    }


def _two_directions(axis_inertias: AxisInertias) -> list[Finding]:
    """Warn of a mount whose distance is measured along another axis than the one that the matrix is solved with."""
    split = [
        name
        for name in dict.fromkeys(swing.axis for swing in axis_inertias.swings)
        if axis_inertias.body.mounts[name].distance_direction is not None
    ]
    text = (
        "mount {} has one direction for the distance and another for the matrix, as in the thesis: the sign of the "
        "product of inertia that rests on it is doubtful."
    )
    return [warning("inertia-mount-two-directions", text.format(name), MATRIX) for name in split]


def _budget_lines(fit: InertiaFit | None) -> list[Dependent]:
    if fit is None:
        return []
    if not fit.budget:
        return [Dependent("uncertainty budget: no input has a standard uncertainty", MATRIX)]
    lines = ["uncertainty budget, contribution to the diagonal (mean) and to the products (mean), 1e-9 kg m^2:"]
    for group, share in fit.budget.items():
        diagonal = 1e9 * np.mean(np.diag(share))
        products = 1e9 * np.mean([share[place] for place in PRODUCTS])
        lines.append(f"  {group:<18}{diagonal:9.1f}{products:9.1f}")
    return [Dependent(line, MATRIX) for line in lines]


def _proposals(
    axis_inertias: AxisInertias, axes: list[str], measured: MeasuredAxes, determined: bool
) -> list[str | Dependent]:
    lines: list[str | Dependent] = ["distances: where an error of 0.1 mm in the mount does not matter"]
    for i, axis in enumerate(axes):
        if not measured.distance_m[i]:  # on threads
            continue
        felt = 1e9 * 1e-4 * abs(measured.sensitivity_kg_m[i])
        line = (
            f"  {axis:<6} now {1e3 * measured.distance_m[i]:6.2f} mm (0.1 mm moves I_G by {felt:6.1f}e-9 kg m^2), "
            f"best {1e3 * measured.best_distance_m[i]:6.2f} mm"
        )
        lines.append(Dependent(line, f"inertia.centre_kg_m2.{axis}"))
    better = "axes: the six diagonals of an icosahedron determine all entries equally well"
    lines.append(f"{better}:")
    if determined:
        gain = off_diagonal_gain(axis_inertias.evaluate(axis_inertias.values).direction)
        smaller = f"{better}; the products' standard uncertainties become {100 * gain:.0f} % smaller:"
        lines[-1] = Dependent(smaller, MATRIX, instead=f"{better}:")
    lines += [f"  direction = [{x:+.4f}, {y:+.4f}, {z:+.4f}]" for x, y, z in icosahedron_axes()]
    return lines
