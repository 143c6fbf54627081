"""Facts of a rig that stay the same from run to run: how devices are mounted, and how exact their scales are.

rig.toml states them and each run stores them. An unstated fact is None; the fit that needs it then assumes the value
of version 0.1 and adds a note.
"""

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

Number = Annotated[float, Field(strict=True)]  # strict: neither true nor "1" is a number
Positive = Annotated[Number, Field(gt=0)]
Spread = Annotated[Number, Field(ge=0)]


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
    arm_std_mm: Spread | None = None
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

    @property
    def stated(self) -> dict[str, Any]:
        """The facts that were stated, by table."""
        return {name: table for name, table in self.model_dump(exclude_none=True).items() if table}


NONE_STATED = RigFacts()
