"""Thrust stands and typed tables of motors: thrust, torque, speed and voltage over the motors' commands.

Columns are known by their names, in any order; the units are those of the header or of `How`. `canonical_stand` gives
a recording under the names by which an import keeps it, `stand_of` what fits take.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, finding, note
from cfid.large import PART_ROWS, empty, parts, side_by_side, some_steps
from cfid.quantities.registry import range_of
from cfid.recordings.outliers import offset_segments, outliers, stuck
from cfid.recordings.recording import Array, Column, Facts, How, Recording, Rows, Series
from cfid.recordings.stand_names import BITCRAZE, KNOWN, SPEED_NAMES, Known, Speeds, known_columns
from cfid.recordings.table import read_table
from cfid.recordings.times import TIME, series_of
from cfid.records.parameters import Source
from cfid.records.run import run_at, run_holding
from cfid.units import FULL_COMMAND, ROTORS, USUAL_GRAVITY_MPS2, factor

Mask = npt.NDArray[np.bool_]

STAND = "stand"  # the device of an imported run
USUAL_ESC_US = (1000.0, 2000.0)  # pulse widths of standstill and full throttle, by convention

_UNITS = {"thrust": "N", "torque": "N m", "speed": "rad/s", "voltage": "V", "grams": "g"}
_EXAMPLES = {"command": "cmd", "thrust": "thrust_n", "torque": "torque_nm", "speed": "rpm", "voltage": "vbat_v"}
_WEIGHTS = {"g": 1.0, "gram": 1.0, "grams": 1.0, "kg": 1e3}  # of a thrust that is weighed, in grams
_COMMANDS = ("cmd", "throttle")
_USED = ("columns", "units", "rate_hz", "skip_lines", "decimal", "rows", "sort_times", "motors")
_DSHOT = (48.0, 2047.0)  # smallest and largest throttle; what is below are words to the controller
_LEAST_FULL = 2500.0  # a table whose commands are all below turns no motor on the scale 0 to 65535
_LONGEST_PULSE_US = 5000.0  # beyond all that controllers take, of which few reach 2500
_MOST_VOLTS = 60.0  # more than any battery that flies, and less than its millivolts
_IMPOSSIBLE_SHARE = 0.1  # of a column's values, up to which only the impossible ones are left out
_NOISE = 1e-2  # of the fastest speed: up to this far below zero is noise
_ALIKE = 1.05  # ratio of two sensors of one rotor's speed; wrong poles or markers make 7/6 and more
_SETTLED_S = 1.0  # between rows: a rotor settles in less
_HELD_ROWS, _MOST_TYPED = 5, 200  # rows a command on average, and rows: more are a recording, which needs times
_LATE_ROWS = 5  # of a reading that lags behind a change of the command
_TURNING_RAD_S = 100.0  # faster than any rotor that stands, slower than any that flies
_TURNING_THRUST = 0.01  # of the largest, above the load cell's reading at rest: from there on, a driven rotor turns
_FEWEST_AT_REST, _NOISE_STD, _OF_NORMAL = 5, 5.0, 0.67449  # rows that show a load cell's noise; its reach; median/std


@dataclass(frozen=True, kw_only=True)
class StandTable:
    """A table's columns (n,) in SI units, None for absent ones.

    `columns` has the file's name for each, by the name under which a run keeps it.
    Thrust and torque are one motor's where the file is of `motors` motors; where `motors` is None, they are as in the
    file. `command` is nan where the file has none; any quantity is nan where a field was not a number.
    `speeds_rad_s` (n, s) are as displayed, nan where a sensor was dead: a motor's ("motor"), one rotor's in several
    series ("series"), four rotors' at once ("rotors") or their mean ("mean"). `rotors` is the number of rotors whose
    speed the header names, None for none and for a mean. `grams` is the reading of scales.
    `time_s` is None for settled points and an array for a record over time.
    """

    path: Path
    source: Source
    columns: Mapping[str, str]
    command: Array
    thrust_n: Array | None
    motors: int | None
    rotors: int | None
    torque_nm: Array | None
    vbat_v: Array | None
    grams: Array | None
    speeds_rad_s: Array | None
    speeds: Speeds | None
    time_s: Array | None
    findings: tuple[Finding, ...]

    @property
    def square_mean_speed_rad_s(self) -> Array | None:
        """The speed (n,) at which every rotor would give the mean of the rotors' thrusts, by k w^2."""
        return None if self.speeds_rad_s is None else mean_of_known(self.speeds_rad_s, power=2)


