"""A campaign folder and its rig.toml: vehicle, mounts, test body and instruments as data; no physics.

Lengths are in millimetres and angles in degrees, as a calliper and a protractor show them; every `..._std_...` is one
standard uncertainty. Everything else is SI.
"""

import math
import tomllib
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal, Self

from pandas import DataFrame
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from cfid import __version__
from cfid.errors import ConfigError, FitError
from cfid.findings import texts
from cfid.records.facts import LoadCellMount, Number, Positive, RigFacts, RigTable, Tachometer, WindStand
from cfid.records.files import first_fault, read_toml
from cfid.records.fits import Fit, keep_fit
from cfid.records.parameters import Section, Source, load_sections, plain, store_section
from cfid.records.result import Result
from cfid.records.run import Run, list_runs
from cfid.units import FULL_COMMAND, USUAL_GRAVITY_MPS2
from cfid.units import MM as MM  # noqa: PLC0414, friction.command takes it from here

RIG_FILE = "rig.toml"
RUNS_FOLDER = "runs"
LAST = "last"

Vector = tuple[Number, Number, Number]
BodyAxis = Literal["x", "-x", "y", "-y", "z", "-z"]


def _non_zero(vector: Vector) -> Vector:
    if not math.hypot(*vector) > 0:
        raise ValueError("a direction needs a length above zero")
    return vector


Direction = Annotated[Vector, AfterValidator(_non_zero)]
Spread = Annotated[Number, Field(ge=0)]
SpreadVector = tuple[Spread, Spread, Spread]


class BodyFrame(RigTable):
    """Which body axis points forward, left and up."""

    forward: BodyAxis = "x"
    left: BodyAxis = "y"
    up: BodyAxis = "z"

    @model_validator(mode="after")
    def _right_handed(self) -> Self:
        forward, left, up = (_unit(axis) for axis in (self.forward, self.left, self.up))
        cross = (
            forward[1] * left[2] - forward[2] * left[1],
            forward[2] * left[0] - forward[0] * left[2],
            forward[0] * left[1] - forward[1] * left[0],
        )
        if cross != up:
            raise ValueError("forward, left and up must be three axes of a right-handed frame")
        return self


def _unit(axis: BodyAxis) -> tuple[int, int, int]:
    sign = -1 if axis.startswith("-") else 1
    x, y, z = (sign * int(axis[-1] == name) for name in "xyz")
    return x, y, z


class Mount(RigTable):
    """One way of fixing a body to the swing's axis: a point on the axis and its direction.

    The thesis measures the distance of its xy mount along another direction than it solves the tensor with (C.1.7
    against C.1.4), so the direction for the distance may differ; it defaults to `direction`. `point_yaw_deg` turns the
    frame in which the point was measured about z, so that numbers read along an arm can be entered as read.
    """

    point_mm: Vector
    point_std_mm: SpreadVector = (0.0, 0.0, 0.0)
    point_yaw_deg: Number = 0.0
    direction: Direction
    direction_std_deg: Spread = 0.0
    distance_direction: Direction | None = None

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


class VehicleData(RigTable):
    """The vehicle as weighed and measured: mass, centre of mass and body frame."""

    name: str = "vehicle"
    mass_kg: Positive
    mass_std_kg: Spread = 0.0
    centre_of_mass_mm: Vector
    centre_of_mass_std_mm: SpreadVector = (0.0, 0.0, 0.0)
    body_frame: BodyFrame = BodyFrame()


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
    length_std_mm: Spread = 0.0
    cuboids: tuple[Cuboid, ...] = Field(min_length=1)
    mounts: dict[str, Mount] = Field(default_factory=dict)


class Fixture(RigTable):
    """The parts that swing with every body: the cube and the axis, on the body's side of it."""

    mass_kg: Positive
    mass_std_kg: Spread = 0.0
    distance_mm: Positive
    distance_std_mm: Spread = 0.0


class Site(RigTable):
    """Where the rig stands."""

    gravity_mps2: Positive = USUAL_GRAVITY_MPS2
    gravity_std_mps2: Spread = 0.0


class EncoderScale(RigTable):
    """The scale of the encoder: counts per turn, or the name of a word format."""

    counts_per_turn: Positive | Literal["rls-13bit-in-22"] = "rls-13bit-in-22"


