"""Read a MATLAB file that cfid made of a recording with several series, as that recording."""

from pathlib import Path

from cfid.records.logs.crazyflie_names import assumptions, stated_channel
from cfid.records.logs.log import FlightLog, in_memory, printable
from cfid.records.logs.spin import with_kept_texts
from cfid.records.parameters import Source
from cfid.records.tables.matlab import converted_series, is_matlab

_PROGRAM = "MATLAB file of cfid: "


def read_converted(path: Path, source: Source) -> FlightLog | None:
    """Return the log of several series that cfid wrote to a MATLAB file, None for any other file.

    Raises DataError where it cannot be read.
    """
    tables, origin = converted_series(path) if is_matlab(path) else ([], {})
    if len(tables) < 2:
        return None
    series = []
    for table in tables:
        time_s, *values = table.columns
        channels = [stated_channel(printable(name), table.units[name]) for name in table.names[1:]]
        series.append(in_memory(table.place, time_s, channels, values))
    program = (origin.get("program") or f"run {origin.get('run', '')} of cfid").removeprefix(_PROGRAM)
    log = FlightLog(
        path=path,
        source=source,
        program=f"{_PROGRAM}{program}",
        clock=origin.get("clock", "times are those of the run"),
        series=tuple(series),
        assumed=assumptions([channel for one in series for channel in one.channels]),
    )
    return with_kept_texts(log, origin)