def is_stand(columns: Sequence[Column]) -> bool:
    """Return whether columns make a table of motors: something measured, and a command or another measurement."""
    known = known_columns(columns).keys()
    measured = known & {"thrust", "torque", "speed", "grams"}
    return bool(measured) and ("command" in known or ("thrust" in known and len(measured) > 1))


def canonical_stand(recording: Recording, how: How | None = None) -> Recording:
    """Return a recording of a stand as a run keeps it: one series, under names that state their units, and its motors.

    Commands are from 0 to 65535, `cmd`, or `throttle` of a motor controller; thrust is `thrust_n` or `weight_g`, that
    of all motors, and so is `torque_nm`; speeds are in rad/s. Times are None for settled points. Raises ConfigError for
    what `how` has to state, DataError for a table that is none of motors.
    """
    how = how or How()
    series = _stand_series(recording)
    findings = [*recording.findings, *series.findings]
    if _is_settled(series.time_s):
        findings = [one for one in findings if one.code != "time-gaps"]
    known = known_columns(series.columns, [word.partition("=")[0] for word in how.columns if "=" in word])
    for quantity in list(known):
        empty = [one for one in known[quantity] if not np.isfinite(one.column.values).any()]
        findings += [finding("column-empty", name=one.head) for one in empty]
        known[quantity] = [one for one in known[quantity] if one not in empty]
        if not known[quantity]:
            del known[quantity]
    findings += _one_speed(known)
    _check(series, known)
    command = _command(series, known, how, findings, of_run=recording.run is not None)
    time_s = _times(recording, series, known, command, findings)
    columns = [] if command is None else [command]
    for quantity in ("thrust", "torque", "voltage", "grams", "speed"):
        columns += [_measured(series, quantity, one, findings) for one in known.get(quantity, ())]
    columns = [column for column in columns if np.isfinite(column.values).any()]
    kept = np.ones(series.rows, np.bool_) if command is None else np.isfinite(command.values)
    if not kept.all():
        count = int(np.count_nonzero(~kept))
        findings.append(finding("rows-without-command", count=count, rows=series.rows, line=_line(series, ~kept)))
    findings += _missing(series, columns, kept)
    stand = replace(series, name=STAND, columns=tuple(columns), time_s=time_s, findings=()).kept(kept)
    used = {one.head for alike in known.values() for one in alike}
    unused = [one.head or one.name for one in series.columns if (one.head or one.name) not in {"", *used}]
    findings += [finding("columns-unused", names=_short(", ".join(unused), 120))] if unused else []
    total = any(one.kind == "total" for one in known.get("thrust", ()))
    of_four = total or BITCRAZE.matches([one.head or one.name for one in series.columns])
    motors = how.motors or recording.facts.motors or (ROTORS if of_four else None)
    if how.motors is not None and recording.facts.motors not in (None, how.motors):
        raise ConfigError(
            f"{recording.path}: `motors` {how.motors} contradicts the run, which states {recording.facts.motors}: "
            "leave it out, or import the file again with it."
        )
    named = tuple(one.at(recording.path.name) if not one.where else one for one in findings)
    understood = note("file-read", _understood(stand)).at(recording.path.name)
    return replace(
        recording,
        series={STAND: stand},
        facts=replace(recording.facts, motors=motors),
        findings=(understood, *named),
    )


