"""Reads the true parameters of a simulated rig from a TOML file, in which every key has a default."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError, field_validator, model_validator

from cfid.errors import ConfigError
from cfid.records.files import first_fault, read_toml
from cfid.records.rig_file import Number, Positive, Rig, Spread, Vector
from cfid.sim.battery import BatteryTruth
from cfid.sim.crazyflie import CrazyflieTruth, Platform
from cfid.sim.imu import ImuTruth
from cfid.sim.link import RadioTruth
from cfid.sim.loadcell import LoadCellTruth
from cfid.sim.rotors import BRUSHLESS, RotorTruth
from cfid.sim.truth import TrueFriction, Truth, draw_truth, with_errors
from cfid.sim.wind import WindTruth
from cfid.units import MM

Matrix = tuple[Vector, Vector, Vector]

# A Crazyflie with a battery a little off centre: near the thesis' result, a body that can exist.
INERTIA_KG_M2 = 1e-6 * np.array([[16.4, -0.6, 0.5], [-0.6, 16.9, 1.1], [0.5, 1.1, 29.0]])
_X, _Y, _Z = INERTIA_KG_M2.tolist()


class _TruthTable(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class VehicleTruth(_TruthTable):
    """The vehicle's inertia matrix about its centre of mass.

    Its mass and centre of mass differ from rig.toml's by the errors, beyond what rig.toml states. A cube of
    `fixture_kg`, which rig.toml does not state, swings with it.
    """

    inertia_kg_m2: Matrix = (tuple(_X), tuple(_Y), tuple(_Z))
    mass_error_kg: Number = 0.0
    centre_of_mass_error_mm: Vector = (0.0, 0.0, 0.0)
    fixture_kg: Spread = 0.0

    @field_validator("inertia_kg_m2")
    @classmethod
    def _can_exist(cls, matrix: Matrix) -> Matrix:
        inertia = np.array(matrix)
        if not np.array_equal(inertia, inertia.T):
            raise ValueError("an inertia matrix is symmetric")
        if not np.linalg.eigvalsh(np.trace(inertia) / 2 * np.eye(3) - inertia)[0] >= 0:
            raise ValueError("no body has this inertia: one principal moment exceeds the sum of the others")
        return matrix


class SwingTruth(_TruthTable):
    """What disturbs every swing: axes that tilt (standard deviation), a cable's spring, uneven dry friction.

    The encoder's ring is mounted off centre: it adds a sine of `eccentricity_deg` to the angle.
    """

    tilt_deg: Spread = 0.0
    spring_nm_per_rad: Spread = 0.0
    stribeck_nm: Spread = 0.0
    ripple_nm: Number = 0.0
    eccentricity_deg: Number = 0.0

    @property
    def friction(self) -> TrueFriction:
        """The usual friction with these disturbances."""
        return TrueFriction(
            spring_nm_per_rad=self.spring_nm_per_rad, stribeck_nm=self.stribeck_nm, ripple_nm=self.ripple_nm
        )

    @property
    def eccentricity_rad(self) -> float:
        """The encoder's error."""
        return math.radians(self.eccentricity_deg)


class AxisTruth(_TruthTable):
    """The axis that the dropping weights turn: its own inertia and its friction.

    The friction is near that of the thesis' axis in table 2.1, taken as Coulomb and viscous friction. The line has a
    diameter, and lies in layers of `turns_per_layer` where that is not zero.
    """

    setup_inertia_kg_m2: Positive = 1.5e-7
    coulomb_nm: Spread = 3.2e-4
    viscous_nms_per_rad: Spread = 1.1e-6
    line_diameter_mm: Spread = 0.0
    turns_per_layer: Spread = 0.0


class SimTruth(_TruthTable):
    """All true parameters. A Brushless has its own rotors by default."""

    vehicle: VehicleTruth = VehicleTruth()
    swing: SwingTruth = SwingTruth()
    axis: AxisTruth = AxisTruth()
    rotors: RotorTruth = RotorTruth()
    loadcell: LoadCellTruth = LoadCellTruth()
    crazyflie: CrazyflieTruth = CrazyflieTruth()
    imu: ImuTruth = ImuTruth()
    battery: BatteryTruth = BatteryTruth()
    radio: RadioTruth = RadioTruth()
    wind: WindTruth = WindTruth()

    @model_validator(mode="before")
    @classmethod
    def _fits_the_platform(cls, content: dict[str, Any]) -> dict[str, Any]:
        crazyflie, rotors = content.get("crazyflie", {}), content.get("rotors", {})
        platform = crazyflie.get("platform") if isinstance(crazyflie, dict) else getattr(crazyflie, "platform", None)
        if platform != "cf21bl" or not isinstance(rotors, dict):
            return content
        return {**content, "rotors": {**BRUSHLESS, **rotors}}


USUAL_TRUTH = SimTruth()


def usual_truth(platform: Platform) -> SimTruth:
    """Return the default truth of a rig with a vehicle of this platform."""
    return SimTruth.model_validate({"crazyflie": {"platform": platform}})


def draw_vehicle(rig: Rig, truth: SimTruth, *, rng: np.random.Generator) -> Truth:
    """Draw a vehicle and its mounts around rig.toml's values, with the truth's own errors in addition."""
    vehicle = draw_truth(rig, inertia_kg_m2=truth.vehicle.inertia_kg_m2, friction=truth.swing.friction, rng=rng)
    return with_errors(
        vehicle,
        mass_kg=truth.vehicle.mass_error_kg,
        centre_of_mass_m=MM * np.array(truth.vehicle.centre_of_mass_error_mm),
        fixture_kg=truth.vehicle.fixture_kg,
        tilt_deg=truth.swing.tilt_deg,
        rng=rng,
    )


def as_mounted(truth: SimTruth, rig: Rig) -> SimTruth:
    """Return a truth with rig.toml's mounting wherever the truth file states no value."""
    facts, arm_mm = rig.facts, rig.loadcell.arm_mm
    mounted: dict[str, dict[str, Any]] = {
        "loadcell": {"yaw_deg": facts.loadcell.yaw_deg, "flip_fz": facts.loadcell.flip_fz},
        "rotors": {"arm_m": None if arm_mm is None else MM * arm_mm, "markers": facts.tachometer.markers},
        "wind": {"azimuth_deg": facts.wind.azimuth_deg, "yaw_deg": facts.yaw_in_wind_deg},
    }
    parts = {}
    for name, stated in mounted.items():
        part = getattr(truth, name)
        new = {key: value for key, value in stated.items() if value is not None and key not in part.model_fields_set}
        parts[name] = part.model_copy(update=new)
    return truth.model_copy(update=parts)


def load_truth(path: Path, *, platform: Platform | None = None) -> SimTruth:
    """Read a truth file; `platform` overrides the file's own. Raises ConfigError naming file and key."""
    try:
        content = read_toml(path, ConfigError)
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file.") from None
    if platform is not None and isinstance(content.setdefault("crazyflie", {}), dict):
        content["crazyflie"]["platform"] = platform
    try:
        return SimTruth.model_validate(content)
    except ValidationError as error:
        raise ConfigError(f"{path}: {first_fault(error, content)}") from None
