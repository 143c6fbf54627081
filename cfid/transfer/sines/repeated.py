"""Take each reading of a load cell once where readings come less often than rows, and report that."""

from cfid.estimate.held_readings import first_rows, rows_a_reading
from cfid.findings import warning
from cfid.large import usual_step
from cfid.recordings.wrench import WrenchRecord

_LOOKED_AT = 100_000  # the number of samples that are examined


def read_once(record: WrenchRecord) -> WrenchRecord:
    """Return a load cell's record with the first row of each reading.

    A row that repeats a reading shows an earlier force: thrust would be late by half the time between two readings.
    """
    values = record.values_of(record.main_axis)
    rows = rows_a_reading(values[:_LOOKED_AT])
    if rows == 1:
        return record
    rate_hz = 1 / usual_step(record.time_s)
    text = (
        f"each reading of the load cell is repeated in about {rows} rows: {rate_hz:.3g} rows a second show "
        f"{rate_hz / rows:.3g} readings. The first row of each counts, which may be up to {1e3 / rate_hz:.3g} ms late."
    )
    return record.kept(first_rows(values, rows=rows), warning("sine-forces-repeated", text, "tf.*"))
