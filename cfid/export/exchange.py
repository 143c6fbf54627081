"""One JSON file with all measured quantities and uncertainties, for programs without an export of their own.

`vehicle.schema.json` in this package describes the file.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from cfid.errors import DataError
from cfid.export.frame import turned_matrix, turned_spread
from cfid.export.hover import (
    YAW_SIGNS,
    drag_n_s_per_m,
    has_lag,
    hover_command,
    hover_speed_rad_s,
    hover_thrust_n,
    lags_s,
    moment_per_thrust_m,
    rotor_places_m,
)
from cfid.export.target import EXCHANGE_FILE, Target, has
from cfid.export.vehicle import SOURCES, ExportQuantity, ExportVehicle
from cfid.records.parameters import Value, plain
from cfid.version import __version__

FORMAT = "cfid-vehicle-1"
_DIRECTIONAL = ("inertia.", "drag.", "centre_of_mass_m")  # prefixes of keys with values in the body frame
_TENSORS = ("inertia.matrix_kg_m2", "drag.simple_kg_per_rad", "drag.cross_coupling_kg_per_rad")


def write(vehicle: ExportVehicle) -> str:
    """Return the file."""
    frame = vehicle.frame
    axes = [frame.turned(axis) for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
    content: dict[str, Any] = {
        "format": FORMAT,
        "written_by": f"cfid {__version__}",
        "name": vehicle.name,
        "gravity_mps2": vehicle.gravity_mps2,
        "frames": {
            "campaign": {"forward": frame.forward, "left": frame.left, "up": frame.up},
            "vehicle": "x forward, y left, z up; origin in the centre of mass",
            "campaign_to_vehicle": [[axis[row] for axis in axes] for row in range(3)],
        },
        "quantities": {quantity.key: _entry(quantity, vehicle) for quantity in _all(vehicle)},
        "further": {
            section: {quantity.key: _entry(quantity, vehicle) for quantity in found}
            for section, found in vehicle.further.items()
        },
        "covariance": plain(vehicle.covariance),
        "rotors": _rotors(vehicle),
        "at_hovering": _at_hovering(vehicle),
    }
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def _all(vehicle: ExportVehicle) -> list[ExportQuantity]:
    """Return every quantity once: first those that exports use, then the others."""
    known = (*vehicle.quantities.values(), vehicle.gravity, vehicle.centre)
    taken = {quantity.key: quantity for quantity in known}
    return list((taken | {q.key: q for q in vehicle.others if q.key not in taken}).values())


def _entry(quantity: ExportQuantity, vehicle: ExportVehicle) -> dict[str, Value]:
    directional = quantity.key.startswith(_DIRECTIONAL)
    entry = {
        "value": plain(quantity.value),
        "std": plain(quantity.std),
        "unit": quantity.unit,
        "frame": "campaign" if directional else None,
        "accepted": quantity.accepted,
        "simulated": quantity.simulated,
        "caveat": quantity.caveat,
        "commands": plain(quantity.commands),
        "origin": quantity.origin,
    }
    if quantity.key in _TENSORS:
        entry["in_vehicle_frame"] = {
            "value": _turned(quantity.value, lambda matrix: turned_matrix(matrix, vehicle.frame)),
            "std": quantity.std and _turned(quantity.std, lambda matrix: turned_spread(matrix, vehicle.frame)),
        }
    return entry


def _turned(value: Sequence[Any], turn: Callable[[Sequence[Sequence[float]]], Sequence[Sequence[float]]]) -> Value:
    """Return a matrix, or the diagonal of a matrix, in the vehicle's frame."""
    unknown = float("nan")
    if isinstance(value[0], Sequence):
        return plain(turn([[unknown if part is None else part for part in row] for row in value]))
    diagonal = [
        [0.0 if i != j else unknown if part is None else part for j in range(3)] for i, part in enumerate(value)
    ]
    return plain([row[i] for i, row in enumerate(turn(diagonal))])


def _rotors(vehicle: ExportVehicle) -> list[dict[str, Value]]:
    if "arm" not in vehicle:
        return []
    return [
        {"name": f"m{i}", "place_m": list(place), "yaw_sign": sign}
        for i, (place, sign) in enumerate(zip(rotor_places_m(vehicle), YAW_SIGNS, strict=True), start=1)
    ]


def _at_hovering(vehicle: ExportVehicle) -> dict[str, Value]:
    """Return derived quantities at hovering, as far as the known quantities make sense."""
    derived: Mapping[str, tuple[str, Callable[[ExportVehicle], Value]]] = {
        "thrust_of_a_motor_n": ("mass", hover_thrust_n),
        "command": ("thrust_of_command", hover_command),
        "rotor_speed_rad_s": ("thrust_per_speed_squared", hover_speed_rad_s),
        "moment_per_thrust_m": ("torque_of_thrust", moment_per_thrust_m),
        "drag_n_s_per_m": ("drag+thrust_per_speed_squared", drag_n_s_per_m),
    }
    found = {name: plain(_or_none(of, vehicle)) for name, (need, of) in derived.items() if has(vehicle, need)}
    lags = {"lags_rising_and_falling_s": plain(_or_none(lags_s, vehicle))} if has_lag(vehicle) else {}
    return found | lags


def _or_none(calculate: Callable[[ExportVehicle], Value], vehicle: ExportVehicle) -> Value:
    try:
        return calculate(vehicle)
    except DataError:  # no number is better than a wrong one; the other exports state the reason
        return None


TARGET = Target(
    name="json",
    file_name=EXCHANGE_FILE,
    about="Everything as JSON",
    comment="",
    needs=("mass",),
    uses=tuple(name for name in SOURCES if name != "mass"),
    write=write,
)