def stand_of(recording: Recording, how: How | None = None, *, gravity_mps2: float = USUAL_GRAVITY_MPS2) -> StandTable:
    """Return what fits take of a stand's recording: one motor's values, where it is known how many motors ran.

    Raises errors as `canonical_stand`.
    """
    canonical = canonical_stand(recording, how)
    series, motors = canonical.series[STAND], canonical.facts.motors
    path = recording.path if recording.run is None else series.path
    findings = list[Finding]()
    measured = {column.name: column for column in series.columns if column.name not in _COMMANDS}
    values = {name: column.values for name, column in measured.items()}
    throttle = next((column for column in series.columns if column.name in _COMMANDS), None)
    command = np.full(series.rows, np.nan) if throttle is None else throttle.values
    if series.time_s is not None:
        for name, column in measured.items():
            values[name], faults = _without_faults(series, column, command)
            findings += faults
    of_motors = [name for name in values if name in ("thrust_n", "weight_g", "torque_nm")]
    if motors is not None and of_motors:
        names = " and ".join(f"'{measured[name].head}'" for name in of_motors)
        divided = f"divided by {motors}" if motors > 1 else "not divided"
        findings.append(finding("stand-of-motors", names=names, motors=counted(motors, "motor"), divided=divided))
    rotors = [name for name in values if name.endswith("_rad_s")]
    speeds = side_by_side([values[name] for name in rotors]).copy() if rotors else None
    drive = command if throttle is not None or speeds is None else mean_of_known(speeds)
    for name in of_motors:
        scale = 1e-3 * gravity_mps2 if name == "weight_g" else 1.0
        values[name] = values[name] * (scale / (motors or 1))
        if scale != 1:
            findings.append(finding("weight-by-gravity", name=measured[name].head, gravity=gravity_mps2))
        if _falls(values[name], drive):
            values[name] = -values[name]
            findings.append(finding("sign-turned", name=measured[name].head))
    thrust = values.get("thrust_n", values.get("weight_g"))
    if speeds is not None:
        heads = [measured[name].head for name in rotors]
        findings += _without_dead(speeds, heads, command, thrust, settled=series.time_s is None)
    if throttle is not None and throttle.name == "throttle":
        findings += _of_larger_vehicle(thrust, command)
    kind = next((kind for kind, name in SPEED_NAMES.items() if rotors and rotors[0].startswith(name)), None)
    return StandTable(
        path=path,
        source=recording.source,
        columns={column.name: column.head for column in series.columns},
        command=command,
        thrust_n=thrust,
        motors=motors,
        rotors={None: None, "mean": None, "rotors": len(rotors)}.get(kind, 1),
        torque_nm=values.get("torque_nm"),
        vbat_v=values.get("vbat_v"),
        grams=values.get("grams"),
        speeds_rad_s=speeds,
        speeds=kind,
        time_s=series.time_s,
        findings=(*canonical.findings, *(one.at(path.name) for one in findings)),
    )


def _without_faults(series: Series, column: Column, command: Array) -> tuple[Array, list[Finding]]:
    """Return a record's values (n,) with nan for those that no rotor shows, and a finding on each kind of fault.

    A command (n,) that jumps for one row explains a value that is off. A sensor is stuck where it repeats one value
    while the command changes, unless its motor stands still.
    """
    values, findings = column.values, list[Finding]()
    assert series.time_s is not None
    commanded = outliers(command)
    if column.name == "vbat_v":
        off = offset_segments(values) | outliers(values)
        hung = np.zeros_like(off)
    else:
        off = outliers(values) & ~(commanded | np.roll(commanded, 1))
        hung = stuck(values, series.time_s) & (values != 0)
    for run in _runs_of(values, np.flatnonzero(hung)):
        followed = np.any(np.diff(command[run[0] : max(run[-1] + 1 - _LATE_ROWS, run[0])]))
        hung[run] = followed
        hung[run[0]] = False  # the reading that is repeated
    for code, rows in (("values-off", off), ("values-stuck", hung)):
        if rows.any():
            first = float(values[np.argmax(rows)])
            count = int(np.count_nonzero(rows))
            findings.append(finding(code, count=count, name=column.head, first=first, line=_line(series, rows)))
    return (np.where(off | hung, np.nan, values), findings) if findings else (values, findings)


def _runs_of(values: Array, places: Rows) -> list[Rows]:
    """Return places (n,) in groups of neighbours with the same value."""
    apart = (np.diff(places) != 1) | (np.diff(values[places]) != 0)
    return np.split(places, np.flatnonzero(apart) + 1) if len(places) else []


