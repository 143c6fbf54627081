"""Parameter sets that others published, one file a set, and matrices turned to the axes forward, left and up."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from cfid.errors import ConfigError
from cfid.published.formulas import with_calculated
from cfid.published.set_file import PublishedValue, SetFile
from cfid.quantities.registry import Platform
from cfid.records.files import first_fault, read_toml
from cfid.records.rig_file import BodyFrame

_FIRST = "thesis"  # in every list, since the experiments are the thesis'


@dataclass(frozen=True, kw_only=True)
class PublishedSet:
    """The values that a source states for a vehicle, in SI units and in its own body frame.

    `title` is the source's name in reports, `payload` what the vehicle carried when it was weighed, `method` how the
    source got its values. Of several values of a key the first counts.
    """

    name: str
    title: str
    source: str
    vehicle: str
    platform: Platform
    payload: str
    method: str
    frame: BodyFrame
    values: tuple[PublishedValue, ...]

    def find(self, key: str) -> PublishedValue | None:
        """Return the value of a key that counts, None where the set has none."""
        return next((value for value in self.values if value.key == key), None)

    def __getitem__(self, key: str) -> PublishedValue:
        """Return the value of a key that counts. Raises KeyError where the set has none."""
        value = self.find(key)
        if value is None:
            raise KeyError(f"{self.name} does not state {key}")
        return value

    def origin(self, value: PublishedValue) -> str:
        """Return the source of a value, with its place there."""
        return ", ".join(filter(None, [self.source, value.place]))


@cache
def published_sets() -> Mapping[str, PublishedSet]:
    """Return the sets that cfid has by name, the thesis first."""
    paths = [path for path in files(__name__).iterdir() if path.name.endswith(".toml")]
    sets = [_checked(tomllib.loads(path.read_text(encoding="utf-8")), path.name) for path in paths]
    ordered = sorted(sets, key=lambda published: (published.name != _FIRST, published.name))
    return {published.name: published for published in ordered}


def published_set(name: str) -> PublishedSet:
    """Return a set that cfid has, or the one in a TOML file. Raises ConfigError for another name or an invalid file."""
    if name in published_sets():
        return published_sets()[name]
    path = Path(name)
    if path.suffix != ".toml":
        raise ConfigError(
            f"{name}: no published set, and no FILE.toml with one. There are {', '.join(published_sets())}."
        )
    try:
        return _checked(read_toml(path, ConfigError), name)
    except FileNotFoundError:
        raise ConfigError(f"{name}: no such file. Published sets are {', '.join(published_sets())}.") from None


def _checked(content: Mapping[str, Any], name: str) -> PublishedSet:
    try:
        file = SetFile.model_validate(content)
    except ValidationError as error:
        raise ConfigError(f"{name}: {first_fault(error, content)}") from None
    facts = file.model_dump(exclude={"frame", "quantities"})
    try:
        values = with_calculated([quantity.converted() for quantity in file.quantities])
    except ArithmeticError as error:
        raise ConfigError(f"{name}: no vehicle has these formulas: {error}.") from None
    return PublishedSet(**facts, frame=file.frame, values=values)


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