class FrictionRig(RigTable):
    """The axis around which the fishing line of the dropping weights is wound."""

    radius_mm: Positive
    radius_std_mm: Spread = 0.0


class EncoderPort(RigTable):
    """Serial port of the encoder's interface, found automatically where none is given, and the polling rate."""

    port: str = ""
    rate_hz: Positive = 1000.0


PortNumber = Annotated[int, Field(strict=True, ge=1, le=65535)]


class LoadCellBox(RigTable):
    """Address, sampling rate and ports of the load cell's box."""

    address: str = Field("192.168.1.1", min_length=1)
    rate_hz: Annotated[int, Field(strict=True, gt=0)] = 7000
    rdt_port: PortNumber = 49152
    http_port: PortNumber = 80
    tcp_port: PortNumber = 49151


ServicePort = Annotated[int, Field(strict=True, ge=0, le=15)]


class CrazyflieLink(RigTable):
    """Address of the vehicle, found by radio where none is given. The ports are those of cfid's app."""

    uri: str = ""
    thrust_port: ServicePort = 10
    sine_port: ServicePort = 11
    ping_port: ServicePort = 12
    largest_command: Annotated[int, Field(strict=True, ge=0, le=FULL_COMMAND)] = FULL_COMMAND
    stop_below_v: Positive | None = None


class Devices(RigTable):
    """The devices connected to this computer."""

    encoder: EncoderPort = EncoderPort()
    loadcell: LoadCellBox = LoadCellBox()
    crazyflie: CrazyflieLink = CrazyflieLink()


class Rig(RigTable):
    """The contents of rig.toml."""

    vehicle: VehicleData
    site: Site = Site()
    encoder: EncoderScale = EncoderScale()
    loadcell: LoadCellMount = LoadCellMount()
    tachometer: Tachometer = Tachometer()
    wind: WindStand = WindStand()
    devices: Devices = Devices()
    friction: FrictionRig | None = None
    mounts: dict[str, Mount] = Field(default_factory=dict)
    fixture: Fixture | None = None
    testbody: TestBody | None = None

    @property
    def facts(self) -> RigFacts:
        """How devices are mounted, as each run stores it."""
        return RigFacts(loadcell=self.loadcell, tachometer=self.tachometer, wind=self.wind)


class Campaign(BaseModel):
    """A folder with a rig.toml, the runs recorded in it and the parameters estimated from them."""

    model_config = ConfigDict(frozen=True)

    folder: Path
    rig: Rig

    @property
    def runs_folder(self) -> Path:
        """The folder of the runs."""
        return self.folder / RUNS_FOLDER

    @property
    def parameters_file(self) -> Path:
        """The file of the estimated parameters."""
        return self.folder / "parameters.toml"

    @property
    def fits_folder(self) -> Path:
        """The folder that keeps every fit."""
        return self.folder / "fits"

    def runs(self, *, kind: str | None = None, complete: bool = True) -> list[Run]:
        """Return the readable runs, oldest first: of a kind, by default only complete ones that are not excluded."""
        found = (run for run in list_runs(self.runs_folder) if isinstance(run, Run))
        return [
            run
            for run in found
            if kind in (None, run.header.kind)
            and (not complete or (run.header.state == "complete" and not run.header.excluded))
        ]

    def run(self, name: str) -> Run:
        """Return a run by its name, by a pattern that one name matches, as `last`, or as `last KIND`.

        `last` considers complete runs that are not excluded. Raises ConfigError when no run matches, or several do.
        """
        word, _, kind = name.partition(" ")
        if word == LAST:
            named = self.runs(kind=kind or None)[-1:]
        else:
            named = [run for run in self.runs(complete=False) if fnmatchcase(run.folder.name, name)]
        if len(named) != 1:
            raise ConfigError(f"{name}: {len(named) or 'no'} runs match, expected one ({self.runs_folder}).")
        return named[0]

    def sections(self) -> dict[str, Section]:
        """Return the sections of parameters.toml by fit. Raises DataError when the file is invalid."""
        return load_sections(self.parameters_file)

    def quantities(self) -> DataFrame:
        """Return a row for every estimated number: quantity, value, std, unit, section, accepted, found.

        Raises DataError when parameters.toml is invalid.
        """
        rows = [
            (one.name, one.value, one.std, parameter.unit, name, key not in section.rejected, section.found)
            for name, section in self.sections().items()
            for key, parameter in section.parameters.items()
            for one in parameter.numbers(key)
        ]
        return DataFrame(rows, columns=["quantity", "value", "std", "unit", "section", "accepted", "found"])

    def keep(self, result: Result, *, figures: Sequence[Path] = (), force: bool = False) -> Path:
        """Keep a result in parameters.toml and fits/, and return the path of the latter.

        Rejected quantities are kept only with `force`, and marked. Raises FitError when a quantity that the analysis is
        for was rejected and `force` is not set; ConfigError when a file cannot be written.
        """
        if not (result.accepted or force):
            raise FitError(
                f"rejected: {' '.join(texts(result.findings, 'rejection'))} {self.parameters_file} is unchanged."
            )
        given = result if force else result.without_rejected()
        section = Section(
            method=given.method,
            found=datetime.now(UTC).replace(microsecond=0),
            cfid_version=__version__,
            accepted=result.accepted,
            sources=tuple(Source(self._path_in(source.path), source.sha256) for source in given.sources),
            parameters=given.quantities,
            covariance=given.covariances,
            common=given.common,
            rejected=result.rejected,
        )
        fit = Fit(
            name=given.section or given.command.removeprefix("fit "),
            command=given.command,
            section=section,
            quality=plain(given.quality),
            findings=given.findings,
            lines=given.lines,
            figures=tuple(self._path_in(str(path)) for path in figures),
        )
        store_section(self.parameters_file, fit.name, section)
        return keep_fit(self.fits_folder, fit)

    def _path_in(self, path: str) -> str:
        """Return a path relative to the campaign's folder where it lies inside, else an absolute path."""
        there, folder = Path(path).resolve(), self.folder.resolve()
        return str(there.relative_to(folder) if there.is_relative_to(folder) else there)


