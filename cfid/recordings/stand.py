"""Thrust stands and typed tables of motors: thrust, torque, speed and voltage over the motors' commands.

Columns are known by their names, in any order; the units are those of the header or of `How`. `canonical_stand` gives
a recording under the names by which an import keeps it, `stand_of` what fits take.
"""

import re
from collections.abc import Collection, Mapping, Sequence
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
from cfid.recordings import supply
from cfid.recordings.outliers import outliers, stuck
from cfid.recordings.recording import OF_TABLES, TIME, Array, Column, Facts, How, Recording, Rows, Series
from cfid.recordings.stand_names import BITCRAZE, KNOWN, SPEED_NAMES, MotorColumn, Speeds, head_of, motor_columns
from cfid.recordings.table import read_table
from cfid.recordings.times import series_of
from cfid.records.parameters import Source
from cfid.records.run import run_at, run_holding
from cfid.units import FULL_COMMAND, ROTORS, USUAL_GRAVITY_MPS2, factor

Mask = npt.NDArray[np.bool_]

STAND = "stand"  # the device of an imported run
USUAL_ESC_US = (1000.0, 2000.0)  # pulse widths of standstill and full throttle, by convention

_UNITS = {"thrust": "N", "torque": "N m", "speed": "rad/s", "voltage": "V", "grams": "g"}
_NAMES_OF_RUN = {"thrust": "thrust_n", "torque": "torque_nm", "voltage": "vbat_v", "grams": "grams"}
_EXAMPLES = {"command": "cmd", "speed": "rpm"} | _NAMES_OF_RUN
_GRAMS = {"g": 1.0, "gram": 1.0, "grams": 1.0, "kg": 1e3}  # in a unit of a weight
_COMMANDS = ("cmd", "throttle")
_DSHOT = (48.0, 2047.0)  # smallest and largest throttle; what is below are words to the controller
_LEAST_FULL = 2500.0  # a table whose commands are all below turns no motor on the scale 0 to 65535
_LONGEST_PULSE_US = 5000.0  # beyond all that controllers take, of which few reach 2500
_MOST_VOLTS = 60.0  # more than any battery that flies, and less than its millivolts
_LARGEST = 1e9  # of any number, beyond all that is measured
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
    file. `are_stated` is whether an option or an import states the motors. `command` is nan where the file has none;
    any quantity is nan where a field was not a number.
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
    are_stated: bool
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
    return _is_complete(motor_columns(columns))


def _is_complete(quantities: Collection[str]) -> bool:
    measured = {"thrust", "torque", "speed", "grams"}.intersection(quantities)
    return bool(measured) and ("command" in quantities or ("thrust" in measured and len(measured) > 1))


