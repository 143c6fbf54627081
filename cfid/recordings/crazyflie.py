"""Logs of a Crazyflie as tables of other programs, and the channels of any vehicle's log under the firmware's names."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from cfid.errors import DataError
from cfid.findings import Finding, finding
from cfid.large import usual_step
from cfid.recordings.recording import OF_TABLES, Array, Column, Facts, How, Recording, Series
from cfid.recordings.table import Table
from cfid.recordings.times import series_of, time_column
from cfid.units import FULL_COMMAND, USUAL_GRAVITY_MPS2, si_of

CLOCK_RATES = {"true": 1.0, "84/85": 84 / 85}  # of a Crazyflie's microseconds; 84/85 with firmware up to 2026.08

# As the firmware documents its log variables. A name that is missing here has no certain unit.
_UNITS = tuple(
    (re.compile(pattern), unit)
    for pattern, unit in (
        (r"acc\.[xyz]|stateEstimate\.a[xyz]", "g"),
        (r"gyro\.[xyz]|controller\.(?:roll|pitch|yaw)Rate", "deg/s"),
        (r"(?:stateEstimate|stabilizer|controller|ctrltarget)\.(?:roll|pitch|yaw)", "deg"),
        (r"(?:stateEstimate|ctrltarget|locSrv)\.[xyz]|kalman\.state[XYZ]|baro\.asl", "m"),
        (r"(?:stateEstimate|ctrltarget)\.v[xyz]", "m/s"),
        (r"ctrltarget\.a[xyz]", "m/s^2"),
        (r"(?:stateEstimateZ|ctrltargetZ)\.[xyz]|range\.(?:front|back|left|right|up|zrange)", "mm"),
        (r"(?:stateEstimateZ|ctrltargetZ)\.v[xyz]", "mm/s"),
        (r"(?:stateEstimateZ|ctrltargetZ)\.a[xyz]", "mm/s^2"),
        (r"stateEstimateZ\.rate(?:Roll|Pitch|Yaw)", "mrad/s"),
        (r"(?:stateEstimate|locSrv)\.q[xyzw]|kalman\.q[0-3]", "1"),
        (r"rpm\.m[1-4]|motor\.m[1-4]_rpm", "rpm"),
        (r"motor\.m[1-4](?:req)?|pwm\.m[1-4](?:_pwm)?|stabilizer\.thrust|controller\.cmd_\w+", "1"),
        (r"control\.m[1-4]", "1"),  # of other autopilots: 1 is the full command
        (r"pm\.vbat", "V"),
        (r"pm\.vbatMV", "mV"),
        (r"baro\.pressure", "mbar"),
        (r"mag\.[xyz]", "gauss"),
    )
)
_OF_CRAZYFLIE = re.compile(r"motor\.|pwm\.|pm\.|stabilizer\.|stateEstimateZ?\.|ctrltargetZ?\.|controller\.")
_FLOWN = re.compile(
    r"(?:\w+_)?(?:(?:gyro|acc)[._][xyz]|(?:motor|pwm|rpm)[._]m[1-4]\w*|(?:stateEstimate|stabilizer)[._]\w+|pm[._]vbat\w*)"
    r"(?:\s*[\[(][^\[\]()]+[\])])?"
)
_SHARE_OF_FULL = re.compile(r"control\.m[1-4]")


class Timed(NamedTuple):
    """A channel's values (n,) in SI units at times (n,) in s since the first row of any series of its recording."""

    time_s: Array
    value: Array


@dataclass(frozen=True, kw_only=True)
class Profile:
    """How a program writes its tables: what shows it, the unit of its times, and names and units of its columns.

    It is shown by any of the heads in `any_of`, by exactly those in `all_of` after the first, or by a first head
    `first` before names that all match `named`. `firmware` finds the group and the variable of the firmware in a name.
    """

    program: str
    any_of: frozenset[str] = frozenset()
    all_of: frozenset[str] = frozenset()
    first: str = ""
    named: re.Pattern[str] | None = None
    time_unit: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    firmware: re.Pattern[str] | None = None

    def shown_by(self, heads: Sequence[str]) -> bool:
        """Return whether a table has been written by the program."""
        if self.named is not None:
            return len(heads) > 1 and heads[0] == self.first and all(map(self.named.fullmatch, heads[1:]))
        return bool(self.any_of & {*heads}) or (bool(self.all_of) and self.all_of == {*heads[1:]})


def _each(names: str, unit: str) -> dict[str, str]:
    return dict.fromkeys(names.split(), unit)


