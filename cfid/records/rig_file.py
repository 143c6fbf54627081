"""rig.toml: vehicle, mounts, test body, instruments and their facts as data; no physics.

Lengths are in millimetres and angles in degrees, as a calliper and a protractor show them; every `..._std_...` is one
standard uncertainty. Everything else is SI. Each run keeps the facts, which stay the same from run to run: how devices
are mounted, and how exact their scales are. An unstated fact is None; the fit that needs it then asks for it.
"""

import math
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from functools import reduce
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    PrivateAttr,
    Tag,
    ValidationError,
    model_validator,
)

from cfid.errors import ConfigError
from cfid.quantities.plausible import out_of_range
from cfid.quantities.registry import Platform, range_of
from cfid.records.files import RIG_FILE, first_fault, locked_folder, read_toml, write_whole
from cfid.records.rig_notation import plain, spelled
from cfid.units import CRYSTAL_STD, FULL_COMMAND, MM, USUAL_GRAVITY_MPS2, factor
from cfid.wire.lines import LineReader, Value

Number = Annotated[float, Field(strict=True)]  # strict: neither true nor "1" is a number
Positive = Annotated[Number, Field(gt=0)]
Spread = Annotated[Number, Field(ge=0)]

_LEAST_POINT_MM, _MOST_POINT_MM = 0.5, 10_000.0  # of the largest coordinate: metres are less, micrometres more
_LEAST_STD_MM = 0.001  # nobody measures a vehicle to less; numbers in metres are
_LEAST_CENTRE_MM = 0.1  # a tenth of what a balance on an edge shows


def _in_mm(std_mm: float) -> float:
    if 0 < std_mm < _LEAST_STD_MM:
        raise ValueError("nobody measures a length to less than 0.001 mm: metres?")
    return std_mm


SpreadMm = Annotated[Spread, AfterValidator(_in_mm)]


class RigTable(BaseModel):
    """A table of rig.toml."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class LoadCellMount(RigTable):
    """How the vehicle is mounted on the load cell.

    `yaw_deg` turns the cell's readings into the vehicle's frame, positive counterclockwise seen from above: a vector
    in the vehicle's frame (x to the nose, y left) is Rz(+yaw) times the one in the cell's. It is the angle by which the
    cell's x axis lies left of the nose. `arm_mm` is the distance from the cell's z axis to a motor's axis. With
    `flip_fz`, Fz and Tz count downwards.

    `gain` has the ratio of reading to load for Fx, Fy, Fz, Tx, Ty, Tz; readings are divided by it. `..._std` are
    standard uncertainties: `gain_std` of the gains, `linearity_std` relative to the load, `cross_talk_std` of the part
    of a force that another axis shows, and `cross_talk_std_nm_per_n` of the torque that the cell shows for a force.
    """

    yaw_deg: Number | None = None
    yaw_std_deg: Spread | None = None
    arm_mm: Positive | None = None
    arm_std_mm: SpreadMm | None = None
    flip_fz: Annotated[bool, Field(strict=True)] | None = None
    gain: tuple[Positive, Positive, Positive, Positive, Positive, Positive] | None = None
    gain_std: tuple[Spread, Spread, Spread, Spread, Spread, Spread] | None = None
    linearity_std: Spread | None = None
    cross_talk_std: Spread | None = None
    cross_talk_std_nm_per_n: Spread | None = None


class Tachometer(RigTable):
    """How many reflective markers a tachometer counts in one turn, and its relative standard uncertainty."""

    markers: Annotated[int, Field(strict=True, ge=1)] | None = None
    scale_std: Spread | None = None


class Scales(RigTable):
    """The relative standard uncertainty of the scales that weigh thrust and weights."""

    linearity_std: Spread | None = None


class WindStand(RigTable):
    """Where the wind generator stands: its azimuth about z, counted to the right of the nose.

    `yaw_deg` replaces that of the load cell where the vehicle is mounted differently for wind. `speed_scale_std` is the
    relative standard uncertainty of the anemometer.
    """

    azimuth_deg: Number | None = None
    azimuth_std_deg: Spread | None = None
    yaw_deg: Number | None = None
    speed_scale_std: Spread | None = None


class LabBook(RigTable):
    """Who records, and with what: text by the operator, which no fit reads."""

    operator: str | None = None
    battery: str | None = None
    propellers: str | None = None
    temperature_c: Number | None = None


class RigFacts(RigTable):
    """All facts of a rig, under the names of rig.toml's tables."""

    loadcell: LoadCellMount = LoadCellMount()
    tachometer: Tachometer = Tachometer()
    scales: Scales = Scales()
    wind: WindStand = WindStand()
    lab_book: LabBook = LabBook()

    @property
    def yaw_in_wind_deg(self) -> float | None:
        """The yaw of the load cell for runs in wind and their references."""
        return self.loadcell.yaw_deg if self.wind.yaw_deg is None else self.wind.yaw_deg

    def over(self, facts: "RigFacts") -> "RigFacts":
        """Return `facts` with the facts that are stated here in place of its own."""
        mine = {name: getattr(facts, name).model_copy(update=table) for name, table in self.stated.items()}
        return facts.model_copy(update=mine)

    def of(self, *tables: str) -> "RigFacts":
        """Return the facts of some tables, and the lab book: what a recording with these instruments rests on."""
        return RigFacts(**{name: getattr(self, name) for name in (*tables, "lab_book")})

    @property
    def stated(self) -> dict[str, Any]:
        """The facts that were stated, by table."""
        return {name: table for name, table in self.model_dump(exclude_none=True).items() if table}