def _stand_series(recording: Recording) -> Series:
    """Return the series that is a table of motors; where none is, the first one, whose columns a message names."""
    several = list(recording.series.values())
    return next((one for one in several if is_stand(one.columns)), several[0])


def _one_speed(known: dict[str, list[Known]]) -> list[Finding]:
    """Keep one of an electrical and an optical speed: the one that is not 0 in more rows.

    Where both are not 0 and disagree, keep the optical one, which does not depend on the number of poles.
    """
    two = known.get("speed", [])
    if len(two) != 2 or any(one.kind != "motor" for one in two):
        return []
    seen = [np.nan_to_num(one.column.values) != 0 for one in two]
    counts = [int(np.count_nonzero(one)) for one in seen]
    if not any(counts):
        del known["speed"]
        return [finding("speeds-zero", first=two[0].head, second=two[1].head)]
    both = seen[0] & seen[1]
    scaled = [one.column.values * (factor(one.unit, "rad/s") or np.nan) for one in two]
    ratio = float(np.median(np.abs(scaled[0][both] / scaled[1][both]))) if 2 * both.sum() >= max(counts) else 1.0
    optical = [one for one in two if "optical" in one.head.lower()]
    if max(ratio, 1 / ratio) >= _ALIKE and len(optical) == 1:
        known["speed"] = optical
        return [finding("speeds-disagree", first=two[0].head, second=two[1].head, ratio=ratio, name=optical[0].head)]
    if max(ratio, 1 / ratio) < _ALIKE:
        best = int(np.argmax(counts))
        known["speed"] = [two[best]]
        found = finding("speed-chosen", name=two[best].head, rows=counts[best], other=two[1 - best].head)
        return [found, *([finding("speed-electrical", name=two[best].head)] if "electrical" in two[best].head else [])]
    return []


def _check(series: Series, known: Mapping[str, Sequence[Known]]) -> None:
    """Refuse several columns of one quantity, a table that is none of motors, and columns without a unit."""
    for quantity, alike in known.items():
        if len(alike) > 1 and {one.kind for one in alike} not in ({"series"}, {"rotors"}):
            names = ", ".join(one.head for one in alike)
            raise DataError(
                f"{series.path}: more than one column of {quantity}: {names}. Name one by `columns`, by its name or "
                f"number, as in {_EXAMPLES.get(quantity, quantity)}={alike[0].head}.",
                code="several-columns",
            )
    if not is_stand([one.column for alike in known.values() for one in alike]):
        lacking = "nothing measured" if "command" in known else "no motor command"
        listing = _short(", ".join(one.head or one.name for one in series.columns), 200)
        raise DataError(
            f"{series.path}: {lacking} among {listing}. Name columns by `columns`, as in cmd=1,thrust_n=2. Known "
            f"names: {KNOWN}.",
            code="no-stand",
        )
    for quantity, alike in known.items():
        for one in alike:
            if quantity != "command" and not one.unit:
                raise ConfigError(
                    f"{series.path}: column '{one.head}' names no unit: give `unit` {one.column.name}="
                    f"{_UNITS[quantity].replace(' ', '')} or the like.",
                    code="no-unit",
                )