PROFILES = (
    Profile(
        program="CSV log of the Crazyflie client",
        first="Timestamp",
        named=re.compile(r"\w+\.\w+"),
        time_unit="ms",
    ),
    Profile(
        program="CSV log of NanoBench",
        any_of=frozenset(("wx_vicon", "motor_motor_m1", "imu_gyro_x", "imu_acc_x")),  # not all parts have all of them
        units={
            **_each("px py pz", "m"),
            **_each("vx vy vz", "m/s"),
            **_each("qx qy qz qw", "1"),
            **_each("roll pitch yaw", "rad"),
            **_each("wx_vicon wy_vicon wz_vicon", "rad/s"),
            **_each("imu_gyro_x imu_gyro_y imu_gyro_z", "rad/s"),  # as motion capture shows; the firmware's are deg/s
        },
        firmware=re.compile(r"[a-z]+_(?P<group>[A-Za-z]+)_(?P<variable>\w+)"),  # log block, group and variable
    ),
    Profile(
        program="CSV file of Crazyswarm2's simulator",
        all_of=frozenset(("x", "y", "z", "qw", "qx", "qy", "qz")),
        units={**_each("x y z", "m"), **_each("qw qx qy qz", "1")},
    ),
)
_LEAST_STEP_S = 0.5e-3  # between rows of the client, which writes one per ms at most


def crazyflie_unit(name: str) -> str:
    """Return the unit of a variable of the firmware, such as `gyro.x`, "" for another name."""
    return next((unit for pattern, unit in _UNITS if pattern.fullmatch(name)), "")


def is_flown(head: str) -> bool:
    """Return whether a column is a variable of a vehicle's firmware, such as `gyro.x` or `imu_gyro_x`."""
    return bool(_FLOWN.fullmatch(head))


def printable(text: str, length: int = 60) -> str:
    """Return a name from a file in a form for the terminal: without control characters, and of limited length."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)[:length]


def vehicle_of(table: Table, how: How) -> Recording:
    """Return a table as a vehicle's log: one series, whose columns have the firmware's names and units where known.

    Raises DataError and ConfigError as `series_of`, and ConfigError for options that a vehicle's table does not use.
    """
    time = time_column(table, how)
    heads = [column.head for column in table.columns]
    profile = next((one for one in PROFILES if one.shown_by(heads)), Profile(program="CSV log"))
    columns, findings = _with_firmware_s_names(table, time, profile)
    of_vehicle = time is not None and how.rate_hz is None and any(crazyflie_unit(one.name) for one in columns)
    how.refuse_unused(table.path, *OF_TABLES, "props_out", *(("clock",) if of_vehicle else ()))
    series = series_of(replace(table, columns=columns), how, name="log")
    if profile.time_unit and how.rate_hz is None and time is not None and not time.unit:
        _refuse_seconds(series, time)
    if how.clock is not None and series.time_s is not None:
        slow = 1 / CLOCK_RATES[how.clock]
        series = replace(series, time_s=slow * series.time_s, begin_s=slow * (series.begin_s or 0.0))
        findings += (finding("log-clock", clock=how.clock, why="as `clock` states").at(table.path.name),)
    return Recording(
        path=table.path,
        source=table.source,
        series={series.name: series},
        facts=Facts(program=profile.program, clock=how.clock, props_out=how.props_out),
        findings=(*series.findings, *findings),
    )


def _with_firmware_s_names(
    table: Table, time: Column | None, profile: Profile
) -> tuple[tuple[Column, ...], tuple[Finding, ...]]:
    """Return columns with the firmware's names, and units by them, and a finding where a unit is known by a name alone.

    Names such as `gyro_x`, which other vehicles' logs also have, count as the firmware's only where a column has a name
    that the firmware alone has.
    """
    names = [column.head if crazyflie_unit(column.head) else column.name for column in table.columns]
    dotted = [name if crazyflie_unit(name) else name.replace("_", ".", 1) for name in names]
    alone = any(crazyflie_unit(name) and _OF_CRAZYFLIE.match(name) for name in dotted)
    columns, by_name = [], False
    for column, name, dot in zip(table.columns, names, dotted, strict=True):
        variable = profile.firmware.fullmatch(name) if profile.firmware else None
        found = f"{variable['group']}.{variable['variable']}" if variable else dot if alone else name
        own = profile.units.get(name, "")
        found = found if crazyflie_unit(found) and not own else name
        unit = column.unit or own or crazyflie_unit(found)
        if column is time:
            unit = column.unit or profile.time_unit
        by_name |= not (column.unit or profile.units or profile.time_unit) and bool(crazyflie_unit(found))
        columns.append(replace(column, name=found, unit=unit))
    return tuple(columns), (finding("log-units-by-names").at(table.path.name),) if by_name else ()


def _refuse_seconds(series: Series, time: Column) -> None:
    """Raise DataError for times of the Crazyflie's client, read in ms, that are closer than its rows can be."""
    step_s = usual_step(series.time_s) if series.time_s is not None else np.nan
    if 0 < step_s < _LEAST_STEP_S:
        raise DataError(
            f"{series.path}: {time.head} is read in ms, as the Crazyflie client writes it, and its rows would be "
            f"{1e3 * step_s:.3g} ms apart (limit {1e3 * _LEAST_STEP_S:g} ms). If it is in s, import it with `unit` "
            f"{time.head}=s.",
            code="other-unit",
        )