NONE_STATED = RigFacts()


Vector = tuple[Number, Number, Number]
BodyAxis = Literal["x", "-x", "y", "-y", "z", "-z"]


def _non_zero(vector: Vector) -> Vector:
    if not math.hypot(*vector) > 0:
        raise ValueError("a direction needs a length above zero")
    return vector


Direction = Annotated[Vector, AfterValidator(_non_zero)]
SpreadVectorMm = tuple[SpreadMm, SpreadMm, SpreadMm]


class BodyFrame(RigTable):
    """Which body axes point forward, left and up."""

    forward: BodyAxis = "x"
    left: BodyAxis = "y"
    up: BodyAxis = "z"

    @model_validator(mode="after")
    def _right_handed(self) -> Self:
        places, signs = zip(*self.axes, strict=True)
        cyclic = (places[1] - places[0]) % 3 == 1
        if len(set(places)) < 3 or math.prod(signs) != (1 if cyclic else -1):
            raise ValueError("forward, left and up must be three axes of a right-handed frame")
        return self

    @property
    def axes(self) -> tuple[tuple[int, int], ...]:
        """Of forward, left and up, the index of the body axis and its sign."""
        return tuple(
            ("xyz".index(axis[-1]), -1 if axis.startswith("-") else 1) for axis in (self.forward, self.left, self.up)
        )

    def turned(self, vector: Sequence[float]) -> Vector:
        """Return the forward, left and up components of a vector (3,) of the body frame, without rounding."""
        forward, left, up = (sign * vector[place] + 0.0 for place, sign in self.axes)
        return forward, left, up


