"""vehicle.json: all measured quantities with their uncertainties, for programs without an export of their own.

The models are also the file's schema: `VehicleFile.model_json_schema()`.
"""

import contextlib
import json
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, RootModel

from cfid.errors import DataError
from cfid.export.derived import Derived
from cfid.export.vehicle import ExportQuantity, ExportVehicle
from cfid.records.parameters import Value, plain
from cfid.version import __version__

_DIRECTIONAL = ("inertia.", "drag.", "centre_of_mass_m")  # prefixes of keys with values in the body frame
_TENSORS = ("inertia.matrix_kg_m2", "drag.simple_kg_per_rad", "drag.cross_coupling_kg_per_rad")

Number = Annotated[float, Field(strict=True)]
Vector = Annotated[list[Number], Field(min_length=3, max_length=3)]
Matrix = Annotated[list[Vector], Field(min_length=3, max_length=3)]
Pair = Annotated[list[Number], Field(min_length=2, max_length=2)]


class Numbers(RootModel[Number | list["Numbers"] | None]):
    """A number, or nested lists of numbers; null where nothing is known."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Entry(_Part):
    """A quantity as measured; `std` is the standard uncertainty, shaped as the value."""

    value: Numbers | list[dict[str, bool | str | Numbers]]
    std: Numbers
    unit: str
    frame: Literal["campaign"] | None = Field(description="campaign where the numbers belong to its axes x, y and z")
    in_vehicle_frame: dict[Literal["value", "std"], Numbers] = Field({}, description="x forward, y left, z up")
    accepted: bool = Field(description="false: the fit was rejected, and kept by force")
    simulated: bool = Field(description="true: some of its recordings are of a simulated rig")
    caveat: str
    commands: Pair | None = Field(description="The least and the largest command that was measured")
    origin: str = Field(description="Section, method, time, version and runs")


class Frames(_Part):
    """The campaign's frame, by which of its axes points where, and the vehicle's.

    The matrix R turns to the latter: R v for vectors, R M R^T for matrices.
    """

    campaign: dict[Literal["forward", "left", "up"], Literal["x", "-x", "y", "-y", "z", "-z"]]
    vehicle: Literal["x forward, y left, z up; origin in the centre of mass"]
    campaign_to_vehicle: Matrix


class Block(_Part):
    """A covariance matrix of the numbers of the keys `of`, in the units of both.

    Numbers follow each other: a list from its start, a matrix row by row; inertia.matrix_kg_m2 has six, xx, yy, zz, xy,
    xz, yz.
    """

    of: list[str] = Field(min_length=1)
    matrix: list[list[Number]]


class Dependences(_Part):
    """What is known of numbers that depend on each other, in the campaign's frame.

    `common` has, by cause that fits share and by key, what one standard uncertainty of the cause does to each number,
    in the order of `covariance.of`; it is contained in std.
    """

    covariance: list[Block] | None = None
    common: dict[str, dict[str, list[Number]]] | None = None


class Rotor(_Part):
    """A rotor's place in the vehicle's frame; a yaw sign of -1 turns counter-clockwise seen from above."""

    name: Literal["m1", "m2", "m3", "m4"]
    place_m: Vector
    yaw_sign: Literal[-1, 1]


class Hovering(_Part):
    """What follows where the vehicle hovers; null where it makes no sense, absent where quantities are unknown.

    Drag is forward, left and up, and brakes if positive.
    """

    thrust_of_a_motor_n: Number | None = None
    command: Number | None = Field(None, description="0 to 65535")
    rotor_speed_rad_s: Number | None = None
    moment_per_thrust_m: Number | None = None
    lags_rising_and_falling_s: Pair | None = None
    drag_n_s_per_m: Vector | None = None


class VehicleFile(_Part):
    """A vehicle that cfid measured. Quantities have the keys of `cfid parameters`.

    `further` has, by kind of fit, the values of keys whose quantity above is from another fit.
    """

    format: Literal["cfid-vehicle-1"]
    written_by: str
    name: str
    gravity_mps2: Number = Field(gt=0)
    frames: Frames
    quantities: dict[str, Entry]
    further: dict[str, Annotated[dict[str, Entry], Field(min_length=1)]]
    covariance: dict[str, Dependences]
    rotors: list[Rotor] = Field(description="m1 to m4, or none where the arm is not known")
    at_hovering: Hovering


def text_of(vehicle: ExportVehicle) -> str:
    """Return the file."""
    v, frame = Derived(vehicle), vehicle.frame
    content: dict[str, Any] = {
        "format": "cfid-vehicle-1",
        "written_by": f"cfid {__version__}",
        "name": vehicle.name,
        "gravity_mps2": v["gravity_mps2"],
        "frames": {
            "campaign": {"forward": frame.forward, "left": frame.left, "up": frame.up},
            "vehicle": "x forward, y left, z up; origin in the centre of mass",
            "campaign_to_vehicle": [
                [sign * float(place == column) + 0.0 for column in range(3)] for place, sign in frame.axes
            ],
        },
        "quantities": {key: _entry(quantity, v) for key, quantity in {**vehicle.quantities, **vehicle.partial}.items()},
        "further": {
            section: {quantity.key: _entry(quantity, v) for quantity in quantities}
            for section, quantities in vehicle.further.items()
        },
        "covariance": plain(vehicle.covariance),
        "rotors": [
            {"name": f"m{motor.number}", "place_m": motor.place_m, "yaw_sign": motor.yaw_sign}
            for motor in (v.motors if v.has("arm_m") else [])
        ],
        "at_hovering": _at_hovering(v),
    }
    file = VehicleFile.model_validate(content)
    return json.dumps(file.model_dump(mode="json", exclude_unset=True), indent=2, allow_nan=False) + "\n"


def _entry(quantity: ExportQuantity, v: Derived) -> dict[str, Value]:
    entry: dict[str, Value] = {
        "value": plain(quantity.value),
        "std": plain(quantity.std),
        "unit": quantity.unit,
        "frame": "campaign" if quantity.key.startswith(_DIRECTIONAL) else None,
        "accepted": not quantity.is_marked("REJECTED"),
        "simulated": quantity.is_marked("SIMULATED"),
        "caveat": " ".join(f"{mark}: {reason}" for mark, reason in quantity.caveats if mark != "SIMULATED"),
        "commands": plain(quantity.commands),
        "origin": quantity.origin,
    }
    if quantity.key in _TENSORS:
        std = quantity.std and v.turned_tensor(quantity.std, signed=False)
        entry["in_vehicle_frame"] = {"value": v.turned_tensor(quantity.value), "std": std}
    return entry


def _at_hovering(v: Derived) -> dict[str, Value]:
    """Return derived quantities at hovering, as far as the known quantities make sense."""
    square = "motor.thrust_per_speed_squared_n_s2"
    lags = f"dynamics.rising+dynamics.falling+{square}|tf.time_constant_s"
    values: dict[str, Value] = {}
    for name, need, derived in (
        ("thrust_of_a_motor_n", "mass_kg", "hover_thrust_n"),
        ("command", "motor.thrust_poly", "hover_command"),
        ("rotor_speed_rad_s", square, "hover_speed_rad_s"),
        ("moment_per_thrust_m", "motor.torque_poly", "moment_per_thrust_m"),
        ("drag_n_s_per_m", f"drag+{square}", "drag_n_s_per_m"),
        ("lags_rising_and_falling_s", lags, "lags_s"),
    ):
        if v.has(need):
            values[name] = None
            with contextlib.suppress(DataError):  # no number is better than a wrong one; other exports state the reason
                values[name] = getattr(v, derived)
    return values
