"""Friction of the swing's axis from dropped weights: quantities, findings, lines and figures."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from cfid.errors import ConfigError, DataError, check_positive
from cfid.findings import Finding, warning
from cfid.friction.drops import Drop, measure_drop, read_once
from cfid.friction.estimation import (
    COULOMB,
    KEYS,
    SETUP_INERTIA,
    VISCOUS,
    FrictionEstimate,
    fit_friction,
    thesis_friction,
)
from cfid.quantities.registry import Range
from cfid.recordings.angle import AngleRecord, AngleSource, angle_record
from cfid.recordings.gyro import SCALE_STD
from cfid.records.parameters import Parameter
from cfid.records.plausibility import (
    Given,
    implausible_gravity,
    implausible_inputs,
    implausible_quantities,
    taken_as_exact,
)
from cfid.records.result import Dependent, Figures, Result
from cfid.records.rig_file import Rig
from cfid.swing.body import rig_around, surroundings
from cfid.units import MM

_RADIUS_MM = Range(0.2, 20, "an axis in a ball bearing")
_WEIGHT_G = Range(1, 1000, "what a fishing line carries and an axis turns against")


def fit(
    drops: Sequence[AngleSource],
    *,
    rig: Rig | None = None,
    radius_m: float | None = None,
    radius_std_m: float | None = None,
    gravity_mps2: float | None = None,
    gravity_std_mps2: float | None = None,
    from_s: float | None = None,
    to_s: float | None = None,
    method: Literal["default", "thesis"] = "default",
) -> Result:
    """Fit the friction of the swing's axis to weights dropped on a line wound around it; labels state the grams.

    The radius is that of the line's middle. Where radius or gravity is not given, it is that of `rig`, else that of the
    campaign in which the recordings lie. The window of steady speed is found; `from_s` and `to_s`, in
    seconds since the first sample, set it by hand.

    Raises ConfigError for a radius that is not known, or that is zero or less, DataError for a recording without a
    weight, or where none can be followed: the weight turns nothing, or the axis' turns cannot be counted.
    """
    check_positive(radius_m=radius_m, gravity_mps2=gravity_mps2)
    records = [angle_record(drop) for drop in drops]
    rig = rig_around(records, rig)
    around = surroundings(rig, gravity_mps2, gravity_std_mps2)
    gravity_mps2, gravity_std_mps2 = around.gravity_mps2, around.gravity_std_mps2
    if radius_m is None:
        radius_m, radius_std_m, notes = _lever_m(rig, thesis=method == "thesis")
    else:
        exact = () if radius_std_m is not None else (taken_as_exact("radius", *KEYS),)
        notes = (*exact, *_line_not_added(rig))
    if method == "default" and any(record.label.weight_std_g is None for record in records):
        notes += (taken_as_exact("weight", *KEYS),)
    setup = {"radius_m": radius_m, "gravity_mps2": gravity_mps2, "from_s": from_s, "to_s": to_s}
    followed, measured, of_drops = _followed(records, setup)
    if method == "thesis":
        found = thesis_friction(measured)
    else:
        found = fit_friction(
            measured,
            radius_m=radius_m,
            radius_std_m=radius_std_m or 0.0,
            gravity_mps2=gravity_mps2,
            gravity_std_mps2=gravity_std_mps2,
            speed_scale_std=SCALE_STD if any(record.rates is not None for record in records) else 0.0,
        )
    quantities = _quantities(found, measured)
    unsettled = [record for record, drop in zip(followed, measured, strict=True) if not drop.settled]

    def drawings() -> Figures:
        from cfid.friction.figures import drops_figure, friction_figure

        labels = [f"{1000 * d.weight_kg:g} g, {r.name}" for d, r in zip(measured, followed, strict=True)]
        figures = {"friction_runs": drops_figure(measured, labels=labels)}
        if len(unsettled) < len(measured):
            figures["friction"] = friction_figure(measured, found, radius_m=radius_m, gravity_mps2=gravity_mps2)
        return figures

    return Result(
        command="fit friction",
        method=method,
        quantities=quantities,
        wanted=(VISCOUS, COULOMB),
        merits={"settled": len(measured) - len(unsettled), "left_out": len(records) - len(measured) + len(unsettled)},
        findings=(
            *notes,
            *(finding for record in records for finding in record.findings),
            *found.findings,
            *implausible_inputs(_given_numbers(radius_m, measured), rig, "friction.*"),
            *implausible_quantities(quantities, rig),
            *implausible_gravity(gravity_mps2, "friction.*"),
            *(
                warning("friction-drop-left-out", "the speed never settles; it is left out.").at(record.name)
                for record in unsettled
            ),
            *of_drops,
        ),
        sources=tuple(record.source for record in records),
        rests_on=("site", "friction"),
        lines=tuple(Dependent(_line(drop), "friction.runs") for drop in measured),
        drawings=drawings,
    )


def _lever_m(rig: Rig | None, *, thesis: bool) -> tuple[float, float, tuple[Finding, ...]]:
    """Return the radius at which the line pulls, its standard uncertainty, and a warning if no thickness is stated.

    The thesis method takes the radius of the axis.
    """
    axis = None if rig is None else rig.friction
    if axis is None:
        unknown = None if rig is None else rig.unknown("friction")
        remedy = unknown or "add [friction] to rig.toml, or give the radius, or `geometry` thesis."
        raise ConfigError(f"the radius of the axis is not known: {remedy}")
    if thesis:
        return MM * axis.radius_mm, MM * axis.radius_std_mm, ()
    found: tuple[Finding, ...] = ()
    if axis.line_mm is None:
        text = (
            "rig.toml states no thickness of the line, and none is added to the radius: a line of 0.2 mm makes "
            f"friction {100 * 0.1 / axis.radius_mm:.0f} % larger. Add line_mm and line_std_mm to [friction]; 0 where "
            "radius_mm is that of the line's middle."
        )
        found = (warning("friction-line-unknown", text, *KEYS),)
    return MM * axis.lever_mm, MM * axis.lever_std_mm, found


def _line_not_added(rig: Rig | None) -> tuple[Finding, ...]:
    """Return a warning that rig.toml's thickness of the line is not added to a given radius, which contains it."""
    if rig is None or rig.friction is None or not rig.friction.line_mm:
        return ()
    text = (
        f"the given radius is taken as that of the line's middle: half of rig.toml's line_mm, "
        f"{rig.friction.line_mm / 2:g} mm, is not added."
    )
    return (warning("friction-line-not-added", text, *KEYS),)


