"""Which sines `cfid log sine` plays when they are not named one by one."""

import math
from dataclasses import dataclass

from cfid.wire.app import SAMPLES_PER_S

_FASTEST_HZ = 12.5  # up to which the thesis fits its transfer functions, and `cfid tf identify`
_COUNT = 24
_FEWEST_PERIODS = 2  # one alone cannot be told from a drift
_NEAR = 0.1  # of a frequency, within which a divisor of N is taken for it


@dataclass(frozen=True, kw_only=True)
class SineSeries:
    """A series of sines: l of each, and eq. 3.6's N, A and motor for all. `told` is how it came about."""

    periods: tuple[int, ...]
    samples: int
    amplitude: int = 20000
    motor: int = 1
    series: str | None = None
    told: str = ""


_RECONSTRUCTED = "reconstructed by table 3.1's number of l, their range and growing steps;"

_SLOW = (*range(16), *range(20, 51, 5))

THESIS_FIRST = SineSeries(
    periods=(*_SLOW, *range(55, 101, 5), 110, 150, 200, 300, 400, 500, 750, 1000, 1500, 2000),
    samples=4000,
    series="first",
    told=f"{_RECONSTRUCTED} only 0 to 15 and 20 to 100 by 5 stand in the thesis' code.",
)
THESIS_SECOND = SineSeries(
    periods=(*_SLOW, *range(60, 101, 10), *range(120, 201, 20), 300, 400, 500, 750, 1000, 2000, 4000),
    samples=8000,
    motor=3,
    series="second",
    told=f"{_RECONSTRUCTED} none stands in the thesis' code.",
)


def log_spaced(samples: int) -> SineSeries:
    """Return about twenty sines, evenly over the logarithm of frequency, from two periods up to 12.5 Hz.

    Where a divisor of N is near it is taken: whole periods then fill whole samples, and no spectrum leaks. Every
    second one comes first, rising, the others follow, falling: where frequency rises with time, a battery that
    empties passes for a time constant (decision 10).
    """
    most = max(int(samples * _FASTEST_HZ / SAMPLES_PER_S), _FEWEST_PERIODS)
    divisors = [l for l in range(1, most + 1) if samples % l == 0]  # noqa: E741
    periods = set()
    for place in range(_COUNT):
        wanted = _FEWEST_PERIODS * (most / _FEWEST_PERIODS) ** (place / (_COUNT - 1))
        nearest = min(divisors, key=lambda l: abs(math.log(l / wanted)))  # noqa: E741
        near = abs(math.log(nearest / wanted)) <= _NEAR
        periods.add(max(nearest if near else round(wanted), _FEWEST_PERIODS))
    rising = sorted(periods)
    whole = sum(l in divisors for l in periods)  # noqa: E741
    told = f"{len(periods)} sines, evenly over the logarithm of frequency up to {_FASTEST_HZ:g} Hz; {whole} divide N."
    return SineSeries(periods=(*rising[::2], *rising[1::2][::-1]), samples=samples, told=told)
