"""Select the columns of a table of motors, and find missing and impossible values in them."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError
from cfid.large import PART_ROWS, empty, side_by_side
from cfid.records.tables.next_head import heads_among, repeats_head
from cfid.records.tables.stand_heads import HEADS, ColumnHead, check_heads, heads_of, shows_stand
from cfid.records.tables.stand_scales import check_scale
from cfid.records.tables.stand_sides import of_one_side
from cfid.records.tables.stand_thousands import check_thousands
from cfid.records.tables.table import Array, CsvTable
from cfid.records.tables.wrong_times import finite_places, unwrapped, wrong_times, wrong_times_note
from cfid.units import FULL_COMMAND

_LONGEST_PULSE_US = 5000.0  # beyond all that controllers take, of which few reach 2500
_LARGEST = {"percent": (100.0, " per cent"), "fraction": (1.0, ", as a fraction")}
_MOST_VOLTS = 60.0  # more than any battery that flies, and less than its millivolts
_REST_NOISE = 1e-3  # of the fastest speed: up to this far below zero is noise
_FORWARD = 1e-2  # of the fastest speed: noise shows this much of a rotor that turns backwards
_IMPOSSIBLE_SHARE = 0.1  # of a column's values, up to which only the impossible ones are left out
_ALIKE = 1.05  # ratio of two sensors of one rotor's speed; wrong poles or markers make 7/6 and more
_ROW_BY_ROW = ("time_s", "command")  # without them a row is of no use


class Columns(NamedTuple):
    """The columns of one quantity as in the file, (n, s), nan where a field is not a number."""

    head: ColumnHead
    names: tuple[str, ...]
    raw: Array

    @property
    def value(self) -> Array:
        """The columns in SI units."""
        return np.multiply(self.raw, self.head.factor, out=empty(*self.raw.shape))


Found = Mapping[str, Columns]


def columns_of(table: CsvTable) -> tuple[CsvTable, Found, tuple[str, ...]]:
    """Return the columns of each quantity, the table without the rows that were left out, and notes.

    A column without any number is not used, and a row without a time or a command is left out. Raises DataError when a
    quantity has several columns, when commands or measurements are missing, and for impossible values.
    """
    if not table.has_head:
        raise DataError(
            f"{table.path}: no header for its {len(table.names)} columns. Name them by `columns`, as in "
            f"cmd=1,thrust_n=2. Known names: {HEADS}."
        )
    called = heads_of(table.names)
    doubled = _without_doubled(table, called)
    names = [name for columns in called.values() for _, name in columns]
    numbers = table.known_numbers(names)
    times = next((numbers[:, names.index(name)] for _, name in called.get("time_s", ())), None)
    table, numbers, another = _above_next_head(table, numbers, times)
    values = dict(zip(names, numbers.T, strict=True))
    check_thousands(table, values)
    empty = [name for name, value in values.items() if not np.isfinite(value).any()]
    used = {quantity: [one for one in columns if one[1] not in empty] for quantity, columns in called.items()}
    used = {quantity: columns for quantity, columns in used.items() if columns}
    notes = [*another, *doubled.values(), *(_holds_no_number(table, name) for name in empty)]
    notes += of_one_side(table, used, values)
    notes += _one_of_two_speeds(table, used, values)
    notes += check_heads(table, used)
    found = {
        quantity: Columns(columns[0][0], tuple(n for _, n in columns), side_by_side([values[n] for _, n in columns]))
        for quantity, columns in used.items()
    }
    notes += _unconnected(found)
    notes += _check(table, found)
    notes += _wrong_times(table, found)
    known = [np.isfinite(found[quantity].raw).all(axis=1) for quantity in _ROW_BY_ROW if quantity in found]
    bad = np.flatnonzero(~np.all(known, axis=0)) if known else np.empty(0, np.intp)
    notes += _missing(table, found, bad)
    if len(bad):
        table = table.without(bad)
        found = {quantity: one._replace(raw=np.delete(one.raw, bad, axis=0)) for quantity, one in found.items()}
    return table, found, tuple(notes)


def turned(value: Array, drive: Array) -> tuple[Array, bool]:
    """Return values (n,) that grow with a drive (n,), a command or speed, and whether their sign was changed."""
    some = slice(None, None, len(value) // PART_ROWS + 1)  # of a long table, enough to see a sign
    level, drive = value[some], drive[some]
    known = np.isfinite(level) & np.isfinite(drive)
    if known.sum() < 2 or np.ptp(drive[known]) == 0:
        return value, False
    half = (drive[known].min() + drive[known].max()) / 2
    falls = np.median(level[known][drive[known] >= half]) < np.median(level[known][drive[known] < half])
    return (-value, True) if falls else (value, False)


def _above_next_head(table: CsvTable, numbers: Array, times: Array | None) -> tuple[CsvTable, Array, list[str]]:
    """Return the table and its columns (n, s) above another header among its rows, and notes on what is left out.

    A repeated header after which times (n,) continue does not end the table: a restarted program wrote it once more.
    """
    count = len(numbers)
    blank = np.flatnonzero(~np.isfinite(numbers).any(axis=1))
    repeats, rest, notes = list[int](), np.arange(count, count), list[str]()
    for head, words in heads_among(table, blank, count):
        if repeats_head(table, words) and times is not None and _goes_on(times, head):
            repeats.append(head)
            continue
        line, rest = table.line_of_row(head), np.arange(head, count)
        notes.append(
            f"line {line} is another header: the {counted(len(rest) - 1, 'row')} below it are of another table, and "
            f"not used. Read them by `skip_lines` {line - 1}."
        )
        break
    if repeats:
        first, lines = table.line_of_row(repeats[0]), counted(len(repeats), "line repeats", "lines repeat")
        notes.append(f"{lines} the header (first: line {first}), and times go on: no row, and left out.")
    left_out = np.concatenate([np.array(repeats, np.intp), rest])
    return (
        (table.without(left_out), np.delete(numbers, left_out, axis=0), notes)
        if len(left_out)
        else (table, numbers, [])
    )


def _goes_on(times: Array, row: int) -> bool:
    """Return whether times (n,) after a row are later than those before it."""
    before, after = times[:row][np.isfinite(times[:row])], times[row:][np.isfinite(times[row:])]
    return bool(len(before) and len(after) and after[0] > before[-1])


def _holds_no_number(table: CsvTable, name: str) -> str:
    """Return the sentence on a column without any number, with its first field that is not empty."""
    text, fault = f"'{name}' holds no number: it is not used.", table.fault_in(name)
    return text if fault is None else f"{text} Line {fault.removeprefix(f'{table.path}:')}"


def _without_doubled(table: CsvTable, called: dict[str, list[tuple[ColumnHead, str]]]) -> dict[str, str]:
    """Leave out quantities whose columns share a name, and return a note for each such name.

    Raises DataError where nothing to fit is left in the table.
    """
    notes = {}
    for quantity in list(called):
        name = called[quantity][0][1]
        places = [str(place) for place, one in enumerate(table.names, start=1) if one == name]
        if len(places) > 1:
            del called[quantity]
            example = f"{name}={places[0]}"
            which = f"the columns {', '.join(places)} are all named '{name}'"
            notes[name] = f"{which}: none is used. Name one by `columns`, as in {example}."
    if notes and not shows_stand(called):
        raise DataError(f"{table.path}: {next(iter(notes.values()))}")
    return notes


def _backwards(speeds: Columns) -> list[str]:
    """Change the sign of a stand's speed that is practically never above zero: its rotor turns the other way."""
    highest, lowest, name = np.nanmax(speeds.raw), np.nanmin(speeds.raw), speeds.names[0]
    if speeds.head.kind != "motor" or lowest >= 0 or highest > -_FORWARD * lowest:
        return []
    speeds.raw[:] *= -1
    return [f"'{name}' is negative throughout, of a rotor that turns the other way: its sign is turned."]


