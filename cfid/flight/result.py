"""Collect what flights show of a vehicle: quantities, findings, and lines on what was assumed and excited."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase

from cfid.errors import ConfigError, DataError
from cfid.estimate.common_causes import power_law, with_common_causes
from cfid.findings import Finding, warning
from cfid.flight.battery import with_whole_sag
from cfid.flight.braking import AxisDrag, fit_drag
from cfid.flight.channels import same_flight
from cfid.flight.data import FlownLog
from cfid.flight.estimation import FlightFit, fit_flights
from cfid.flight.excitation import refuse_still
from cfid.flight.findings import findings_of
from cfid.flight.rows import LEVER
from cfid.flight.turning import turning_findings
from cfid.flight.values import (
    Body,
    causes_of,
    covariances_of,
    drag_quantities,
    given,
    quantities_of,
    rescaled_thrust,
)
from cfid.recordings.read import description
from cfid.records.parameters import Parameter
from cfid.records.result import Dependent, Figures, Result

_RESTS_ON = ("vehicle.mass_kg", "vehicle.mass_std_kg", "loadcell.arm_mm", "loadcell.arm_std_mm")
_DRAG_AXES = ("forward", "left")


def fit(flights: Sequence[FlownLog], *, body: Body) -> Result:
    """Fit thrust, lag, moments of inertia and drag of one vehicle to its flights, as far as these determine them.

    A flight whose gyro contradicts its attitude is left out where others remain.

    Raises ConfigError for no flight, DataError for a flight given twice or with drives in other units, and FitError
    where nothing flew for long enough, or rotors explain too little for any of these quantities.
    """
    _check(flights)
    flights, left_out = _alike(flights)
    if all(one.flight.velocity is None for one in flights):  # else drag may be determined
        refuse_still([one.flight for one in flights])
    found = fit_flights([one.flight for one in flights])
    whole, of_voltage = with_whole_sag(flights, found)
    if of_voltage:
        flights, found = whole, fit_flights([one.flight for one in whole])
    drags = {name: fit_drag([one.flight for one in flights], axis=axis) for axis, name in enumerate(_DRAG_AXES)}
    measured = {**quantities_of(found, body), **drag_quantities(drags, body)}
    quantities = {**measured, **given(body)}
    findings = (
        *left_out,
        *of_voltage,
        *(finding for one in flights for finding in one.findings),
        *findings_of(flights, found, drags, measured, body),
    )
    name = flights[0].flight.name

    def drawings() -> Figures:
        from cfid.flight.figures import flight_figure

        return {f"fit_flight_{name}": flight_figure(found, drags, findings, title=", ".join(map(_name, flights)))}

    result = Result(
        command="fit flight",
        method="default",
        quantities=quantities,
        wanted=_wanted(measured, findings),
        findings=findings,
        merits={
            "rows": found.rows,
            "explained_vertical": found.explained,
            "excitation": dict(found.excitation),
            "drag_explained": {axis: one.explained for axis, one in drags.items() if one is not None},
        },
        sources=tuple(one.log.source for one in flights),
        rests_on=_RESTS_ON,
        covariances=covariances_of(found, body),
        lines=(*_lines(flights, found, drags), *_assumptions(flights, body)),
        drawings=drawings,
    )
    rescaled = any(one.flight.rescaled for one in flights)
    scales = power_law(quantities, *causes_of(body, in_volts=found.in_volts, rescaled=rescaled))
    return with_common_causes(result, scales, *([rescaled_thrust(found, body)] if rescaled else []))


def _check(flights: Sequence[FlownLog]) -> None:
    if not flights:
        raise ConfigError("nothing to fit: give a LOG of a flight.")
    for place, one in enumerate(flights):
        for before in flights[:place]:
            if one.log.source.sha256 == before.log.source.sha256 or same_flight(one.log, before.log):
                raise DataError(f"{one.log.path}: the same flight as {before.log.path.name}: name each once.")
        if one.flight.in_volts != flights[0].flight.in_volts:
            raise DataError(f"{one.log.path}: only some of the logs have the battery's voltage: fit them apart.")


def _alike(flights: Sequence[FlownLog]) -> tuple[Sequence[FlownLog], list[Finding]]:
    """Leave out flights whose gyro contradicts their attitude, if others remain; return the others and the findings."""
    unlike = {place: found for place, one in enumerate(flights) if (found := turning_findings(one.flight))}
    if len(unlike) == len(flights):
        return flights, []
    reasons = [
        replace(warning("flight-left-out", f"{one.sentence} It is left out."), where=one.where)
        for found in unlike.values()
        for one in found
    ]
    return [one for place, one in enumerate(flights) if place not in unlike], reasons


def _name(one: FlownLog) -> str:
    return one.flight.name


def _wanted(quantities: Mapping[str, Parameter], findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return the keys that the flights determine; all keys where they determine none."""
    lost = [key for one in findings if one.severity == "rejection" for key in one.quantities]
    return tuple(key for key in quantities if not any(fnmatchcase(key, one) for one in lost)) or tuple(quantities)


def _lines(
    flights: Sequence[FlownLog], found: FlightFit, drags: Mapping[str, AxisDrag | None]
) -> list[str | Dependent]:
    excited = [
        f"{name} {value:.2g} {'m/s^2' if name == 'vertical' else 'rad/s^2'}" for name, value in found.excitation.items()
    ]
    moved = [f"{axis} {one.speed:.2g} m/s" for axis, one in drags.items() if one is not None]
    low, high = found.drive_range
    unit = " V" if found.in_volts else ""
    return [
        *(description(one.log) for one in flights),
        *(
            f"{one.flight.name}: {one.in_air_s:.1f} s in the air, {one.driven_s:.1f} s of it with every motor within "
            "its range"
            for one in flights
        ),
        f"excited, root mean square: {', '.join([*excited, *moved])}",
        f"drives from {low:.3g} to {high:.3g}{unit}, {found.drive:.3g}{unit} in the mean; thrust holds between these",
    ]


def _assumptions(flights: Sequence[FlownLog], body: Body) -> list[str]:
    arm = "" if body.arm_m is None else f", {1e3 * LEVER * body.arm_m:.4g} mm from the axes forward and left"
    scale = "exact"
    if any(one.flight.rescaled for one in flights):
        scale = f"to {100 * body.rescaled_std:g} % (a Crazyflie divides by what it shows at rest)"
    return [
        "assumed: axes forward, left, up; four alike rotors on a square, with thrust along z"
        + arm
        + f"; mass {1e3 * body.mass_kg:g} g; "
        f"times of gyro and accelerometer and the former's scale exact, the latter's {scale}, and its zero to 0.02 g; "
        "no climb in the mean; sensors show thrust a delay later",
    ]
