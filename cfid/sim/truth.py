"""Lists the true parameters of a simulated rig, a TOML file in which every key has a default, and how rigs differ."""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import ValidationError, field_validator, model_validator

from cfid.errors import ConfigError
from cfid.records.files import first_fault, read_toml
from cfid.records.rig_file import Number, Positive, Rig, RigTable, Spread, Vector
from cfid.sim.crazyflie import CrazyflieTruth, Platform
from cfid.sim.imu import ImuTruth
from cfid.sim.link import RadioTruth
from cfid.sim.loadcell import LoadCellTruth
from cfid.sim.propulsion import BRUSHLESS, BatteryTruth, RotorTruth, WindTruth
from cfid.sim.stepping import Array
from cfid.sim.swing import TrueFriction, Truth, draw_truth, with_errors
from cfid.units import MM

Matrix = tuple[Vector, Vector, Vector]
Distribution = Literal["normal", "around", "fixed"]

# A Crazyflie with a battery a little off centre: near the thesis' result, a body that can exist.
INERTIA_KG_M2 = 1e-6 * np.array([[16.4, -0.6, 0.5], [-0.6, 16.9, 1.1], [0.5, 1.1, 29.0]])
_X, _Y, _Z = INERTIA_KG_M2.tolist()


class VehicleTruth(RigTable):
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


class SwingTruth(RigTable):
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


class AxisTruth(RigTable):
    """The axis that the dropping weights turn: its own inertia and its friction.

    The friction is near that of the thesis' axis in table 2.1, taken as Coulomb and viscous friction. The line has a
    diameter, and lies in layers of `turns_per_layer` where that is not zero.
    """

    setup_inertia_kg_m2: Positive = 1.5e-7
    coulomb_nm: Spread = 3.2e-4
    viscous_nms_per_rad: Spread = 1.1e-6
    line_diameter_mm: Spread = 0.0
    turns_per_layer: Spread = 0.0


class SimTruth(RigTable):
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


def load_truth(path: Path) -> SimTruth:
    """Read a truth file. Raises ConfigError naming file and key."""
    try:
        content = read_toml(path, ConfigError)
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file.") from None
    try:
        return SimTruth.model_validate(content)
    except ValidationError as error:
        raise ConfigError(f"{path}: {first_fault(error, content)}") from None


class Imperfection(NamedTuple):
    """How a real rig differs from the ideal one: a key of a truth file, off by default, and its values between rigs.

    `normal`: mean 0 and the standard deviation `size`, drawn separately for each number of a list. `around`: between
    0.5 and 1.5 times `size`, all equally likely. `fixed`: `size` itself, since it is the standard deviation of what
    varies within one rig, from one time to another.
    """

    key: str
    distribution: Distribution
    size: float
    unit: str
    text: str


IMPERFECTIONS = (
    Imperfection("swing.eccentricity_deg", "around", 0.3, "deg", "the encoder's ring is mounted off centre"),
    Imperfection("swing.spring_nm_per_rad", "around", 6e-5, "Nm/rad", "a cable acts as a spring, 1 % of gravity"),
    Imperfection("swing.stribeck_nm", "around", 2e-5, "Nm", "dry friction is larger at low speed"),
    Imperfection("swing.ripple_nm", "normal", 1e-5, "Nm", "dry friction varies with the angle"),
    Imperfection("swing.tilt_deg", "fixed", 1.0, "deg", "axes are mounted less exactly than rig.toml states"),
    Imperfection("vehicle.fixture_kg", "around", 1.2e-3, "kg", "the cube on the axis is neglected"),
    Imperfection("vehicle.centre_of_mass_error_mm", "normal", 0.5, "mm", "the centre of mass is known less exactly"),
    Imperfection("vehicle.mass_error_kg", "normal", 1e-4, "kg", "the mass is known less exactly"),
    Imperfection("axis.line_diameter_mm", "around", 0.2, "mm", "the line's thickness is neglected"),
    Imperfection("axis.turns_per_layer", "around", 20.0, "turns", "the line is wound in layers"),
    Imperfection("rotors.thrust_scatter", "fixed", 0.005, "relative", "thrust scatters from step to step"),
    Imperfection("rotors.speed_wander", "fixed", 0.005, "relative", "a rotor's speed wanders, correlated over 0.1 s"),
    Imperfection("rotors.slower_fall", "around", 0.5, "relative", "a rotor slows down more slowly than it speeds up"),
    Imperfection("rotors.arm_error", "normal", 0.01, "relative", "the arm is longer than stated"),
    Imperfection("rotors.tachometer_gain", "normal", 0.005, "relative", "the tachometer reads too much"),
    Imperfection("rotors.tachometer_std", "fixed", 0.005, "relative", "the tachometer's readings scatter with speed"),
    Imperfection("loadcell.gain_error", "normal", 0.01, "relative", "the load cell's axes read too much"),
    Imperfection("loadcell.crosstalk", "normal", 0.005, "of range", "the load cell's axes show each other's load"),
    Imperfection("loadcell.warm_up", "around", 0.02, "relative", "the load cell reads too little while it warms up"),
    Imperfection("loadcell.bias_wander", "fixed", 1e-4, "of range", "the load cell's bias wanders within a minute"),
    Imperfection("battery.charge", "around", 0.6, "of full", "a lithium cell sags (with battery.kind = lipo)"),
    Imperfection("radio.loss", "fixed", 0.01, "of all", "packets and reports are lost"),
    Imperfection("radio.jitter_shape", "around", 2.0, "1", "delays have no sharp lower edge"),
    Imperfection("radio.floor_wander_s", "fixed", 5e-3, "s", "the shortest delay wanders within a minute"),
    Imperfection("radio.congestion_s", "around", 0.03, "s", "packets take longer in times of congestion"),
    Imperfection("wind.anemometer_gain", "normal", 0.04, "relative", "the anemometer reads too much"),
)


def imperfection(key: str, *, size: float | None = None) -> Imperfection:
    """Return the imperfection of a key, with another size where one is given. Raises KeyError for an unknown key."""
    found = {entry.key: entry for entry in IMPERFECTIONS}[key]
    return found if size is None else found._replace(size=size)


def draw(truth: SimTruth, imperfections: Iterable[Imperfection], *, rng: np.random.Generator) -> SimTruth:
    """Return the truth of another rig, with a value for each of the imperfections drawn from its distribution."""
    for entry in imperfections:
        section, name = entry.key.split(".")
        part = getattr(truth, section)
        value = _drawn(entry, np.shape(getattr(part, name)), rng)
        changed = type(part).model_validate({**part.model_dump(exclude_unset=True), name: value.tolist()})
        truth = truth.model_copy(update={section: changed})
    return truth


def _drawn(entry: Imperfection, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    if entry.distribution == "normal":
        return np.asarray(entry.size * rng.standard_normal(shape))
    return np.asarray(entry.size * (rng.uniform(0.5, 1.5, shape) if entry.distribution == "around" else np.ones(shape)))