def _at_rest(speeds: Columns, command: Columns | None) -> list[str]:
    """Set speeds a little below zero to zero at the lowest command: the noise of a sensor whose rotor stands still."""
    if command is None:
        return []
    lowest = command.raw <= np.nanmin(command.raw)
    noise = lowest & (speeds.raw < 0) & (speeds.raw >= -_REST_NOISE * np.nanmax(speeds.raw))
    speeds.raw[noise] = 0.0
    count = int(np.count_nonzero(noise))
    return [f"{count} speeds just below zero at the lowest command are noise: taken as 0."] if count else []


def _one_of_two_speeds(
    table: CsvTable, called: dict[str, list[tuple[ColumnHead, str]]], values: Mapping[str, Array]
) -> list[str]:
    """Keep one of an electrical and an optical speed: the one that is not 0 in more rows.

    Where both are not 0 and disagree, keep the optical one, which does not depend on the number of poles. Raises
    DataError where none is optical.
    """
    speeds = called.get("speeds_rad_s", [])
    if len(speeds) != 2 or any(head.kind != "motor" for head, _ in speeds):
        return []
    first, second = (head.factor * np.nan_to_num(values[name]) for head, name in speeds)
    seen = [int(np.count_nonzero(speed)) for speed in (first, second)]
    if not any(seen):
        del called["speeds_rad_s"]
        return [f"'{speeds[0][1]}' and '{speeds[1][1]}' are 0 throughout: no speed is used."]
    both = (first != 0) & (second != 0)
    ratio = float(np.median(np.abs(first[both] / second[both]))) if np.count_nonzero(both) >= max(seen) / 2 else 1.0
    if max(ratio, 1 / ratio) < _ALIKE:
        best = int(np.argmax(seen))
        called["speeds_rad_s"] = [speeds[best]]
        other, name = speeds[1 - best][1], speeds[best][1]
        return [f"the speed is '{name}', not 0 in {seen[best]} rows; '{other}' is not 0 in {seen[1 - best]}."]
    text = f"'{speeds[0][1]}' is {ratio:.3g} times '{speeds[1][1]}' (median of {np.count_nonzero(both)} rows)"
    optical = [one for one in speeds if "optical" in one[1].lower()]
    other = next(name for one, name in speeds if (one, name) not in optical[:1])
    option = f"`columns`, as in {other}={1 + table.names.index(other)}"
    if len(optical) != 1:
        raise DataError(f"{table.path}: {text}. Name the right one by {option}.")
    called["speeds_rad_s"] = optical
    return [
        f"{text}: the optical one is taken; an electrical one is right where the stand's program knew the motor's "
        f"poles. Where it did, name it by {option}."
    ]


