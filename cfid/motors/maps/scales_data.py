"""What scales showed under the vehicle: from a run of `cfid log scales`, or from a table."""

from pathlib import Path
from typing import Any

from cfid.errors import DataError
from cfid.motors.maps.evidence import StandOptions


def read_scales(path: Path, stand: StandOptions) -> tuple[Any, Any, int]:
    """Return commands (n,), grams (n,) and how many motors ran. Raises DataError."""
    from cfid.records.tables.stand import read_stand_table
    from cfid.records.tables.times import run_at

    run = run_at(path)
    if run is not None:
        return _of_run(run)
    table = read_stand_table(path)
    if table.grams is None:
        raise DataError(f"{path}: no column 'grams': the scales' display at each cmd.")
    return table.command, table.grams, stand.motors or 1


def _of_run(run: Any) -> tuple[Any, Any, int]:
    """Take typed readings, or the mean of what the scales sent in the second half of each step."""
    import numpy as np

    from cfid.records.tables.vehicle import READINGS, holds, read_commands, read_rows

    motors = len(run.header.asked.get("motors", ())) or 1
    if holds(run, READINGS):
        rows = read_rows(run, READINGS)
        if "grams" not in rows.columns:
            raise DataError(f"{rows.source.path}: no column 'grams': this is no run of `cfid log scales`.")
        return rows.columns["command"], rows.columns["grams"], motors
    if not holds(run, "scales"):
        raise DataError(f"{run.folder}: holds no scales: `cfid log scales` records them.")
    shown, (log, commands) = read_rows(run, "scales"), read_commands(run)
    ends_s = np.append(log.time_s[1:], shown.time_s[-1])
    command, grams = [], []
    for begin_s, end_s, step in zip(log.time_s, ends_s, commands.max(axis=1), strict=True):
        inside = (shown.time_s > (begin_s + end_s) / 2) & (shown.time_s <= end_s)
        if inside.any():
            command.append(step)
            grams.append(shown.columns["grams"][inside].mean())
    return np.array(command), np.array(grams), motors