class ThreadPair(RigTable):
    """Two threads of equal length that a body hangs on: their distance from each other above and below, and the length.

    The vertical through the centre of mass passes midway between the threads, above and below, except for an error
    along the line that joins them, of standard uncertainty `centre_std_mm`.
    """

    above_mm: Positive
    above_std_mm: SpreadMm = 0.0
    below_mm: Positive
    below_std_mm: SpreadMm = 0.0
    length_mm: Positive
    length_std_mm: SpreadMm = 0.0
    centre_std_mm: SpreadMm = 1.0

    @model_validator(mode="after")
    def _long_enough(self) -> Self:
        if self.length_mm <= abs(self.above_mm - self.below_mm) / 2:
            raise ValueError("threads of this length do not reach from above_mm to below_mm")
        if self.centre_std_mm > self.below_mm / 8:
            raise ValueError("centre_std_mm is more than an eighth of below_mm: balance the body between the threads")
        return self

    @property
    def lengths_m(self) -> tuple[Vector, Vector]:
        """Both distances and the length, and their standard uncertainties."""
        values = MM * self.above_mm, MM * self.below_mm, MM * self.length_mm
        return values, (MM * self.above_std_mm, MM * self.below_std_mm, MM * self.length_std_mm)

    @property
    def off_centre(self) -> tuple[float, float]:
        """The relative loss of the threads' torque, as the one nearer the centre of mass carries more: mean and std.

        The torque is proportional to x y, with lower ends at the distances x and y from the centre. A body centred
        between them has a quarter of the square of their distance instead. The mean is over the error of the centre,
        to either side.
        """
        mean = (2 * self.centre_std_mm / self.below_mm) ** 2
        return mean, math.sqrt(2) * mean


class Mount(RigTable):
    """One way of fixing a body to the swing's axis: a point on the axis and its direction.

    With `threads` the body hangs on two threads instead and turns about the vertical: `direction` is then that of the
    vertical through the centre of mass, and no point is needed.

    The thesis measures the distance of its xy mount along a different direction (C.1.7) from the one that it uses for
    the tensor (C.1.4), so `distance_direction` may differ; it defaults to `direction`. `point_yaw_deg` turns the
    frame in which the point was measured about z, so that numbers read along an arm can be entered as read.
    """

    point_mm: Vector = (0.0, 0.0, 0.0)
    point_std_mm: SpreadVectorMm = (0.0, 0.0, 0.0)
    point_yaw_deg: Number = 0.0
    direction: Direction
    direction_std_deg: Spread = 0.0
    distance_direction: Direction | None = None
    threads: ThreadPair | None = None

    @model_validator(mode="after")
    def _hangs_somewhere(self) -> Self:
        if self.threads is None and "point_mm" not in self.model_fields_set:
            raise ValueError("point_mm is required: a point on the axis, or threads that the body hangs on")
        return self

    @property
    def point_m(self) -> Vector:
        """The point in the body frame, turned back from the frame it was measured in."""
        return self._turned(self.point_mm)

    @property
    def point_axes(self) -> tuple[Vector, Vector, Vector]:
        """The unit vectors, in the body frame, along which the point's three numbers were measured."""
        return self._turned((1e3, 0, 0)), self._turned((0, 1e3, 0)), self._turned((0, 0, 1e3))

    def _turned(self, vector_mm: Vector) -> Vector:
        yaw = math.radians(self.point_yaw_deg)
        x, y, z = vector_mm
        return (
            MM * (math.cos(yaw) * x - math.sin(yaw) * y),
            MM * (math.sin(yaw) * x + math.cos(yaw) * y),
            MM * z,
        )


STAMP = "device_us"  # a column of a run: when the device took the sample, by its own clock

_TICKS_US = {"device_us": 1.0, "device_ms": 1e3}  # the device's own clock
_UNUSED = "unused"
_COUNTS = "counts"  # of encoder.counts_per_turn


class LineValue(RigTable):
    """A value of a line: what it measures, and the unit of its number times `scale`.

    With `arm_mm`, the distance from a torque's axis to where a force is measured, that force gives the torque.
    """

    name: str
    unit: str = ""
    scale: Number = 1.0
    arm_mm: Positive | None = None


