"""Round trips as `cfid log ping` and `cfid tf latency` tell them: parameters of the contract, rows of table 3.2."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cfid.latency.estimation import RoundTrips

_BAR = 40

HEAD = f"{'circumstances':<28} {'packets':>8} {'mean RTT [ms]':>14} {'std [ms]':>10} {'least [ms]':>11}"


def trip_parameters(trips: "RoundTrips") -> dict[str, dict[str, Any]]:
    """Return mean, deviation and least, as --json has them."""
    return {
        "latency.rtt_mean_s": {"value": trips.mean_s, "std": trips.mean_std_s, "unit": "s"},
        "latency.rtt_std_s": {"value": trips.std_s, "std": None, "unit": "s"},
        "latency.rtt_min_s": {"value": trips.least_s, "std": None, "unit": "s"},
    }


def trip_row(circumstances: str, trips: "RoundTrips") -> str:
    """Return a row of table 3.2."""
    return (
        f"{(circumstances or '-')[:28]:<28} {trips.answers:8d} {1e3 * trips.mean_s:14.4f} "
        f"{1e3 * trips.std_s:10.4f} {1e3 * trips.least_s:11.4f}"
    )


def bars(rtt_s: Any) -> Sequence[str]:
    """Return the histogram of round trips (n,) in characters."""
    from cfid.latency.estimation import histogram

    drawn = histogram(rtt_s)
    widest = drawn.counts.max()
    return [
        f"{1e3 * edge_s:9.3f} ms {'█' * round(_BAR * count / widest):{_BAR}} {count}"
        for edge_s, count in zip(drawn.edges_s[:-1], drawn.counts, strict=True)
    ]


def as_parameters(content: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the same as parameters."""
    from cfid.records.parameters import Parameter

    return {name: Parameter(**own) for name, own in content.items()}
