"""Collect what flights show of a vehicle: quantities, findings, and lines on what was assumed and excited."""

from collections.abc import Mapping, Sequence

from cfid.errors import ConfigError, DataError
from cfid.estimate.common_causes import power_law, with_common_causes
from cfid.flight.braking import AxisDrag, fit_drag
from cfid.flight.data import FlownLog, same_flight
from cfid.flight.estimation import FlightFit, fit_flights, refuse_still
from cfid.flight.findings import determined, findings_of
from cfid.flight.rows import ROW_S
from cfid.flight.speed_result import of_speeds
from cfid.flight.supply import with_usable_voltages
from cfid.flight.values import RESTS_ON, Body, causes_of, covariances_of, given, quantities_of, rescaled_thrust
from cfid.recordings.read import description
from cfid.records.result import Dependent, Figures, Result

_DRAG_AXES = ("forward", "left")


def fit(flights: Sequence[FlownLog], *, body: Body) -> Result:
    """Fit thrust, lag, moments of inertia and drag of one vehicle to its flights, as far as these determine them.

    Where all logs have the rotors' speeds, these take the place of commands, lag and voltage.

    Raises ConfigError for no flight, DataError for a flight given twice or with drives in other units, and FitError
    where nothing flew for long enough, or rotors explain too little for any of these quantities.
    """
    _check(flights)
    drags = {name: fit_drag([flown.flight for flown in flights], axis=axis) for axis, name in enumerate(_DRAG_AXES)}
    if all(flown.flight.speeds is not None for flown in flights):
        return of_speeds(flights, drags, body)
    if not any(drag is not None and drag.excited for drag in drags.values()):
        refuse_still([flown.flight for flown in flights])
    fitted = fit_flights([flown.flight for flown in flights])
    flights = with_usable_voltages(flights, fitted)
    fitted = fit_flights([flown.flight for flown in flights])  # cached, unless a voltage is not used
    measured = quantities_of(fitted, drags, body)
    quantities = {**measured, **given(body)}
    findings = (
        *(finding for flown in flights for finding in flown.findings),
        *findings_of(flights, fitted, drags, body),
    )
    name = flights[0].flight.name

    def drawings() -> Figures:
        from cfid.flight.figures import flight_figure

        title = ", ".join(flown.flight.name for flown in flights)
        return {f"fit_flight_{name}": flight_figure(fitted.blocks, drags, findings, title=title, row_s=ROW_S)}

    result = Result(
        command="fit flight",
        method="default",
        quantities=quantities,
        wanted=determined(measured, findings),
        findings=findings,
        merits={
            "rows": fitted.rows,
            "explained_vertical": fitted.explained,
            "excitation": dict(fitted.excitation),
            "drag_explained": {axis: drag.explained for axis, drag in drags.items() if drag is not None},
        },
        sources=tuple(flown.log.source for flown in flights),
        rests_on=RESTS_ON,
        covariances=covariances_of(fitted, body),
        lines=tuple(_lines(flights, fitted, drags)),
        drawings=drawings,
    )
    rescaled = any(flown.flight.rescaled for flown in flights)
    scales = power_law(quantities, *causes_of(body, in_volts=fitted.in_volts, rescaled=rescaled))
    return with_common_causes(result, scales, *([rescaled_thrust(fitted, body)] if rescaled else []))


def _check(flights: Sequence[FlownLog]) -> None:
    if not flights:
        raise ConfigError("nothing to fit: give a LOG of a flight.")
    for place, flown in enumerate(flights):
        for before in flights[:place]:
            if flown.log.source.sha256 == before.log.source.sha256 or same_flight(flown.log, before.log):
                raise DataError(f"{flown.log.path}: the same flight as {before.log.path.name}: name each once.")
        if flown.flight.in_volts != flights[0].flight.in_volts:
            raise DataError(f"{flown.log.path}: only some of the logs have the battery's voltage: fit them apart.")
        if (flown.flight.speeds is None) != (flights[0].flight.speeds is None):
            raise DataError(f"{flown.log.path}: only some of the logs have the speeds of all rotors: fit them apart.")


def _lines(
    flights: Sequence[FlownLog], fitted: FlightFit, drags: Mapping[str, AxisDrag | None]
) -> list[str | Dependent]:
    excited = [
        f"{name} {value:.2g} {'m/s^2' if name == 'vertical' else 'rad/s^2'}"
        for name, value in fitted.excitation.items()
    ]
    moved = [f"{axis} {drag.speed:.2g} m/s" for axis, drag in drags.items() if drag is not None]
    low, high = fitted.drive_range
    unit = " V" if fitted.in_volts else ""
    return [
        *(description(flown.log) for flown in flights),
        *(
            f"{flown.flight.name}: {flown.in_air_s:.1f} s in the air, {flown.driven_s:.1f} s of it with every motor "
            "within its range"
            for flown in flights
        ),
        f"excited, root mean square: {', '.join([*excited, *moved])}",
        f"drives from {low:.3g} to {high:.3g}{unit}, {fitted.drive:.3g}{unit} in the mean; thrust holds between these",
    ]