def _command(
    series: Series, known: Mapping[str, Sequence[Known]], how: How, findings: list[Finding], *, of_run: bool
) -> Column | None:
    """Return commands from 0 to 65535, None where the table has none, and add findings on how they were read."""
    if "command" not in known:
        how.refuse_unused(series.path, *_USED)
        return None
    (one,) = known["command"]
    raw, unit = one.column.values, one.unit
    largest = float(np.nanmax(raw))
    if factor(unit or "-", "s") is not None:
        how.refuse_unused(series.path, *_USED, "esc_us")
        raw = raw * (1e6 * (factor(unit, "s") or 1.0))
        raw = _possible(series, one.head, raw, (0.0, _LONGEST_PULSE_US), findings)
        low, high = how.esc_us or USUAL_ESC_US
        if (longest := float(np.nanmax(raw))) > high:
            line = _line(series, raw > high)
            raise DataError(
                f"{series.path}:{line}: {longest:g} us in '{one.head}' is longer than the full throttle of `esc_us` "
                f"{low:g},{high:g}: give the range of this motor controller.",
                code="pulse-too-long",
            )
        if how.esc_us is None:
            findings.append(finding("esc-range-assumed", low=low, high=high, full=FULL_COMMAND))
        values = np.rint((raw.clip(low) - low) / (high - low) * FULL_COMMAND)
    elif how.dshot:
        how.refuse_unused(series.path, *_USED, "dshot")
        raw = _possible(series, one.head, raw, (0.0, _DSHOT[1]), findings)
        values = np.rint((raw.clip(_DSHOT[0]) - _DSHOT[0]) / (_DSHOT[1] - _DSHOT[0]) * FULL_COMMAND)
    elif unit and unit.lower() != "pwm":
        how.refuse_unused(series.path, *_USED)
        share = factor(unit, "1")
        if share is None:
            raise DataError(
                f"{series.path}: column '{one.head}' is in '{unit}', which is no unit of a command: us, %, fraction, "
                "or none for 0 to 65535.",
                code="other-unit",
            )
        values = _possible(series, one.head, raw, (0.0, 1 / share), findings) * (share * FULL_COMMAND)
    else:
        how.refuse_unused(series.path, *_USED)
        values = _possible(series, one.head, raw, (0.0, float(FULL_COMMAND)), findings)
        if 0 < largest <= _LEAST_FULL and not of_run:
            raise ConfigError(
                f"{series.path}: no command above {largest:g} of {FULL_COMMAND} in '{one.head}': state its unit, by "
                f"`unit` {one.column.name}=% (0 to 100), =fraction (0 to 1) or =us (pulse widths), or give `dshot`.",
                code="no-unit",
            )
    of_controller = re.match("esc|throttle", one.head.lower()) or factor(unit or "-", "s") is not None or how.dshot
    return Column(name="throttle" if of_controller else "cmd", unit="", values=values, head=one.head)


def holds_stand(path: Path) -> bool:
    """Return whether a path is a run that was imported from a stand's table. Raises DataError as `run_at`."""
    run = run_at(path)
    return run is not None and STAND in run.header.devices


def read_stand(path: Path, how: How | None = None) -> Recording:
    """Read a text table, or a run that was imported from one, as a recording with one series.

    Rows are in the order of their times. Raises errors as `read_table` and `series_of`.
    """
    how = how or How()
    run = run_holding(path)
    if run is not None:
        how.refuse_unused(path, "motors")
        path = run.device_file(STAND)
    table = read_table(path, how if run is None else None)
    timed = run is not None and table.heads[0] == TIME
    columns = tuple(replace(one, unit="s") if timed and one.name == TIME else one for one in table.columns)
    table = replace(table, columns=columns)
    series = series_of(table, how if run is None else How(), name=STAND, sort=True, timed=timed)
    motors = None if run is None or run.header.origin is None else run.header.origin.motors
    return Recording(path=path, source=table.source, series={STAND: series}, facts=Facts(motors=motors), run=run)


def _is_settled(time_s: Array | None) -> bool:
    """Return whether the rows at times (n,) are so far apart that each has settled."""
    return time_s is not None and len(time_s) > 1 and float(np.median(some_steps(time_s))) >= _SETTLED_S


def _times(
    recording: Recording,
    series: Series,
    known: Mapping[str, Sequence[Known]],
    command: Column | None,
    findings: list[Finding],
) -> Array | None:
    """Return the times of a record, None for settled points. Raises ConfigError for a record without times."""
    if _is_settled(series.time_s):
        assert series.time_s is not None
        findings.append(finding("rows-settled", step_s=float(np.median(some_steps(series.time_s)))))
        return None
    if series.time_s is not None or recording.run is not None or command is None:
        return series.time_s
    held = series.rows / (1 + np.count_nonzero(np.diff(command.values)))
    if held < _HELD_ROWS and series.rows <= _MOST_TYPED:
        return None
    if BITCRAZE.matches([one.head or one.name for one in series.columns]):
        findings.append(finding("rate-assumed", rate_hz=BITCRAZE.rate_hz))
        return np.arange(series.rows) / BITCRAZE.rate_hz
    raise ConfigError(
        f"{series.path}: {series.rows} rows, {held:.3g} a command, and no column is their time: give `rate_hz`, or "
        "name the time by `columns` t=COLUMN. Of points that had settled, `rate_hz` 0.5 states that they are seconds "
        "apart.",
        code="no-time",
    )