class LineDevice(RigTable):
    """A device that sends `rate_hz` lines a second unprompted; a `pattern` has a group for each value."""

    measures: ClassVar[Mapping[str, tuple[str, str]]]  # by value's name: its column's unit, and the SI unit of its kind

    kind: Literal["lines"]
    port: str = Field(min_length=1)
    baud: Annotated[int, Field(strict=True, ge=50)] = 115200
    rate_hz: Positive
    pattern: str = ""
    values: tuple[LineValue, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        names = [value.name for value in self.values if value.name != _UNUSED]
        known = (*self.measures, *_TICKS_US, _UNUSED)
        if unknown := [name for name in names if name not in known]:
            raise ValueError(f"there is no value '{unknown[0]}' here, but {', '.join(known)}")
        if len(set(names)) < len(names) or len(set(names) & set(_TICKS_US)) > 1:
            raise ValueError("two of its values are the same")
        if not self.measured:
            raise ValueError(f"one of its values has to be {' or '.join(self.measures)}")
        for value in self.values:
            self._check(value)
        try:
            groups = re.compile(self.pattern).groups
        except re.error as error:
            raise ValueError(f"its pattern is no regular expression: {error}") from None
        if self.pattern and groups != len(self.values):
            raise ValueError(f"its pattern has {groups} groups, such as (-?[0-9]+), for {len(self.values)} values")
        return self

    def _check(self, value: LineValue) -> None:
        if value.name not in self.measures:
            if value != LineValue(name=value.name):
                raise ValueError(f"the value {value.name} has no unit, scale or arm_mm")
            return
        column, si = self.measures[value.name]
        if value.arm_mm is not None and si != "N m":
            raise ValueError(f"the value {value.name} is no torque: it has no arm_mm")
        if self._size(value) is None:
            usual = "N at an arm" if value.arm_mm is not None else column
            raise ValueError(f"the value {value.name} is in {usual} or another unit of its kind, not '{value.unit}'")
        if not value.scale:
            raise ValueError(f"the scale of {value.name} is zero")
        if self.unit(value) == _COUNTS and value.scale != 1:
            raise ValueError("counts have no scale, but encoder.counts_per_turn")

    def _size(self, value: LineValue) -> float | None:
        """Return the factor from a value's unit to that of its column, None for a unit of another kind."""
        column, si = self.measures[value.name]
        if self.unit(value) == _COUNTS:
            return 1.0 if si == "rad" else None
        size = factor(self.unit(value), si if value.arm_mm is None else "N")
        return None if size is None else size / (factor(column, si) or 1.0)

    def unit(self, value: LineValue) -> str:
        """Return the unit of a value's number times its scale."""
        column, si = self.measures[value.name]
        return value.unit or ("N" if value.arm_mm is not None else _COUNTS if si == "rad" else column)

    def factor(self, value: LineValue) -> float:
        """Return the factor by which a value's number is multiplied for its column."""
        if value.name in _TICKS_US:
            return _TICKS_US[value.name]
        arm_m = 1.0 if value.arm_mm is None else MM * value.arm_mm
        return value.scale * (self._size(value) or 1.0) * arm_m

    def column_unit(self, value: LineValue) -> str:
        """Return the unit of a value's column in the run."""
        return _COUNTS if self.unit(value) == _COUNTS else self.measures[value.name][0]

    @property
    def measured(self) -> tuple[LineValue, ...]:
        """The values that measure something, without the device's own time."""
        return tuple(value for value in self.values if value.name in self.measures)

    @property
    def stamp(self) -> LineValue | None:
        """The value that is the device's own time, None without one."""
        return next((value for value in self.values if value.name in _TICKS_US), None)

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns of the device's file: `t`, what is measured, and the device's own time."""
        return ("t", *(value.name for value in self.measured), *((STAMP,) if self.stamp else ()))

    def reader(self) -> LineReader:
        """Return a reader of the device's lines, whose numbers are those of the values `in_order`."""
        kinds = [
            Value(
                used=value.name != _UNUSED,
                whole=value.name in _TICKS_US or (value in self.measured and self.unit(value) == _COUNTS),
            )
            for value in self.values
        ]
        return LineReader(kinds, pattern=self.pattern)

    def unmatched(self, name: str) -> str:
        """Return what to compare where none of its lines match."""
        return (
            f"compare baud, pattern and values of devices.{name} in rig.toml with what it sends, and whether another "
            "table there has its port"
        )

    def in_order(self) -> tuple[LineValue, ...]:
        """Return the values that are read, in the order of a line."""
        return tuple(value for value in self.values if value.name != _UNUSED)

    def sampled_at(self, rate_hz: float | None) -> Self:
        """Return the device itself. Raises ConfigError where a rate is requested."""
        if rate_hz is not None:
            raise ConfigError(f"{self.port}: sends lines at a rate of its own, which no option sets.")
        return self


class EncoderLines(LineDevice):
    """An encoder, in counts (`encoder.counts_per_turn`), degrees or radians."""

    measures: ClassVar[Mapping[str, tuple[str, str]]] = {"phi": ("rad", "rad")}

    @property
    def counted(self) -> bool:
        """Whether the angle is in counts."""
        return self.unit(self.measured[0]) == _COUNTS

    def turn(self, counts_per_turn: float | str) -> float | str:
        """Return a full turn in the unit of the recorded angle: `encoder.counts_per_turn` for counts, else radians."""
        return counts_per_turn if self.counted else math.tau


class LoadCellLines(LineDevice):
    """A load cell with one or more axes: forces and torques, where a torque may be measured as a force at an arm."""

    measures: ClassVar[Mapping[str, tuple[str, str]]] = {
        **dict.fromkeys(("Fx", "Fy", "Fz"), ("N", "N")),
        **dict.fromkeys(("Tx", "Ty", "Tz"), ("Nm", "N m")),
    }


class TachometerLines(LineDevice):
    """A tachometer, and how many `markers` it counts in one turn of a rotor: 1 where it sends turns of the rotor.

    `markers` has no default: markers on both blades double the reported speed, and no reading shows it.
    """

    markers: Annotated[int, Field(strict=True, ge=1)]
    measures: ClassVar[Mapping[str, tuple[str, str]]] = {"rpm": ("rpm", "rad/s")}


class ScalesLines(LineDevice):
    """Scales."""

    measures: ClassVar[Mapping[str, tuple[str, str]]] = {"grams": ("g", "N")}


_LINES = "lines"


class PolledDevice(RigTable):
    """A device that is asked for its rate."""

    def sampled_at(self, rate_hz: float | None) -> Self:
        """Return the same device with another rate, where one is given."""
        return self if rate_hz is None else self.model_copy(update={"rate_hz": rate_hz})


class EncoderPort(PolledDevice):
    """Serial port of the encoder's interface, found automatically where none is given, and the polling rate."""

    kind: Literal["e201"] = "e201"
    port: str = ""
    rate_hz: Positive = 1000.0


PortNumber = Annotated[int, Field(strict=True, ge=1, le=65535)]


class LoadCellBox(PolledDevice):
    """Address, sampling rate and ports of the load cell's box."""

    kind: Literal["netft"] = "netft"
    address: str = Field("192.168.1.1", min_length=1)
    rate_hz: Annotated[int, Field(strict=True, gt=0)] = 7000
    rdt_port: PortNumber = 49152
    http_port: PortNumber = 80
    tcp_port: PortNumber = 49151


ServicePort = Annotated[int, Field(strict=True, ge=0, le=15)]


class CrazyflieLink(RigTable):
    """Address of the vehicle, found by radio where none is given. The ports are those of cfid's app.

    A `supply` feeds it in place of a battery, so that no charge has to last for a recording.
    """

    uri: str = ""
    thrust_port: ServicePort = 10
    sine_port: ServicePort = 11
    ping_port: ServicePort = 12
    largest_command: Annotated[int, Field(strict=True, ge=0, le=FULL_COMMAND)] = FULL_COMMAND
    supply: bool = False
    stop_below_v: Positive | None = None


def _sort(device: object) -> str:
    kind = device.get("kind") if isinstance(device, Mapping) else getattr(device, "kind", None)
    return _LINES if kind == _LINES else "own"


EncoderDevice = Annotated[
    Annotated[EncoderPort, Tag("own")] | Annotated[EncoderLines, Tag(_LINES)], Discriminator(_sort)
]
LoadCellDevice = Annotated[
    Annotated[LoadCellBox, Tag("own")] | Annotated[LoadCellLines, Tag(_LINES)], Discriminator(_sort)
]


class Devices(RigTable):
    """The devices connected to this computer."""

    encoder: EncoderDevice = EncoderPort()
    loadcell: LoadCellDevice = LoadCellBox()
    crazyflie: CrazyflieLink = CrazyflieLink()
    tachometer: TachometerLines | None = None
    scales: ScalesLines | None = None


class VehicleData(RigTable):
    """The vehicle as weighed and measured: mass, centre of mass and body frame.

    `platform` sets what is plausible: `crazyflie` is any small quadrocopter, `other` any body that physics allows.
    """

    name: str = "vehicle"
    platform: Platform = "crazyflie"
    mass_kg: Positive
    mass_std_kg: Spread = 0.0
    centre_of_mass_mm: Vector
    centre_of_mass_std_mm: SpreadVectorMm = (0.0, 0.0, 0.0)
    body_frame: BodyFrame = BodyFrame()

    @model_validator(mode="after")
    def _in_its_units(self) -> Self:
        expected = None if self.platform == "other" else range_of("mass_kg", self.platform)
        fault = expected and out_of_range("mass_kg is implausible", self.mass_kg, expected, "kg")
        if fault:
            raise ValueError(f'{fault} For another kind of body write platform = "other"')
        largest_mm = max(map(abs, self.centre_of_mass_mm))
        if 0 < largest_mm < _LEAST_CENTRE_MM:
            raise ValueError(
                f"centre_of_mass_mm is {largest_mm:g} mm at most, which nobody measures: metres? Write zeros where the "
                "origin is the centre of mass"
            )
        return self


class Cuboid(RigTable):
    """A box of the test body: edge lengths and centre in the body frame."""

    size_mm: tuple[Positive, Positive, Positive]
    centre_mm: Vector


class TestBody(RigTable):
    """A body of one material whose inertia follows from its drawing."""

    __test__ = False  # not a class of tests

    name: str = "test body"
    mass_kg: Positive
    mass_std_kg: Spread = 0.0
    length_std_mm: SpreadMm = 0.0
    cuboids: tuple[Cuboid, ...] = Field(min_length=1)
    mounts: dict[str, Mount] = Field(default_factory=dict)


class Fixture(RigTable):
    """The cube and the axis, which swing with every body: their mass, and their centre's distance from the axis.

    The distance counts towards the side to which the body hangs. The cube's edge gives their inertia where they were
    not swung alone.
    """

    mass_kg: Positive
    mass_std_kg: Spread = 0.0
    distance_mm: Positive
    distance_std_mm: SpreadMm = 0.0
    edge_mm: Positive | None = None
    edge_std_mm: SpreadMm = 0.0


class Site(RigTable):
    """Where the rig stands."""

    gravity_mps2: Annotated[Number, Field(ge=9.7, le=9.9)] = USUAL_GRAVITY_MPS2
    gravity_std_mps2: Spread = 0.0


class EncoderScale(RigTable):
    """The encoder: counts per turn, or the name of a word format, and the clock that stamps its readings.

    `clock_std` is the relative standard uncertainty of that clock: 0.00005 for a crystal, 0.003 for a resonator.
    `disc_std_deg` is that of either amplitude of the angle's error within a turn, and `cable_std` that of the stiffness
    of a cable that swings with a body, over gravity's; where they are not stated, a swing shows how large they may be.
    """

    counts_per_turn: Positive | Literal["rls-13bit-in-22"] = "rls-13bit-in-22"
    clock_std: Spread = CRYSTAL_STD
    disc_std_deg: Spread | None = None
    cable_std: Spread | None = None


class FrictionRig(RigTable):
    """The axis around which the fishing line of the dropping weights is wound, and the line's thickness.

    The weight pulls at the middle of the line: half its thickness adds to the radius of the axis.
    """

    radius_mm: Positive
    radius_std_mm: SpreadMm = 0.0
    line_mm: Spread | None = None
    line_std_mm: SpreadMm = 0.0

    @property
    def lever_mm(self) -> float:
        """The radius at which the weight pulls; a line whose thickness is not stated adds nothing."""
        return self.radius_mm + (self.line_mm or 0.0) / 2

    @property
    def lever_std_mm(self) -> float:
        """The standard uncertainty of the radius at which the weight pulls."""
        return math.hypot(self.radius_std_mm, self.line_std_mm / 2)


CampaignKind = Literal["full", "inertia", "motors", "afternoon", "owner"]
Preset = Literal["rig", "owner", "simulated", "thesis"]


class CampaignGoal(RigTable):
    """What a campaign should find: everything, the inertia, the motors, what an afternoon or an owner's tools allow.

    `seed` is that of the random order of mounts, so that a copy of the campaign keeps it.
    """

    kind: CampaignKind = "full"
    seed: Annotated[int, Field(strict=True, ge=0)] = 0


class CheckLimits(RigTable):
    """The limits of `cfid rig check --signals`, and of the look before motors turn.

    `rate` is a fraction of the requested rate, `losses` one of the samples. `load`, `noise` and `drift` are fractions
    of each axis' range of a load cell, `noise_deg` and `drift_deg` of a pendulum at rest.
    """

    rate: Positive = 0.95
    losses: Spread = 0.01
    load: Positive = 0.8
    noise: Positive = 1e-3
    drift: Positive = 2e-4
    noise_deg: Positive = 0.5
    drift_deg: Positive = 0.2
    battery_v: Spread = 3.7


class Rig(RigTable):
    """The contents of rig.toml."""

    vehicle: VehicleData
    campaign: CampaignGoal = CampaignGoal()
    site: Site = Site()
    encoder: EncoderScale = EncoderScale()
    loadcell: LoadCellMount = LoadCellMount()
    tachometer: Tachometer = Tachometer()
    scales: Scales = Scales()
    wind: WindStand = WindStand()
    lab_book: LabBook = LabBook()
    devices: Devices = Devices()
    check: CheckLimits = CheckLimits()
    friction: FrictionRig | None = None
    mounts: dict[str, Mount] = Field(default_factory=dict)
    fixture: Fixture | None = None
    testbody: TestBody | None = None
    _unknown: tuple[str, ...] = PrivateAttr(())

    @model_validator(mode="after")
    def _in_mm(self) -> Self:
        of_test_body = {} if self.testbody is None else self.testbody.mounts
        for table, mounts in (("mounts", self.mounts), ("testbody.mounts", of_test_body)):
            for name, mount in mounts.items():
                largest_mm = max(map(abs, mount.point_mm))
                if 0 < largest_mm < _LEAST_POINT_MM or largest_mm > _MOST_POINT_MM:
                    raise ValueError(f"{table}.{name}.point_mm: no point of a rig lies there; millimetres are expected")
        arm_mm, platform = self.loadcell.arm_mm, self.vehicle.platform
        expected = None if arm_mm is None or platform == "other" else range_of("arm_m", platform)
        if arm_mm is not None and expected and not expected.least <= MM * arm_mm <= expected.largest:
            raise ValueError(
                f"loadcell.arm_mm = {arm_mm:g} is implausible: {expected.least / MM:g} to {expected.largest / MM:g} mm "
                f'are expected of {platform}. For another kind of body write platform = "other"'
            )
        return self

    @classmethod
    def of(cls, content: Mapping[str, object], *, name: str) -> Self:
        """Return the rig of a file's content.

        Raises ConfigError that names the file, `name`, and the key.
        """
        numbers, unknown = plain(content, name=name)
        try:
            rig = cls.model_validate(numbers)
        except ValidationError as error:
            missing = all(fault["type"] == "missing" for fault in error.errors())
            fault = _to_measure(unknown) if unknown and missing else first_fault(error, numbers)
            raise ConfigError(f"{name}: {fault}") from None
        rig._unknown = unknown
        return rig

    def unknown(self, *keys: str) -> str:
        """Return a sentence on what is still to measure, of some keys or of all, "" for nothing."""
        unknown = [key for key in self._unknown if key in keys or not keys]
        return _to_measure(unknown) if unknown else ""

    @property
    def facts(self) -> RigFacts:
        """How devices are mounted and how exact they are, as each run stores it."""
        return RigFacts(
            loadcell=self.loadcell,
            tachometer=self.tachometer,
            scales=self.scales,
            wind=self.wind,
            lab_book=self.lab_book,
        )


def stated(rig: Rig, keys: Iterable[str]) -> dict[str, Any]:
    """Return what a rig.toml states under some keys, as in "vehicle.mass_kg" or "mounts.x", as plain tables and lists.

    Keys for which it states nothing are left out.
    """
    content = rig.model_dump(mode="json", exclude_none=True)
    found = {key: reduce(_under, key.split("."), content) for key in keys}
    return {key: value for key, value in found.items() if value is not None}


def _under(table: Any, name: str) -> Any:
    return table.get(name) if isinstance(table, dict) else None


def load_rig(path: Path) -> Rig:
    """Read a rig.toml.

    Raises ConfigError that names the file and the key.
    """
    try:
        content = read_toml(path, ConfigError)
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file. `cfid new DIR` makes a campaign with a commented one.") from None
    return Rig.of(content, name=str(path))


_PLATFORM = re.compile(r'^(platform = )"\w+"', re.MULTILINE)


def new_rig_text(*, seed: int = 0, kind: Preset = "simulated", platform: Platform | None = None) -> str:
    """Return the commented rig.toml that a new campaign starts from, of a vehicle of a platform.

    For a `rig` and for an `owner` without one, what has to be measured is a "?". The `simulated` rig has the thesis'
    vehicle, cube and test body; for `thesis`, what its calculation has otherwise is as there (C.1.2 to C.1.7).
    """
    text = _preset(f"{'simulated' if kind == 'thesis' else kind}.toml").replace("seed = 0 ", f"seed = {seed} ")
    if platform is not None:
        text = _PLATFORM.sub(rf'\1"{platform}"', text)
    if kind != "thesis":
        return text
    import tomlkit  # slow to load

    document = tomlkit.parse(text)
    _calculate_as_thesis(document)
    return tomlkit.dumps(document)


def thesis_rig() -> Rig:
    """Return the rig of the thesis' calculation (C.1.2 to C.1.7), with the two directions of its xy mount."""
    content = tomllib.loads(_preset("simulated.toml"))
    _calculate_as_thesis(content)
    return Rig.of(content, name="the thesis' rig")


def _calculate_as_thesis(content: dict[str, Any]) -> None:
    differing = tomllib.loads(_preset("thesis.toml"))
    for name, mount in differing["mounts"].items():
        content["mounts"][name].update(mount)
    content["friction"].update(differing["friction"])


def _preset(name: str) -> str:
    return (resources.files("cfid.records.presets") / name).read_text(encoding="utf-8")


def change_rig(folder: Path, table: str, keys: Mapping[str, object]) -> Path:
    """Set keys of a table of a campaign's rig.toml, atomically; comments stay. Returns the file's path.

    Raises ConfigError that names the key, or the reason why the file cannot be written; it is then unchanged.
    """
    import tomlkit  # slow to load, and not needed to read rig.toml

    path = folder / RIG_FILE
    try:
        with locked_folder(folder):
            document = tomlkit.parse(path.read_text("utf-8-sig"))
            section = document.setdefault(table, tomlkit.table())
            for key, value in keys.items():
                written = spelled(section, key)
                if written is None or (written == key and not isinstance(section[key], str)):
                    section[key] = value
                    continue
                text = section.pop(written)
                section.update(plain({written: text}, name=str(path))[0])
                section[key] = value
                if comment := text.trivia.comment.removeprefix("#").strip():
                    section[key].comment(comment)
            text = tomlkit.dumps(document)
            Rig.of(tomllib.loads(text), name=str(path))
            write_whole(path, text.encode())
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}. It is unchanged.") from None
    return path


def _to_measure(keys: Sequence[str]) -> str:
    return f'still to measure: {", ".join(keys)}. Put numbers there in place of "?", and delete what you do not have.'
