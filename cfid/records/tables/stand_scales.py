"""Recognise the scale of motor commands in tables, 65535 at full thrust or another, by the largest command."""

import numpy as np

from cfid.errors import DataError
from cfid.records.tables.table import Array, CsvTable
from cfid.units import FULL_COMMAND

_PER_CENT, _BITS_8, _DSHOT = 100, 255, (48, 2047)  # full commands of other scales; up to 47, DShot's are words
_FEWEST = 3  # different commands that show their scale: small ones may be measured, to see where a motor starts
_PULSES_US = (800.0, 2500.0)  # within which those of all controllers are; a motor starts at a pwm of 1000 to 3000


def command_called(raw: Array) -> str:
    """Return a known name of commands (n, 1) by their size: for a fraction, per cent, pulse widths, or 0 to 65535."""
    known = raw[np.isfinite(raw)]
    smallest, largest = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    if _PULSES_US[0] <= smallest and largest <= _PULSES_US[1]:
        return '"ESC signal (us)"'
    if 0 < largest <= _PER_CENT:
        return "pwm_percent" if largest > 1 else "command_fraction"
    return "cmd"


def check_scale(table: CsvTable, name: str, raw: Array, *, stated: bool) -> None:
    """Refuse commands (n, 1) none of which would turn a motor on the scale 0 to 65535: they have another scale.

    Where the column's name states a pwm, two commands are enough to ask about pulse widths. Raises DataError.
    """
    smallest, largest = np.nanmin(raw), np.nanmax(raw)
    if not 0 < largest <= _PULSES_US[1]:
        return
    place, found = 1 + table.names.index(name), f"no command above {largest:g} in '{name}', of {FULL_COMMAND}"
    few = len(np.unique(raw[np.isfinite(raw)])) < _FEWEST
    if smallest >= _PULSES_US[0] and (stated or not few):
        raise DataError(
            f"{table.path}: no {name} below {smallest:g} or above {largest:g}: are these pulse widths in us? Then name "
            f'the column by `columns`, as in "ESC signal (us)={place}".'
        )
    if largest <= _PER_CENT:
        what, called = ("in per cent", "pwm_percent") if largest > 1 else ("a fraction of one", "command_fraction")
        raise DataError(
            f"{table.path}: {found}: is it {what}? Then name the column by `columns`, as in {called}={place}."
        )
    if largest <= _DSHOT[1] and not few:
        eight = largest <= _BITS_8
        what = f"of 8 bits (0 to {_BITS_8})" if eight else f"DShot ({_DSHOT[0]} to {_DSHOT[1]})"
        how = f"it divided by {_BITS_8}" if eight else f"({name} - {_DSHOT[0]}) / {_DSHOT[1] - _DSHOT[0]}, 0 at 0,"
        raise DataError(
            f"{table.path}: {found}: is it {what}? No option reads that: write {how} as a column "
            "command_fraction (0 to 1) in place of this one."
        )