def channel(recording: Recording, name: str) -> Timed:
    """Return times (n,) and values (n,) of a column in its SI unit, and commands of other autopilots from 0 to 65535.

    Times are those since the first row of any series. Raises DataError for a column that is not there.
    """
    series = recording.holding(name)
    return Timed(times_in(recording, series), si_values(series.column(name)))


def times_in(recording: Recording, series: Series) -> Array:
    """Return the times (n,) of a series in s since the first row of any series of its recording."""
    if series.time_s is None:
        raise DataError(f"{series.path}: a table without times: a log needs them.", code="no-time")
    begins_s = [one.begin_s for one in recording.series.values() if one.begin_s is not None]
    since_s = (series.begin_s or 0.0) - min(begins_s, default=0.0)
    return series.time_s + since_s if since_s else series.time_s


def si_values(column: Column) -> Array:
    """Return a column (n,) in its SI unit; a g is an acceleration, as everywhere in logs of vehicles."""
    factor = FULL_COMMAND if _SHARE_OF_FULL.fullmatch(column.name) else si_unit(column)[1]
    return column.values if factor == 1 else column.values * factor


def si_unit(column: Column) -> tuple[str, float]:
    """Return the SI unit of a log's column, and the factor to it; an unknown unit stays as it is."""
    if column.unit == "g":
        return "m/s^2", USUAL_GRAVITY_MPS2
    return si_of(column.unit) or (column.unit, 1.0)


def findings_in(recording: Recording) -> tuple[Finding, ...]:
    """Return the findings of a recording and of its series, each once."""
    of_series = (one for series in recording.series.values() for one in series.findings)
    return tuple(dict.fromkeys((*recording.findings, *of_series)))


def first_of(recording: Recording, patterns: Sequence[str], motor: int = 0) -> str | None:
    """Return the first name of `patterns` that a recording has, with a motor's number for `{}`; None for none.

    Raises DataError for a variable of the firmware in a unit of another kind.
    """
    there = {column.name: column for series in recording.series.values() for column in series.columns}
    name = next((name for pattern in patterns if (name := pattern.format(motor)) in there), None)
    if name is not None:
        refuse_other_unit(recording, there[name])
    return name


def refuse_other_unit(recording: Recording, column: Column) -> None:
    """Raise DataError for a variable of the firmware in a unit of another kind than the firmware's."""
    usual = crazyflie_unit(column.name)
    if usual and si_unit(column)[0] != si_unit(replace(column, unit=usual))[0]:
        raise DataError(
            f"{recording.path}: column '{column.head or column.name}' is in '{column.unit}', which is no unit of "
            f"{column.name}: the firmware has it in {usual}.",
            code="other-unit",
        )


def between(recording: Recording, begin_s: float, end_s: float) -> Recording:
    """Return a recording's rows between two times since the first row of any series."""
    series = {}
    for name, one in recording.series.items():
        time_s = times_in(recording, one)
        first, last = np.searchsorted(time_s, begin_s), np.searchsorted(time_s, end_s, side="right")
        series[name] = one.kept(np.arange(first, max(first, last)))
    return replace(recording, series=series)


def windows(
    recording: Recording, names: Sequence[str], *, from_s: float, long_s: float
) -> Iterator[Mapping[str, Timed]]:
    """Yield channels in parts of length `long_s`, the first from `from_s` on; it also has all rows before that.

    Raises DataError for a channel that the recording does not have.
    """
    series = {name: recording.holding(name) for name in names}
    times_s = {one.name: times_in(recording, one) for one in series.values()}
    last_s = max((float(time_s[-1]) for time_s in times_s.values() if len(time_s)), default=from_s)
    firsts = dict.fromkeys(times_s, 0)
    end_s = from_s
    while end_s <= last_s:
        end_s += long_s
        ends = {name: int(np.searchsorted(time_s, end_s)) for name, time_s in times_s.items()}
        rows = {name: slice(firsts[name], end) for name, end in ends.items()}
        yield {
            name: Timed(times_s[one.name][rows[one.name]], si_values(_part(one.column(name), rows[one.name])))
            for name, one in series.items()
        }
        firsts = ends


def _part(column: Column, rows: slice) -> Column:
    return replace(column, values=column.values[rows])
