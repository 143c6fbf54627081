"""Describe devices that send lines of text, as rig.toml has them: their ports, and what a line's values mean."""

import math
import re
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, PrivateAttr, model_validator

from cfid.errors import ConfigError
from cfid.records.facts import Number, Positive, RigTable
from cfid.units import MM
from cfid.wire.lines import LineReader, Value

STAMP = "device_us"  # a column of a run: when the device took the sample, by its own clock

_TICKS_US = {"device_us": 1.0, "device_ms": 1e3}  # the device's own clock
_UNUSED = "unused"
_COUNTS = "counts"
_GRAVITY = 9.80665  # of the unit kilogram-force, by definition
_NEWTONS = {"N": 1.0, "mN": 1e-3, "g": 1e-3 * _GRAVITY, "kg": _GRAVITY}
_NEWTON_METRES = {"Nm": 1.0, "mNm": 1e-3, "Nmm": 1e-3}
_RPM = {"rpm": 1.0, "Hz": 60.0, "rad/s": 30 / math.pi}
_GRAMS = {"g": 1.0, "kg": 1e3, "mg": 1e-3, "N": 1e3 / _GRAVITY}
_RADIANS = {_COUNTS: math.nan, "deg": math.pi / 180, "rad": 1.0}  # counts: encoder.counts_per_turn


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

    units: ClassVar[dict[str, dict[str, float]]]  # by value's name; sizes in the column's unit, usual one first

    kind: Literal["lines"]
    port: str = Field(min_length=1)
    baud: Annotated[int, Field(strict=True, ge=50)] = 115200
    rate_hz: Positive
    pattern: str = ""
    values: tuple[LineValue, ...] = Field(min_length=1)
    _at_the_same_port: tuple[str, ...] = PrivateAttr(())

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        names = [value.name for value in self.values if value.name != _UNUSED]
        if len(set(names)) < len(names) or len(set(names) & set(_TICKS_US)) > 1:
            raise ValueError("two of its values are the same")
        if not set(names) & set(self.units):
            raise ValueError(f"one of its values has to be {' or '.join(self.units)}")
        for value in self.values:
            self._check(value)
        if self.pattern:
            self._check_pattern()
        return self

    def _check(self, value: LineValue) -> None:
        if value.name not in self.units:
            if value.name not in (*_TICKS_US, _UNUSED):
                known = ", ".join((*self.units, *_TICKS_US, _UNUSED))
                raise ValueError(f"there is no value '{value.name}' here, but {known}")
            if value != LineValue(name=value.name):
                raise ValueError(f"the value {value.name} has no unit, scale or arm_mm")
            return
        units = self._units(value)
        if self.unit(value) not in units:
            raise ValueError(f"the value {value.name} is in {', '.join(units)}, not in '{value.unit}'")
        if not value.scale:
            raise ValueError(f"the scale of {value.name} is zero")
        if value.arm_mm is not None and self.units[value.name] is not _NEWTON_METRES:
            raise ValueError(f"the value {value.name} is no torque: it has no arm_mm")
        if self.unit(value) == _COUNTS and value.scale != 1:
            raise ValueError("counts have no scale, but encoder.counts_per_turn")

    def _check_pattern(self) -> None:
        try:
            groups = re.compile(self.pattern).groups
        except re.error as error:
            raise ValueError(f"its pattern is no regular expression: {error}") from None
        if groups != len(self.values):
            raise ValueError(f"its pattern has {groups} groups, such as (-?[0-9]+), for {len(self.values)} values")

    def _units(self, value: LineValue) -> dict[str, float]:
        return self.units[value.name] if value.arm_mm is None else _NEWTONS

    def unit(self, value: LineValue) -> str:
        """Return the unit of a value's number times its scale."""
        return value.unit or next(iter(self._units(value)))

    def factor(self, value: LineValue) -> float:
        """Return the factor by which a value's number is multiplied for its column."""
        if value.name in _TICKS_US:
            return _TICKS_US[value.name]
        if self.unit(value) == _COUNTS:
            return 1.0
        arm_m = 1.0 if value.arm_mm is None else MM * value.arm_mm
        return value.scale * self._units(value)[self.unit(value)] * arm_m

    def column_unit(self, value: LineValue) -> str:
        """Return the unit of a value's column in the run."""
        units = self.units[value.name]
        return _COUNTS if self.unit(value) == _COUNTS else next(unit for unit, size in units.items() if size == 1.0)

    @property
    def measured(self) -> tuple[LineValue, ...]:
        """The values that measure something, without the device's own time."""
        return tuple(value for value in self.values if value.name in self.units)

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

    def share_port(self, *names: str) -> None:
        """Keep the names of the other tables of rig.toml, such as devices.encoder, that have the same port."""
        self._at_the_same_port = names

    def unmatched(self, name: str) -> str:
        """Return what to compare where none of its lines match, and which other tables name its port."""
        others = self._at_the_same_port
        same = f"; {' and '.join(others)} {'have' if len(others) > 1 else 'has'} the same port" if others else ""
        return f"compare baud, pattern and values of devices.{name} in rig.toml with what it sends{same}"

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

    units: ClassVar[dict[str, dict[str, float]]] = {"phi": _RADIANS}

    @property
    def counted(self) -> bool:
        """Whether the angle is in counts."""
        return self.unit(self.measured[0]) == _COUNTS

    def turn(self, counts_per_turn: float | str) -> float | str:
        """Return a full turn in the unit of the recorded angle: `encoder.counts_per_turn` for counts, else radians."""
        return counts_per_turn if self.counted else math.tau


class LoadCellLines(LineDevice):
    """A load cell with one or more axes: forces and torques, where a torque may be measured as a force at an arm."""

    units: ClassVar[dict[str, dict[str, float]]] = {
        **dict.fromkeys(("Fx", "Fy", "Fz"), _NEWTONS),
        **dict.fromkeys(("Tx", "Ty", "Tz"), _NEWTON_METRES),
    }


class TachometerLines(LineDevice):
    """A tachometer, and how many `markers` it counts in one turn of a rotor: 1 where it sends turns of the rotor.

    `markers` has no default: markers on both blades double the reported speed, and no reading shows it.
    """

    markers: Annotated[int, Field(strict=True, ge=1)]
    units: ClassVar[dict[str, dict[str, float]]] = {"rpm": _RPM}


class ScalesLines(LineDevice):
    """Scales."""

    units: ClassVar[dict[str, dict[str, float]]] = {"grams": _GRAMS}