def _measured(series: Series, quantity: str, one: Known, findings: list[Finding]) -> Column:
    """Return a measured column in its unit of a run, under the name that states it, without impossible values."""
    values, unit = one.column.values, _UNITS[quantity]
    name = {"thrust": "thrust_n", "torque": "torque_nm", "voltage": "vbat_v", "grams": "grams"}.get(quantity, "")
    if quantity == "speed":
        place = re.sub(r"\D", "", one.head) if one.kind in ("series", "rotors") else ""
        name = f"{SPEED_NAMES[cast(Speeds, one.kind)]}{place}_rad_s"
    grams = _WEIGHTS.get(one.unit.lower()) if quantity in ("thrust", "grams") else None
    scale = grams if grams or quantity == "grams" else factor(one.unit, unit)
    if scale is None:
        raise DataError(
            f"{series.path}: column '{one.head}' is in '{one.unit}', which is no unit of {quantity}. Where the name is "
            f"wrong, give `unit` {one.column.name}=...",
            code="other-unit",
        )
    values = values if scale == 1 else values * scale
    if quantity == "speed":
        values = -values if np.nanmax(values) <= -_NOISE * np.nanmin(values) else values
        noise = (values < 0) & (values >= -_NOISE * np.nanmax(values))
        values = _possible(series, one.head, np.where(noise, 0.0, values), (0.0, np.inf), findings)
    if quantity == "voltage":
        if np.nanmedian(values) > _MOST_VOLTS:
            raise DataError(
                f"{series.path}: {np.nanmedian(values):g} V in column '{one.head}': no battery has that. Is it in "
                f"millivolts? Then give `unit` {one.column.name}=mV.",
                code="impossible",
            )
        values = _possible(series, one.head, values, (np.nextafter(0, 1), _MOST_VOLTS), findings, most=1.0)
    if grams:
        name, unit = "grams" if quantity == "grams" else "weight_g", "g"
    return Column(name=name, unit=unit, values=values, head=one.head)


def _possible(
    series: Series,
    head: str,
    values: Array,
    limits: tuple[float, float],
    findings: list[Finding],
    *,
    most: float = _IMPOSSIBLE_SHARE,
) -> Array:
    """Return values (n,) with nan in place of those outside limits. Raises DataError where these are not few."""
    low, high = limits
    wrong = (values < low) | (values > high)
    count = int(np.count_nonzero(wrong))
    if not count:
        return values
    line, first = _line(series, wrong), float(values[np.argmax(wrong)])
    if count > most * len(values):
        raise DataError(
            f"{series.path}:{line}: {first:g} in column '{head}', where {low:g} to {high:g} is possible, as in {count} "
            f"of {len(values)} rows. Is it in another unit?",
            code="impossible",
        )
    findings.append(finding("values-impossible", count=count, rows=len(values), name=head, first=first, line=line))
    return np.where(wrong, np.nan, values)


def _missing(series: Series, columns: Sequence[Column], kept: Mask) -> list[Finding]:
    """Return a finding on each column that lacks numbers in rows that are kept."""
    missing = [(column, kept & ~np.isfinite(column.values)) for column in columns]
    return [
        finding(
            "values-missing",
            name=column.head,
            count=int(np.count_nonzero(rows)),
            rows=len(rows),
            line=_line(series, rows),
        )
        for column, rows in missing
        if rows.any()
    ]


def _line(series: Series, rows: Mask) -> int:
    """Return the line in the file, counted from 1, of the first of some rows."""
    row = int(np.argmax(rows))
    return row + 1 if series.line_of_row is None else series.line_of_row(row)


def _understood(stand: Series) -> str:
    """Return the line that states how the table was read."""
    heads = ", ".join(f"{column.name} from '{column.head}'" for column in stand.columns)
    if stand.time_s is None:
        return f"{counted(stand.rows, 'settled point')}: {heads}."
    length_s = float(stand.time_s[-1] - stand.time_s[0])
    rate_hz = (stand.rows - 1) / length_s if length_s else 0.0
    return f"a recording of {length_s:.4g} s in {stand.rows} rows, {rate_hz:.3g} Hz: {heads}."


