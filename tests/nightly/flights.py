"""Flights of vehicles that differ, for studies of coverage: logs as tables, and the truth of each beside it.

    python -m tests.nightly.flights --vehicle brushless_38 --n 200 --gust 0.02 --rate-hz 100 --out flights

A flight depends on the seed and its number alone, so that a study can be ended, continued and divided.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.sim.flying import VEHICLES, FlyingVehicle, fly, scattered
from cfid.sim.pilot import manoeuvres

Array = npt.NDArray[np.float64]

KINDS = ("hover", "tilts", "yaw")
_AT_ONCE = 50  # flights: at 500 Hz, a minute of each takes 130 MB


def flights(
    name: str,
    numbers: range,
    *,
    kinds: Sequence[str] = KINDS,
    seconds: float = 60.0,
    gust: float = 0.0,
    rate_hz: int = 500,
    seed: int = 0,
) -> Iterator[tuple[FlyingVehicle, dict[str, Array]]]:
    """Yield vehicles scattered about one of `VEHICLES`, and their logs' columns, the first of which is time in s."""
    for first in range(numbers.start, numbers.stop, _AT_ONCE):
        part = range(first, min(first + _AT_ONCE, numbers.stop))
        rngs = [np.random.default_rng((seed, number)) for number in part]
        vehicles = [scattered(VEHICLES[name], rng, gust=gust) for rng in rngs]
        plans = np.stack([manoeuvres(kinds, seconds, rng) for rng in rngs])
        logs = fly(vehicles, plans, rngs=rngs, rate_hz=rate_hz)
        for place, vehicle in enumerate(vehicles):
            yield vehicle, {"t": logs.time_s, **logs.columns(place)}


def truth_of(vehicle: FlyingVehicle) -> dict[str, object]:
    """Return a vehicle's parameters, and what a fit finds of them: values at the speed that carries its weight."""
    hover = vehicle.hover_rad_s
    roll, pitch = vehicle.moment_per_velocity_ns
    return {
        **asdict(vehicle),
        "hover_rad_s": hover,
        "thrust_ns2_per_rad2_at_hover": vehicle.thrust_ns2_per_rad2 + vehicle.thrust_slope * hover,
        "moment_per_velocity_ns": [roll, pitch],
        "drag_per_s": [4 * hover * drag / vehicle.mass_kg for drag in vehicle.drag_kg_per_rad],
        "rising_s": 1 / (vehicle.rising[0] + 2 * vehicle.rising[1] * hover),
        "falling_s": 1 / (vehicle.falling[0] + 2 * vehicle.falling[1] * hover),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicle", choices=VEHICLES, default="brushless_38")
    parser.add_argument("--n", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--gust", type=float, default=0.0, help="force of gusts over the weight")
    parser.add_argument("--rate-hz", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    numbers = range(given.first, given.first + given.n)
    flown = flights(
        given.vehicle,
        numbers,
        kinds=given.kinds.split(","),
        seconds=given.seconds,
        gust=given.gust,
        rate_hz=given.rate_hz,
        seed=given.seed,
    )
    for number, (vehicle, columns) in zip(numbers, flown, strict=True):
        path = given.out / f"{given.vehicle}_{number:04}.csv"
        np.savetxt(path, np.column_stack(list(columns.values())), "%.7g", ",", header=",".join(columns), comments="")
        path.with_suffix(".json").write_text(json.dumps(truth_of(vehicle), indent=1), encoding="utf-8")
        print(path)


if __name__ == "__main__":
    main()