def _unconnected(found: dict[str, Columns]) -> list[str]:
    """Leave out a voltage that is 0 throughout while a motor is driven; set occasional zeros to nan; return notes.

    No motor runs from 0 V: the leads were not connected. Only a changing command shows that a motor was driven.
    """
    battery, command = found.get("vbat_v"), found.get("command")
    if battery is None or (command is not None and np.nanmin(command.raw) == np.nanmax(command.raw)):
        return []
    zero, name = battery.raw == 0, battery.names[0]
    rows = counted(int(np.count_nonzero(zero)), "row")
    if not np.any(np.nan_to_num(battery.raw)):
        del found["vbat_v"]
        return [f"'{name}' is 0 throughout, which no battery is that drives a motor: no voltage is used."]
    battery.raw[zero] = np.nan
    return [f"'{name}' is 0 in {rows}, which no battery is that drives a motor: missing."] if zero.any() else []


def _wrong_times(table: CsvTable, found: Found) -> list[str]:
    """Unwrap the clock, set single times that jump off and back to nan, whose rows are left out, and return notes."""
    if "time_s" not in found:
        return []
    time = found["time_s"].raw[:, 0]
    notes = [*unwrapped(table, time)]
    finite = finite_places(time)
    wrong = wrong_times(time[finite])
    if len(wrong):
        wrong = np.arange(len(time))[finite][wrong]
        notes.append(wrong_times_note(table, time, wrong))
        time[wrong] = np.nan
    return notes


def _missing(table: CsvTable, found: Found, bad: npt.NDArray[np.intp]) -> list[str]:
    """Return notes on rows that are left out, and on values that are missing in the others."""
    notes = []
    if len(bad):
        notes.append(
            f"{counted(len(bad), 'row')} without a time or command (first: line "
            f"{table.line_of_row(int(bad[0]))}) {'is' if len(bad) == 1 else 'are'} left out."
        )
    for quantity, columns in found.items():
        for name, value in zip(columns.names, columns.raw.T, strict=True):
            rows = np.setdiff1d(np.flatnonzero(~np.isfinite(value)), bad)
            if len(rows) and quantity not in _ROW_BY_ROW:
                line = table.line_of_row(int(rows[0]))
                notes.append(f"'{name}' is no number in {len(rows)} of {len(value)} rows (first: line {line}).")
    return notes


def _check(table: CsvTable, found: Found) -> list[str]:
    """Set impossible values of quantities to nan and return notes; refuse many of them, naming the first one's line."""
    notes: list[str] = []
    if command := found.get("command"):
        raw = command.raw
        notes += _impossible(table, command, raw < 0, "a command is zero or more.")
        most, called = _LARGEST.get(command.head.kind, (FULL_COMMAND, ""))
        notes += _impossible(table, command, raw > most, f"the largest is {most:g}{called}.")
        if command.head.kind == "esc":
            notes += _impossible(table, command, raw > _LONGEST_PULSE_US, "no motor controller has such pulses.")
        if command.head.kind in ("", "pwm"):
            check_scale(table, command.names[0], raw, stated=command.head.kind == "pwm")
    if speeds := found.get("speeds_rad_s"):
        notes += _backwards(speeds)
        notes += _at_rest(speeds, command)
        notes += _impossible(table, speeds, speeds.raw < 0, "a speed is zero or more.")
    if battery := found.get("vbat_v"):
        wrong = (battery.raw <= 0) | (battery.value > _MOST_VOLTS)
        why = "no battery has that voltage."
        if np.nanmedian(battery.raw) > _MOST_VOLTS:
            why += " Is it in millivolts? Then its name has to be vbat_mv."
        notes += _impossible(table, battery, wrong, why)
    return notes


def _impossible(table: CsvTable, column: Columns, wrong: npt.NDArray[np.bool_], why: str) -> list[str]:
    if not wrong.any():
        return []
    row, place = (int(index) for index in np.argwhere(wrong)[0])
    value, name = f"{column.raw[row, place]:g}", column.names[place]
    line = table.line_of_row(row)
    if wrong.sum(axis=0).max() > _IMPOSSIBLE_SHARE * len(wrong):
        raise DataError(f"{table.path}:{line}: {value} in column '{name}': {why}")
    column.raw[wrong] = np.nan
    count = int(wrong.sum())
    them = "It is" if count == 1 else "They are"
    return [
        f"{counted(count, 'impossible value')}, the first {value} in column '{name}' (line {line}): {why} {them} left "
        "out."
    ]
