"""Reports speed readings that a log or a stand repeats in several rows."""

from cfid.estimate.held_readings import Readings
from cfid.findings import Finding, note


def repeated_finding(readings: Readings) -> Finding:
    """Return a note on readings that are repeated."""
    rows, read, row_s = readings
    rate_hz = 1 / row_s
    text = (
        f"each reading is repeated in about {rows / read:.2g} rows: {rate_hz:.3g} rows a second show "
        f"{rate_hz * read / rows:.3g} readings. The first row of each counts, and may show it up to {1e3 * row_s:.3g} "
        f"ms late: half of that is taken off the delay, whose standard uncertainty contains "
        f"{1e3 * row_s / 12**0.5:.2g} ms for that."
    )
    return note("speeds-repeated", text, "dynamics.*")
