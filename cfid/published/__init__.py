"""Published values of the Crazyflie, from tables.toml, and matrices turned to the axes forward, left and up."""

import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import NamedTuple

from cfid.records.rig_file import BodyFrame


class Row(NamedTuple):
    """The values of one source, one for each column; an inertia is xx, yy, zz and, if known, xy, xz, yz in `frame`."""

    who: str
    vehicle: str
    values: tuple[float, ...]
    source: str
    note: str
    frame: BodyFrame


class Table(NamedTuple):
    """A published quantity in one unit; `at` has the abscissa of each column, such as a command, where there is one."""

    title: str
    about: str
    columns: tuple[str, ...]
    unit: str
    at: tuple[float, ...]
    rows: tuple[Row, ...]

    def row(self, who: str, vehicle: str) -> Row:
        """Return the values of a source for a vehicle."""
        return next(row for row in self.rows if (row.who, row.vehicle) == (who, vehicle))


@cache
def tables() -> Mapping[str, Table]:
    """Return the published tables by name."""
    content = tomllib.loads((files(__name__) / "tables.toml").read_text(encoding="utf-8"))
    sources = content["sources"]
    return {
        name: Table(
            title=table["title"],
            about=table.get("about", ""),
            columns=tuple(table["columns"]),
            unit=table["unit"],
            at=tuple(table.get("at", ())),
            rows=tuple(
                Row(
                    who=row["who"],
                    vehicle=row["vehicle"],
                    values=tuple(row["values"]),
                    source=", ".join(filter(None, [sources[row["source"]], row.get("place")])),
                    note=row.get("note", ""),
                    frame=BodyFrame(**dict(zip(("forward", "left", "up"), row.get("frame", "xyz"), strict=True))),
                )
                for row in table["rows"]
            ),
        )
        for name, table in content["tables"].items()
    }


def turned(matrix: Sequence[Sequence[float]], frame: BodyFrame) -> dict[str, float]:
    """Return the entries of a symmetric matrix (3, 3) of a body frame, turned to the axes forward, left and up.

    Roll is about forward, pitch about left, yaw about up. Products of inertia remain entries of the matrix, with its
    sign convention.
    """
    axes = dict(zip(("roll", "pitch", "yaw"), frame.axes, strict=True))
    pairs = [("roll", "roll"), ("pitch", "pitch"), ("yaw", "yaw"), ("roll", "pitch"), ("roll", "yaw"), ("pitch", "yaw")]
    return {
        first if first == second else f"{first}-{second}": sign * other_sign * matrix[i][j]
        for first, second in pairs
        for (i, sign), (j, other_sign) in [(axes[first], axes[second])]
    }