def _falls(value: Array, drive: Array) -> bool:
    """Return whether values (n,) fall as a motor is driven harder, by a drive (n,), a command or speed."""
    some = slice(None, None, len(value) // PART_ROWS + 1)  # of a long table, enough to see a sign
    level, drive = value[some], drive[some]
    known = np.isfinite(level) & np.isfinite(drive)
    if known.sum() < 2 or np.ptp(drive[known]) == 0:
        return False
    hard = drive[known] >= (drive[known].min() + drive[known].max()) / 2
    return bool(np.median(level[known][hard]) < np.median(level[known][~hard]))


def _without_dead(
    speeds: Array, heads: Sequence[str], command: Array, thrust: Array | None, *, settled: bool
) -> list[Finding]:
    """Set speeds (n, s) of a sensor that shows 0 while rotors turn to nan, and return a finding for each sensor.

    Rotors turn where another sensor or the thrust shows it or, in a table of settled points, where a sensor showed it
    at a command that was no larger.
    """
    fastest = speeds.max(axis=1, initial=0.0, where=np.isfinite(speeds))
    if settled and np.isfinite(command).all():
        order = np.argsort(command, kind="stable")
        so_far = np.maximum.accumulate(fastest[order])
        fastest = so_far[np.searchsorted(command[order], command, side="right") - 1]
    turning = fastest > _TURNING_RAD_S
    if thrust is not None and len(heads) == 1 and np.isfinite(thrust).any():
        turning |= _has_thrust(thrust, command)
    dead = (speeds == 0) & turning[:, np.newaxis]
    speeds[dead] = np.nan
    counts = zip(heads, np.count_nonzero(dead, axis=0).tolist(), strict=True)
    return [finding("speeds-dead", name=head, count=count) for head, count in counts if count]


def _has_thrust(thrust_n: Array, command: Array) -> Mask:
    """Return the rows (n,) in which the thrust shows that a rotor turns; a load cell may be untared, or drift."""
    largest = float(np.nanmax(thrust_n))
    if np.isnan(command).all():
        return np.asarray(thrust_n > _NOISE_STD * _TURNING_THRUST * largest)
    at_rest = thrust_n[(command == 0) & np.isfinite(thrust_n)]
    level, reach = 0.0, _TURNING_THRUST * largest
    if len(at_rest) >= _FEWEST_AT_REST:
        level = float(np.median(at_rest))
        reach = max(reach, _NOISE_STD * float(np.median(np.abs(at_rest - level))) / _OF_NORMAL)
    return np.asarray((command != 0) & (thrust_n > level + reach))


def _of_larger_vehicle(thrust_n: Array | None, command: Array) -> list[Finding]:
    """Return a note on a motor with its own controller that gives more than a small quadrocopter's at full command.

    Thrust goes with the square of the command.
    """
    expected = range_of("motor.max_thrust_n", "crazyflie")
    if thrust_n is None or expected is None or not np.nanmax(command) > 0:
        return []
    most = float(np.nanmax(thrust_n) * (FULL_COMMAND / np.nanmax(command)) ** 2)
    if most <= expected.largest:
        return []
    text = (
        f"about {most:.3g} N at full command are more than a motor of a small quadrocopter has "
        f"({expected.largest:g} N): where no rig.toml states the vehicle, the numbers are judged by physics alone."
    )
    return [note("motor-of-larger-vehicle", text)]


def mean_of_known(values: Array, power: int = 1) -> Array:
    """Return the mean, or the power mean, of the known values in each row (n,), nan where none is known."""
    if values.shape[1] == 1:
        return values[:, 0]
    mean = empty(len(values))
    for part in parts(len(values)):
        known = np.isfinite(values[part])
        with np.errstate(invalid="ignore"):
            total = np.sum(np.where(known, values[part], 0.0) ** power, axis=1)
            mean[part] = (total / known.sum(axis=1)) ** (1 / power)
    return mean


def _short(text: str, length: int) -> str:
    return text if len(text) <= length else f"{text[:length]}..."
