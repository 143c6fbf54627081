"""How often fits of flights by their rotors' speeds contain the truth, and how wide they are.

python -m tests.nightly.speeds --vehicle brushless_38 --n 200 --gust 0.02 --rate-hz 100
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import numpy.typing as npt

from cfid.flight.data import FlownLog, read_flight
from cfid.flight.result import fit
from cfid.flight.values import Body
from cfid.records.result import Result
from cfid.sim.flying import VEHICLES, FlyingVehicle
from tests.nightly.flights import flights, truth_of

Array = npt.NDArray[np.float64]

KINDS = ("hover", "tilts", "yaw", "turns")
_GYRO_LATE_S = 0.5**0.5 / (np.pi * 80.0)  # by its filter, sqrt(2) / (2 pi 80 Hz)


def flown_in(columns: dict[str, Array], path: Path) -> FlownLog:
    """Return the flight of a log's columns, which are written to a table at a path."""
    np.savetxt(path, np.column_stack(list(columns.values())), "%.7g", ",", header=",".join(columns), comments="")
    return read_flight(path)


def fitted(flown: FlownLog, vehicle: FlyingVehicle, *, torque: bool = False) -> Result:
    """Return the fit of a flight whose mass and arm are known exactly, as is its torque over thrust if asked."""
    body = Body(mass_kg=vehicle.mass_kg, mass_std_kg=0.0, arm_m=vehicle.arm_m, arm_std_m=0.0)
    if torque:
        body = Body(**{**vars(body), "torque_m": vehicle.torque_m, "torque_std_m": 0.0})
    return fit([flown], body=body)


def truths(vehicle: FlyingVehicle) -> dict[str, float]:
    """Return the true values of what a fit gives as numbers, polynomials by their first coefficient."""
    roll, pitch = vehicle.moment_per_velocity_ns
    late_s = vehicle.telemetry_delay_s + (vehicle.telemetry_s - 1e-3) / 2  # a step of the simulation is not waited for
    moments = dict(zip(("roll", "pitch", "yaw"), np.diag(vehicle.inertia_kg_m2).tolist(), strict=True))
    return {
        "motor.thrust_per_speed_squared_n_s2": float(str(truth_of(vehicle)["thrust_ns2_per_rad2_at_hover"])),
        **{f"flight.inertia_kg_m2.{axis}": moment for axis, moment in moments.items()},
        "rotor_inertia_kg_m2": vehicle.rotor_inertia_kg_m2,
        "motor.torque_poly": vehicle.torque_m,
        "flight.moment_per_velocity_ns.roll": roll,
        "flight.moment_per_velocity_ns.pitch": pitch,
        "flight.speed_delay_s": late_s - _GYRO_LATE_S,
    }


def numbers(result: Result, key: str) -> tuple[float, float]:
    """Return a quantity's first number and its standard uncertainty."""
    value, std = np.ravel(result.quantities[key].value)[0], np.ravel(result.quantities[key].std)[0]
    return float(value), float(std)


def errors(name: str, count: int, *, gust: float, rate_hz: int) -> Iterator[dict[str, tuple[float, float]]]:
    """Yield the error and the standard uncertainty of each quantity in each flight, relative to the truth."""
    with TemporaryDirectory() as folder:
        for vehicle, columns in flights(name, range(count), kinds=KINDS, gust=gust, rate_hz=rate_hz):
            result, found = fitted(flown_in(columns, Path(folder, "flight.csv")), vehicle), {}
            for key, true in truths(vehicle).items():
                value, std = numbers(result, key)
                found[key] = (value - true) / abs(true), std / abs(true)
            yield found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicle", choices=VEHICLES, default="brushless_38")
    parser.add_argument("--n", type=int, default=200)
    parser.add_argument("--gust", type=float, default=0.0, help="force of gusts over the weight")
    parser.add_argument("--rate-hz", type=int, default=100)
    given = parser.parse_args()
    every = list(errors(given.vehicle, given.n, gust=given.gust, rate_hz=given.rate_hz))
    print(f"{given.vehicle}, gusts {given.gust:g}, {given.rate_hz} Hz, {len(every)} flights; shares in per cent")
    print(f"{'':36} {'error':>8} {'rms':>7} {'stated':>7} {'of 95 %':>8}")
    for key in every[0]:
        error, std = (np.array([found[key][place] for found in every]) for place in (0, 1))
        row = [float(np.mean(error)), float(np.sqrt(np.mean(error**2))), float(np.sqrt(np.mean(std**2)))]
        inside = float(np.mean(np.abs(error) < 1.96 * std))
        print(f"{key:36} {100 * row[0]:8.2f} {100 * row[1]:7.2f} {100 * row[2]:7.2f} {100 * inside:8.1f}", flush=True)


if __name__ == "__main__":
    main()
