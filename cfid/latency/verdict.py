"""Judges pings as soon as they are recorded."""

from cfid.latency.result import fit
from cfid.recordings.sines import PINGS
from cfid.records.run import Run


def verdict(run: Run) -> str:
    """Return how many pings were answered, and how fast. Raises FitError for fewer than two answers."""
    result = fit([run])
    mean_ms = 1e3 * result.quantities["latency.rtt_mean_s"].value
    answers = run.header.devices[PINGS].rows
    return f"{answers} of {run.header.requested['count']} answered, {mean_ms:.1f} ms on average."
