"""Choose which flight is fitted in a file of several, as flight controllers write them."""

from dataclasses import replace

from cfid.records.logs.log import FlightLog
from cfid.units import MOTORS

_COMMANDS = {f"control.m{motor}" for motor in MOTORS}


def longest_flight(log: FlightLog) -> FlightLog:
    """Return a log with only the flight of most rows, and a note on the others; series that are not flights stay.

    Flights are series of other autopilots that have the commands of all motors. A log with fewer than two stays as it
    is.
    """
    flights = [one for one in log.series if set(one.names) >= _COMMANDS]
    if len(flights) < 2:
        return log
    longest = max(flights, key=lambda one: one.rows)
    others = ", ".join(f"{one.name} ({one.rows} rows)" for one in flights if one is not longest)
    note = f"{len(flights)} flights are in it: {longest.name}, of {longest.rows} rows, is fitted, and not {others}."
    kept = tuple(one for one in log.series if one is longest or one not in flights)
    return replace(log, series=kept, notes=(*log.notes, note))
