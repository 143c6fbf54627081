"""Whether one vehicle's thrust explains several logs: those of unlike vehicles contradict each other."""

from collections.abc import Sequence

from cfid.findings import Finding, rejection, warning
from cfid.flight.estimation import EXPLAINED, FlightFit, explained_of, roughly_fitted
from cfid.flight.rows import Flight, segments

_WORSE = (
    2.5  # times what each log alone leaves unexplained: 1.0 to 1.3 in logs of one vehicle, 2.7 of thrusts 7 % apart
)
_LEAST = 0.05  # of the vertical force, that all together leave unexplained


def agreement_findings(flights: Sequence[Flight], found: FlightFit, concerned: Sequence[str]) -> list[Finding]:
    """Name logs whose vertical force one thrust explains far worse than one of its own in each log does.

    All thrusts are those of coarse lags. Where a fit to all explains too little, `concerned` keys are rejected.
    """
    flown = [flight for flight in flights if segments(flight.driven)]
    if len(flown) < 2:
        return []
    each = [roughly_fitted([flight]) for flight in flown]
    apart, together = (explained_of(one, None) for one in (sum(each, ()), roughly_fitted(flown)))
    if 1 - together < max(_WORSE * (1 - apart), _LEAST):
        return []
    share = ", ".join(
        f"{one.name} {100 * explained_of(fitted, None):.0f} %" for one, fitted in zip(flown, each, strict=True)
    )
    text = (
        "the logs contradict each other: rotors explain the vertical force with a thrust of its own in each log "
        f"({share}) and {100 * min(together, found.explained):.0f} % of it with one thrust in all. Another vehicle, "
        "mass, propeller or battery is in one of them: fit the logs of each apart."
    )
    if found.explained < EXPLAINED:
        return [rejection("flight-logs-contradict", text, *concerned)]
    return [warning("flight-logs-contradict", text, *concerned)]
