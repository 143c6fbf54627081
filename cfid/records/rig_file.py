"""rig.toml: vehicle, mounts, test body and instruments as data; no physics.

Lengths are in millimetres and angles in degrees, as a calliper and a protractor show them; every `..._std_...` is one
standard uncertainty. Everything else is SI.
"""

import math
import tomllib
from collections.abc import Iterable, Mapping
from functools import reduce
from importlib import resources
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError

from cfid.errors import ConfigError
from cfid.quantities.registry import Platform
from cfid.records.devices import Devices
from cfid.records.facts import (
    LabBook,
    LoadCellMount,
    Positive,
    RigFacts,
    RigTable,
    Scales,
    Spread,
    Tachometer,
    WindStand,
)
from cfid.records.files import first_fault, locked_folder, read_toml, write_whole
from cfid.records.mounts import BodyFrame, Mount, SpreadVector, Vector
from cfid.units import USUAL_GRAVITY_MPS2

RIG_FILE = "rig.toml"


class VehicleData(RigTable):
    """The vehicle as weighed and measured: mass, centre of mass and body frame.

    `platform` sets what is plausible: `crazyflie` is any small quadrocopter, `other` any body that physics allows.
    """

    name: str = "vehicle"
    platform: Platform = "crazyflie"
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
    """The cube and the axis, which swing with every body: their mass, and their centre's distance from the axis.

    The distance counts towards the side to which the body hangs. The cube's edge gives their inertia where they were
    not swung alone.
    """

    mass_kg: Positive
    mass_std_kg: Spread = 0.0
    distance_mm: Positive
    distance_std_mm: Spread = 0.0
    edge_mm: Positive | None = None
    edge_std_mm: Spread = 0.0


class Site(RigTable):
    """Where the rig stands."""

    gravity_mps2: Positive = USUAL_GRAVITY_MPS2
    gravity_std_mps2: Spread = 0.0


class EncoderScale(RigTable):
    """The scale of the encoder: counts per turn, or the name of a word format."""

    counts_per_turn: Positive | Literal["rls-13bit-in-22"] = "rls-13bit-in-22"


class FrictionRig(RigTable):
    """The axis around which the fishing line of the dropping weights is wound, and the line's thickness.

    The weight pulls at the middle of the line: half its thickness adds to the radius of the axis.
    """

    radius_mm: Positive
    radius_std_mm: Spread = 0.0
    line_mm: Spread | None = None
    line_std_mm: Spread = 0.0

    @property
    def lever_mm(self) -> float:
        """The radius at which the weight pulls; a line whose thickness is not stated adds nothing."""
        return self.radius_mm + (self.line_mm or 0.0) / 2

    @property
    def lever_std_mm(self) -> float:
        """The standard uncertainty of the radius at which the weight pulls."""
        return math.hypot(self.radius_std_mm, self.line_std_mm / 2)


CampaignKind = Literal["full", "inertia", "motors", "afternoon"]


class CampaignGoal(RigTable):
    """What a campaign should find: everything, the inertia, the motors, or what an afternoon allows."""

    kind: CampaignKind = "full"


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
    friction: FrictionRig | None = None
    mounts: dict[str, Mount] = Field(default_factory=dict)
    fixture: Fixture | None = None
    testbody: TestBody | None = None

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
    return _checked(content, name=str(path))


def new_rig_text() -> str:
    """Return the commented rig.toml that a new campaign starts from: the thesis' vehicle, cube and test body."""
    return _preset("rig.toml")


def thesis_rig() -> Rig:
    """Return the rig of the thesis' calculation (C.1.2 to C.1.7), with the two directions of its xy mount."""
    content, differing = tomllib.loads(_preset("rig.toml")), tomllib.loads(_preset("thesis.toml"))
    for name, mount in differing["mounts"].items():
        content["mounts"][name] |= mount
    content["friction"] |= differing["friction"]
    return _checked(content, name="the thesis' rig")


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
                section[key] = value
            text = tomlkit.dumps(document)
            check_rig(text, name=str(path))
            write_whole(path, text.encode())
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}. It is unchanged.") from None
    return path


def check_rig(text: str, *, name: str) -> None:
    """Check a text before it is written as rig.toml. Raises ConfigError that names the key."""
    _checked(tomllib.loads(text), name=name)


def _checked(content: Mapping[str, object], *, name: str) -> Rig:
    try:
        return Rig.model_validate(content)
    except ValidationError as error:
        raise ConfigError(f"{name}: {first_fault(error, content)}") from None