def _given_numbers(radius_m: float, drops: Sequence[Drop]) -> list[Given]:
    """Return the radius and the weights with their plausible ranges."""
    weights = dict.fromkeys(1000 * drop.weight_kg for drop in drops)
    return [
        Given("radius", radius_m / MM, _RADIUS_MM, "mm"),
        *(Given("weight", one, _WEIGHT_G, "g") for one in weights),
    ]


def _followed(
    records: Sequence[AngleRecord], setup: Mapping[str, Any]
) -> tuple[list[AngleRecord], list[Drop], list[Finding]]:
    """Return the records whose fall can be followed, their drops, and findings on the rows and on the other records.

    Raises DataError for a record without a weight, and where no fall can be followed.
    """
    followed, drops, findings = list[AngleRecord](), list[Drop](), list[Finding]()
    fault = ""
    for record in records:
        weight_g, std_g = record.label.weight_g, record.label.weight_std_g or 0.0
        if weight_g is None:
            raise DataError(f"{record.name}: does not state its weight in grams: name it, as in 20={record.name}.")
        weight = {"weight_kg": weight_g / 1000, "weight_std_kg": std_g / 1000}
        time_s, angle_rad, shown = read_once(record.time_s, record.angle_rad)
        findings += [finding.at(record.name) for finding in shown]
        try:
            drops.append(measure_drop(time_s, angle_rad, **weight, **setup))
        except DataError as error:
            fault = fault or f"{record.path}: {error}"
            findings.append(warning("friction-drop-left-out", f"{error} It is left out.").at(record.name))
        else:
            followed.append(record)
    if fault and not followed:
        raise DataError(fault)
    return followed, drops, findings


def _line(drop: Drop) -> str:
    line = (
        f"{1000 * drop.weight_kg:5g} g: {drop.speed_rad_per_s:6.1f} rad/s from {drop.from_s:.2f} to {drop.to_s:.2f} s, "
    )
    if not drop.settled:
        return line + "never settles"
    return line + f"{drop.coefficient_nms_per_rad:.4g} N m s/rad, tends to {drop.terminal_rad_per_s:.1f}"


def _quantities(found: FrictionEstimate, drops: Sequence[Drop]) -> dict[str, Parameter]:
    return {
        VISCOUS: Parameter(value=found.viscous_nms_per_rad, std=found.viscous_std),
        COULOMB: Parameter(value=found.coulomb_nm, std=found.coulomb_std),
        SETUP_INERTIA: Parameter(value=found.setup_inertia_kg_m2, std=found.setup_inertia_std),
        "friction.runs": Parameter(value=[_row(drop) for drop in drops]),
    }


def _row(drop: Drop) -> dict[str, Any]:
    return {
        "weight_g": 1000 * drop.weight_kg,
        "settled": drop.settled,
        "speed_rad_per_s": drop.speed_rad_per_s,
        "speed_std_rad_per_s": drop.speed_std_rad_per_s,
        "terminal_rad_per_s": drop.terminal_rad_per_s if drop.settled else None,
        "coefficient_nms_per_rad": drop.coefficient_nms_per_rad if drop.settled else None,
        "from_s": drop.from_s,
        "to_s": drop.to_s,
        "time_constant_s": drop.time_constant_s if drop.settled else None,
    }