def canonical_stand(recording: Recording, how: How | None = None) -> Recording:
    """Return a recording of a stand as a run keeps it: one series, under names that state their units, and its motors.

    Commands are from 0 to 65535, `cmd`, or `throttle` of a motor controller; thrust is `thrust_n` or `weight_g`, that
    of all motors, and so is `torque_nm`; speeds are in rad/s. Times are None for settled points. Raises ConfigError for
    what `how` has to state, DataError for a table without motors.
    """
    how = how or How()
    series = _stand_series(recording)
    findings = [*recording.findings, *series.findings]
    if _is_settled(series.time_s):
        findings = [gaps for gaps in findings if gaps.code != "time-gaps"]
    heads = [head_of(column) for column in series.columns]
    known = motor_columns(series.columns, [word.partition("=")[0] for word in how.columns])
    _check_names(series.path, how, known)
    for quantity, columns in list(known.items()):
        known[quantity] = [column for column in columns if np.isfinite(column.values).any()]
        findings += [finding("column-empty", name=column.head) for column in columns if column not in known[quantity]]
        if not known[quantity]:
            del known[quantity]
    findings += _one_speed(known)
    _check(series, known)
    command = _command(series, known, how, findings, of_run=recording.run is not None)
    time_s = _times(recording, series, command, findings)
    measured = [
        _measured(series, quantity, column, findings)
        for quantity in ("thrust", "torque", "voltage", "grams", "speed")
        for column in known.get(quantity, ())
    ]
    measured = [column for column in measured if np.isfinite(column.values).any()]
    kept = np.ones(series.rows, np.bool_) if command is None else np.isfinite(command.values)
    if not kept.all():
        count = int(np.count_nonzero(~kept))
        findings.append(finding("rows-without-command", count=count, rows=series.rows, line=_line(series, ~kept)))
    for column in measured:
        if (missing := kept & ~np.isfinite(column.values)).any():
            count, line = int(np.count_nonzero(missing)), _line(series, missing)
            findings.append(finding("values-missing", name=column.head, count=count, rows=series.rows, line=line))
    used = {column.head for columns in known.values() for column in columns}
    if unused := [head for head in heads if head not in used]:
        _refuse_units(series.path, how, [column.name for column in series.columns if head_of(column) in unused])
        findings.append(finding("columns-unused", names=_short(", ".join(unused), 120)))
    kept_columns = tuple(measured if command is None else [command, *measured])
    stand = replace(series, name=STAND, columns=kept_columns, time_s=time_s, findings=()).kept(kept)
    of_four = BITCRAZE.matches(heads) or any(column.kind == "total" for column in known.get("thrust", ()))
    stated = recording.facts.motors
    if how.motors is not None and stated not in (None, how.motors):
        raise ConfigError(
            f"{recording.path}: `motors` {how.motors} contradicts the run, which states {stated}: leave it out, or "
            "import the file again with it."
        )
    return replace(
        recording,
        series={STAND: stand},
        facts=replace(recording.facts, motors=how.motors or stated or (ROTORS if of_four else None)),
        findings=tuple(
            place if place.where else place.at(recording.path.name)
            for place in (note("file-read", _understood(stand)), *findings)
        ),
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
        are_stated=motors is not None and motors in (recording.facts.motors, (how or How()).motors),
        rotors={None: None, "mean": None, "rotors": len(rotors)}.get(kind, 1),
        torque_nm=values.get("torque_nm"),
        vbat_v=values.get("vbat_v"),
        grams=values.get("grams"),
        speeds_rad_s=speeds,
        speeds=kind,
        time_s=series.time_s,
        findings=(*canonical.findings, *(fault.at(path.name) for fault in findings)),
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
        off = supply.impossible(values)
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
            count = counted(int(np.count_nonzero(rows)), "value")
            findings.append(finding(code, values=count, name=column.head, first=first, line=_line(series, rows)))
    return (np.where(off | hung, np.nan, values), findings) if findings else (values, findings)


def _runs_of(values: Array, places: Rows) -> list[Rows]:
    """Return places (n,) in groups of neighbours with the same value."""
    apart = (np.diff(places) != 1) | (np.diff(values[places]) != 0)
    return np.split(places, np.flatnonzero(apart) + 1) if len(places) else []


def _stand_series(recording: Recording) -> Series:
    """Return the series that is a table of motors; where none is, the first one, whose columns a message names."""
    several = list(recording.series.values())
    return next((series for series in several if is_stand(series.columns)), several[0])


def _one_speed(known: dict[str, list[MotorColumn]]) -> list[Finding]:
    """Keep one of an electrical and an optical speed: the one that is not 0 in more rows.

    Where both are not 0 and disagree, keep the optical one, which does not depend on the number of poles.
    """
    sensors = known.get("speed", [])
    if len(sensors) != 2 or any(sensor.kind != "motor" for sensor in sensors):
        return []
    first, second = sensors
    turning = [np.nan_to_num(sensor.values) != 0 for sensor in sensors]
    rows = [int(np.count_nonzero(mask)) for mask in turning]
    if not any(rows):
        del known["speed"]
        return [finding("speeds-zero", first=first.head, second=second.head)]
    both, ratio = turning[0] & turning[1], 1.0
    if 2 * np.count_nonzero(both) >= max(rows):
        scales = [factor(sensor.unit, "rad/s") or np.nan for sensor in sensors]
        ratio = scales[0] / scales[1] * float(np.median(np.abs(first.values[both] / second.values[both])))
    if max(ratio, 1 / ratio) < _ALIKE:
        best = int(np.argmax(rows))
        sensor = sensors[best]
        known["speed"] = [sensor]
        chosen = finding("speed-chosen", name=sensor.head, rows=rows[best], other=sensors[1 - best].head)
        electrical = "electrical" in sensor.head.lower()
        return [chosen, finding("speed-electrical", name=sensor.head)] if electrical else [chosen]
    optical = [sensor for sensor in sensors if "optical" in sensor.head.lower()]
    if len(optical) != 1:
        return []
    known["speed"] = optical
    return [finding("speeds-disagree", first=first.head, second=second.head, ratio=ratio, name=optical[0].head)]


def _check_names(path: Path, how: How, known: Mapping[str, Sequence[MotorColumn]]) -> None:
    """Raise ConfigError for a name in `how.columns` that no quantity of motors has."""
    names = {TIME, *(column.name for columns in known.values() for column in columns)}
    unknown = [word for word in how.columns if word.partition("=")[0] not in names]
    if unknown:
        raise ConfigError(
            f"{path}: `columns` {unknown[0]}: a table of motors takes NAME=COLUMN, as in thrust_n=3. Known names: "
            f"{KNOWN}.",
            code="columns",
        )


def _refuse_units(path: Path, how: How, unused: Sequence[str]) -> None:
    """Raise ConfigError for the unit of a column that no quantity of motors is named after."""
    for name in set(unused) & how.units.keys():
        raise ConfigError(
            f"{path}: `unit` {name}={how.units[name]}: the column is not used. Name its quantity by `columns`, as in "
            f"thrust_n={name}. Known names: {KNOWN}.",
            code="unused",
        )


def _check(series: Series, known: Mapping[str, Sequence[MotorColumn]]) -> None:
    """Refuse several columns of one quantity, a table without motors, and columns without a unit."""
    for quantity, columns in known.items():
        if len(columns) > 1 and {column.kind for column in columns} not in ({"series"}, {"rotors"}):
            raise DataError(
                f"{series.path}: more than one column of {quantity}: {', '.join(column.head for column in columns)}. "
                f"Name one by `columns`, by its name or number, as in {_EXAMPLES[quantity]}={columns[0].head}.",
                code="several-columns",
            )
    if not _is_complete(known):
        lacking = "nothing measured" if "command" in known else "no motor command"
        listing = _short(", ".join(head_of(column) for column in series.columns), 200)
        raise DataError(
            f"{series.path}: {lacking} among {listing}. Name columns by `columns`, as in cmd=1,thrust_n=2. Known "
            f"names: {KNOWN}.",
            code="no-stand",
        )
    for quantity, columns in known.items():
        for column in columns:
            if quantity != "command" and not column.unit:
                raise ConfigError(
                    f"{series.path}: column '{column.head}' names no unit: give `unit` {column.name}="
                    f"{_UNITS[quantity].replace(' ', '')} or the like.",
                    code="no-unit",
                )


def _command(
    series: Series, known: Mapping[str, Sequence[MotorColumn]], how: How, findings: list[Finding], *, of_run: bool
) -> Column | None:
    """Return commands from 0 to 65535, None where the table has none, and add findings on how they were read."""
    column = known["command"][0] if "command" in known else None
    named_by_controller = column is not None and re.match("esc|throttle", column.head.lower()) is not None
    unit = "" if column is None else column.unit or ("us" if how.esc_us and named_by_controller else "-")
    in_pulses = factor(unit, "s")
    pulses = in_pulses is not None
    dshot = column is not None and how.dshot and not pulses
    how.refuse_unused(series.path, *OF_TABLES, "motors", *(["esc_us"] if pulses else []), *(["dshot"] if dshot else []))
    if column is None:
        return None

    def scaled(most: float, low: float = 0.0, high: float = 1.0) -> Array:
        """Return commands from numbers up to `most`, of which `low` is standstill and `high` full throttle."""
        values = _possible(series, column.head, column.values, (0.0, most), findings)
        return np.asarray((values.clip(low) - low) / (high - low) * FULL_COMMAND)

    largest = float(np.nanmax(column.values))
    if in_pulses is not None:
        us = 1e6 * in_pulses
        low, high = how.esc_us or USUAL_ESC_US
        values = np.rint(scaled(_LONGEST_PULSE_US / us, low / us, high / us))
        if np.nanmax(values) > FULL_COMMAND:
            row = values > FULL_COMMAND
            raise DataError(
                f"{series.path}:{_line(series, row)}: {column.values[row][0] * us:g} us in '{column.head}' is longer "
                f"than the full throttle of `esc_us` {low:g},{high:g}: give the range of this motor controller.",
                code="pulse-too-long",
            )
        if how.esc_us is None:
            findings.append(finding("esc-range-assumed", low=low, high=high, full=FULL_COMMAND))
    elif dshot:
        values = np.rint(scaled(_DSHOT[1], *_DSHOT))
    elif column.unit and column.unit.lower() != "pwm":
        share = factor(column.unit, "1")
        if share is None:
            raise DataError(
                f"{series.path}: column '{column.head}' is in '{column.unit}', which is no unit of a command: us, %, "
                "fraction, or none for 0 to 65535.",
                code="other-unit",
            )
        values = scaled(1 / share, high=1 / share)
    else:
        values = scaled(FULL_COMMAND, high=FULL_COMMAND)
        if 0 < largest <= _LEAST_FULL and not of_run:
            raise ConfigError(
                f"{series.path}: no command above {largest:g} of {FULL_COMMAND} in '{column.head}': state its unit, by "
                f"`unit` {column.name}=% (0 to 100), =fraction (0 to 1) or =us (pulse widths), or give `esc_us` dshot.",
                code="no-unit",
            )
    of_controller = pulses or dshot or named_by_controller
    return Column(name="throttle" if of_controller else "cmd", unit="", values=values, head=column.head)


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
    if timed:
        table = replace(table, columns=(replace(table.columns[0], unit="s"), *table.columns[1:]))
    series = series_of(table, how if run is None else How(), name=STAND, sort=True, timed=timed)
    motors = None if run is None or run.header.origin is None else run.header.origin.motors
    return Recording(path=path, source=table.source, series={STAND: series}, facts=Facts(motors=motors), run=run)


def _is_settled(time_s: Array | None) -> bool:
    """Return whether the rows at times (n,) are so far apart that each has settled."""
    return time_s is not None and len(time_s) > 1 and float(np.median(some_steps(time_s))) >= _SETTLED_S


def _times(recording: Recording, series: Series, command: Column | None, findings: list[Finding]) -> Array | None:
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
    if BITCRAZE.matches([head_of(column) for column in series.columns]):
        findings.append(finding("rate-assumed", rate_hz=BITCRAZE.rate_hz))
        return np.arange(series.rows) / BITCRAZE.rate_hz
    raise ConfigError(
        f"{series.path}: {series.rows} rows, {held:.3g} a command, and no column is their time: give `rate_hz`, or "
        "name the time by `columns` t=COLUMN. Of points that had settled, `rate_hz` 0.5 states that they are seconds "
        "apart.",
        code="no-time",
    )


def _measured(series: Series, quantity: str, column: MotorColumn, findings: list[Finding]) -> Column:
    """Return a measured column in its unit of a run, under the name that states it, without impossible values."""
    name, unit = _NAMES_OF_RUN.get(quantity, ""), _UNITS[quantity]
    if quantity == "speed":
        place = re.sub(r"\D", "", column.head) if column.kind in ("series", "rotors") else ""
        name = f"{SPEED_NAMES[cast(Speeds, column.kind)]}{place}_rad_s"
    grams = _GRAMS.get(column.unit.lower()) if quantity in ("thrust", "grams") else None
    if grams is not None and quantity == "thrust":
        name, unit = "weight_g", "g"
    scale = grams or (None if quantity == "grams" else factor(column.unit, unit))
    if scale is None:
        raise DataError(
            f"{series.path}: column '{column.head}' is in '{column.unit}', which is no unit of {quantity}. Where the "
            f"name is wrong, give `unit` {column.name}=...",
            code="other-unit",
        )
    values = column.values if scale == 1 else column.values * scale
    if quantity == "speed":
        values = -values if np.nanmax(values) <= -_NOISE * np.nanmin(values) else values
        noise = (values < 0) & (values >= -_NOISE * np.nanmax(values))
        values = _possible(series, column.head, np.where(noise, 0.0, values), (0.0, _LARGEST), findings)
    elif quantity != "voltage":
        values = _possible(series, column.head, values, (-_LARGEST, _LARGEST), findings)
    else:
        if np.nanmedian(values) > _MOST_VOLTS:
            raise DataError(
                f"{series.path}: {np.nanmedian(values):g} V in column '{column.head}': no battery has that. Is it in "
                f"millivolts? Then give `unit` {column.name}=mV.",
                code="impossible",
            )
        values = _possible(series, column.head, values, (np.nextafter(0, 1), _MOST_VOLTS), findings, most=1.0)
    return Column(name=name, unit=unit, values=values, head=column.head)


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
    impossible = counted(count, "value")
    findings.append(finding("values-impossible", values=impossible, name=head, first=first, line=line))
    return np.where(wrong, np.nan, values)


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
    return [finding("speeds-dead", name=head, rows=counted(count, "row")) for head, count in counts if count]


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
