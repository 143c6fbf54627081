"""The file of a published set: each number as its source prints it, with its unit and its place there.

A number is converted to the registry's unit when it is read. The unit is written as in the registry, `N(cmd)` for a
polynomial; `g of 4 motors` is what four motors pull together, of which one is taken.
"""

import re
from collections.abc import Callable, Iterable
from typing import Annotated, Any, NamedTuple, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from cfid.quantities.registry import Platform, Quantity, Shape, find, registered
from cfid.quantities.values import leaves, shape_error
from cfid.records.rig_file import BodyFrame
from cfid.units import RPM, UNITS, factor

# Units that sources print beside those of `cfid.units`, with the factor to the registry's.
_FACTORS = {
    "kg": {"g": 1e-3},
    "kg m^2": {"g m^2": 1e-3, "kg mm^2": 1e-6, "g cm^2": 1e-7, "g mm^2": 1e-9},
    "N s^2/rad^2": {"N/rpm^2": RPM**-2},
    "cmd": {"%": 655.36},  # of 16 bits: a step of 6.25 % is 4096
}
_COLUMNS = {"cmd": "cmd", "thrust_n": "N", "torque_nm": "N m", "speed_rad_s": "rad/s", "voltage_v": "V"}
_UNIT = re.compile(r"(?P<of>[^()]+?)(?: of (?P<motors>[2-9]) motors)?(?:\((?P<over>[^()]+(?:\([^()]+\))?)\))?")

Text = Annotated[str, Field(min_length=1, max_length=300)]
_Number = Annotated[float, Field(strict=True)]
Printed = _Number | list[_Number] | list[list[_Number]]


class PublishedValue(NamedTuple):
    """A value in the registry's unit and shape, `std` as the value or None where the source states none.

    `variant` distinguishes values of one source, of which the first counts. `calculated` marks what follows from a
    formula of the source; then `remark` says how.
    """

    key: str
    value: Any
    std: Any = None
    place: str = ""
    remark: str = ""
    variant: str = ""
    calculated: bool = False


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class PrintedQuantity(_Table):
    """A quantity as printed: `value` and `std` over `divided_by`, in `unit`.

    An inertia matrix is (3, 3), or (3,) if it is a diagonal one; rows have `columns`, with a unit for each.
    """

    key: str
    variant: str = ""
    value: Printed
    std: Printed | None = None
    divided_by: Annotated[float, Field(gt=0)] = 1.0
    unit: str | list[str]
    columns: list[str] = []
    place: str = ""
    remark: str = ""

    @model_validator(mode="after")
    def _readable(self) -> Self:
        if find(self.key) is None:
            raise ValueError(f"there is no quantity {self.key}")
        try:
            converted = self.converted()
        except (ValueError, ArithmeticError) as error:
            raise ValueError(f"{self.key}: {error}") from None
        if any(number < 0 for number in leaves(converted.std)):
            raise ValueError(f"{self.key}: std should not be below zero")
        if fault := shape_error(self.key, converted.value, converted.std):
            raise ValueError(f"{self.key} {fault}")
        return self

    def converted(self) -> PublishedValue:
        """Return the value in the registry's unit. Raises ValueError for a unit of another kind, or another shape."""
        quantity = registered(self.key)
        convert = self._rows if quantity.shape is Shape.ROWS else self._numbers
        std = None if self.std is None else convert(self.std, quantity)
        return PublishedValue(self.key, convert(self.value, quantity), std, self.place, self.remark, self.variant)

    def _numbers(self, printed: Printed, quantity: Quantity) -> Any:
        if not isinstance(self.unit, str):
            raise ValueError("should have one unit")
        if quantity.shape is Shape.POLYNOMIAL:
            return self._coefficients(printed, quantity, self.unit)
        scale = _factor(self.unit, quantity.unit) / self.divided_by
        scaled = _each(printed, lambda number: scale * number)
        if quantity.shape is Shape.MATRIX and isinstance(scaled, list) and len(scaled) == 3 and _is_flat(scaled):
            return [[scaled[i] if i == j else 0.0 for j in range(3)] for i in range(3)]
        return scaled

    def _coefficients(self, printed: Any, quantity: Quantity, unit: str) -> list[float]:
        if not isinstance(printed, list) or not _is_flat(printed):
            raise ValueError("should be a list of coefficients")
        match = _UNIT.fullmatch(unit)
        if match is None or match["over"] is None:
            raise ValueError(f"its unit should be as {quantity.of}({quantity.over}), not {unit}")
        of = _factor(unit.partition("(")[0], quantity.of) / self.divided_by
        over = _factor(match["over"], quantity.over)
        powers: Iterable[int] = range(len(printed)) if quantity.lowest_first else reversed(range(len(printed)))
        return [of * number / over**power for number, power in zip(printed, powers, strict=True)]

    def _rows(self, printed: Any, _: Quantity) -> list[dict[str, float]]:
        units = self.unit if isinstance(self.unit, list) else [self.unit]
        if unknown := [name for name in self.columns if name not in _COLUMNS]:
            raise ValueError(f"there is no column {unknown[0]}")
        if not isinstance(printed, list) or len(units) != len(self.columns):
            raise ValueError("should have rows, and a unit for each column")
        scales = [_factor(unit, _COLUMNS[name]) for name, unit in zip(self.columns, units, strict=True)]
        rows = [row if isinstance(row, list) else [row] for row in printed]
        if any(len(row) != len(scales) for row in rows):
            raise ValueError(f"each row should have {len(scales)} numbers")
        return [
            {name: scale * number for name, scale, number in zip(self.columns, scales, row, strict=True)}
            for row in rows
        ]


class SetFile(_Table):
    """A published set as its file states it; `title` is its name in reports, `frame` that of its directed values."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9.-]{0,59}$")]
    title: Text
    source: Text
    vehicle: Text
    platform: Platform
    payload: str = ""
    method: Text
    frame: BodyFrame
    quantities: list[PrintedQuantity]


def _factor(unit: str, si: str) -> float:
    """Return the factor from a printed unit to one of the registry. Raises ValueError for a unit of another kind."""
    match = _UNIT.fullmatch(unit)
    of, motors = (unit, 1) if match is None else (match["of"], int(match["motors"] or 1))
    known = 1.0 if of == si else _FACTORS.get(si, {}).get(of)
    if known is None and si in UNITS:
        known = factor(of, si)
    if known is None:
        raise ValueError(f"{unit} cannot be converted to {si}")
    return known / motors


def _each(printed: Any, change: Callable[[float], float]) -> Any:
    return [_each(part, change) for part in printed] if isinstance(printed, list) else change(printed)


def _is_flat(printed: list[Any]) -> bool:
    return not any(isinstance(part, list) for part in printed)
