"""Check whether one vehicle's thrust explains several logs: logs of different vehicles contradict each other."""

from collections.abc import Sequence

from cfid.findings import Finding, rejection, warning
from cfid.flight.estimation import EXPLAINED, FlightFit, explained_of, roughly_fitted
from cfid.flight.rows import Flight, segments

# The limit on the unexplained part with one common thrust, relative to that with a thrust for each log. Logs of one
# vehicle have 1.0 to 1.3; two thrusts that differ by 7 % have 2.7.
_WORSE = 2.5
# The least part of the vertical force's variance that the common thrust has to leave unexplained.
_LEAST = 0.05


def agreement_findings(flights: Sequence[Flight], found: FlightFit, concerned: Sequence[str]) -> list[Finding]:
    """Report logs whose vertical force one common thrust explains far worse than a separate thrust for each log.

    All thrusts are fitted with coarse lags. The `concerned` keys are rejected where the fit to all logs explains too
    little.
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