def load_rig(path: Path) -> Rig:
    """Read a rig.toml.

    Raises ConfigError that names the file and the key.
    """
    try:
        content = read_toml(path, ConfigError)
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file. `cfid new DIR` makes a campaign with a commented one.") from None
    return _checked(content, name=str(path))


def new_rig_text() -> str:
    """Return the commented rig.toml that a new campaign starts from: the thesis' vehicle, cube and test body."""
    return _preset("rig.toml")


def thesis_rig() -> Rig:
    """Return the rig of the thesis' calculation (C.1.4, C.1.5, C.1.7), with the two directions of its xy mount."""
    content = tomllib.loads(_preset("rig.toml"))
    for name, differing in tomllib.loads(_preset("thesis.toml"))["mounts"].items():
        content["mounts"][name] |= differing
    return _checked(content, name="the thesis' rig")


def _preset(name: str) -> str:
    return (resources.files("cfid.records.presets") / name).read_text(encoding="utf-8")


def open_campaign(folder: str | Path | None = None) -> Campaign:
    """Open the campaign in a folder, else the nearest one at or above the current folder.

    Raises ConfigError when there is none.
    """
    found = find_campaign(None if folder is None else Path(folder), start=Path.cwd())
    if found is None:
        raise ConfigError(f"no {RIG_FILE} here or above: `cfid new DIR` makes a campaign; --campaign DIR names one.")
    return found


def find_campaign(folder: Path | None, *, start: Path) -> Campaign | None:
    """Open the campaign in `folder`, else the nearest one at or above `start`, else None.

    Raises ConfigError when a folder was named that holds no rig.toml.
    """
    if folder is not None:
        return Campaign(folder=folder, rig=load_rig(folder / RIG_FILE))
    for candidate in (start, *start.parents):
        if _has_rig(candidate):
            return Campaign(folder=candidate, rig=load_rig(candidate / RIG_FILE))
    return None


def _has_rig(folder: Path) -> bool:
    try:
        return (folder / RIG_FILE).is_file()
    except OSError:  # this user may not list that parent folder
        return False


def check_rig(text: str, *, name: str) -> None:
    """Check a text before it is written as rig.toml. Raises ConfigError that names the key."""
    _checked(tomllib.loads(text), name=name)


def _checked(content: Mapping[str, object], *, name: str) -> Rig:
    try:
        return Rig.model_validate(content)
    except ValidationError as error:
        raise ConfigError(f"{name}: {first_fault(error, content)}") from None
