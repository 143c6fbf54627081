"""An angle over time, in seconds and radians, continuous over turns: of an encoder, or of a gyro as its integral."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, finding, of_recording, texts
from cfid.large import chosen_rows, differences, empty, parts, usual_step
from cfid.recordings.gyro import Rates, gyro_series, rotation_of
from cfid.recordings.outliers import outliers
from cfid.recordings.read import read_recording
from cfid.recordings.recording import (
    ANGLE,
    COUNTS,
    ENCODER,
    FEWEST_ROWS,
    OF_TABLES,
    Array,
    Column,
    How,
    Recording,
    Rows,
    Series,
    is_angle,
)
from cfid.recordings.stamps import by_stamps
from cfid.records.files import RUN_FILE
from cfid.records.parameters import Source
from cfid.records.run import Facts, Label, Run, facts_of, gaps
from cfid.units import factor
from cfid.wire.rls import RLS_13BIT_IN_22, turns_of

Mask = npt.NDArray[np.bool_]
CountsPerTurn = float | str

_EXACT = 2.0**53  # above it, numbers lose their last whole digits; no axis turns that far
_FAILED_SHARE = 0.01  # of 13-bit words that may fail their check
_OUTLIER_RAD = 0.1
_JUMP_RAD, _JUMP_SHARE = np.pi / 2, 0.01  # at half a turn the direction is ambiguous; share of samples that may jump
_FOLDED_TURNS = 1.5  # range of an angle that may be wrapped into one turn, with margin for a wrong scale
_RANKED = 1_000_000  # samples whose percentiles show the range


@dataclass(frozen=True, kw_only=True)
class AxisRecord:
    """A recording of a body that turned about an axis: where it lies, its label, a gyro's `rates`, and findings."""

    path: Path
    source: Source
    label: Label
    findings: tuple[Finding, ...] = ()
    run: str | None = None
    rates: Rates | None = None

    @property
    def name(self) -> str:
        """The run's name, or the file's."""
        return self.run or self.path.stem

    @property
    def notes(self) -> tuple[str, ...]:
        """What the record's reader noted, in sentences that name the run or the file."""
        return texts(self.findings, "warning")


@dataclass(frozen=True, kw_only=True)
class AngleRecord(AxisRecord):
    """An angle (n,), continuous over turns, at increasing times (n,) since the first sample.

    `begin_s` is the first sample's time by the file's clock, Unix time in a run, and 0 without one. `time_scale_std` is
    the relative standard uncertainty of intervals beyond that of this computer's clock. A gyro's angle is the integral
    of its `rates`, which fits use.
    """

    time_s: Array
    angle_rad: Array
    begin_s: float = 0.0
    time_scale_std: float = 0.0


AngleSource = AxisRecord | Recording | Run | Path | str
AnyRecord = TypeVar("AnyRecord", bound=AxisRecord)


def angle_of(
    recording: Recording, how: How | None = None, *, rig_counts_per_turn: CountsPerTurn | None = None
) -> AngleRecord:
    """Return the angle of a recording: that of its encoder, of a column of angles, or of a gyro without either.

    `how.counts_per_turn` replaces the run's own; `rig_counts_per_turn` is used where neither states any.

    Raises ConfigError for what is missing or contradicts the recording, DataError for a recording without an angle, for
    too many faults, and for samples too far apart to count whole turns.
    """
    how = how or How()
    series = _encoder_series(recording)
    if series is None:
        return _angle_of_gyro(recording)
    column = _angle_column(series, how, recording.run)
    counted = column.unit in ("", *COUNTS)
    if recording.run is None:
        how.refuse_unused(series.path, *OF_TABLES, *(("counts_per_turn",) if counted else ()))
    if series.time_s is None:
        raise ConfigError(f"{series.path}: no column of time: name it, as in `columns` t=1.", code="no-time")
    series, column = _complete(series, column)
    scale_std = 0.0
    per_turn, about_run = how.counts_per_turn, tuple[Finding, ...]()
    if recording.run is not None:
        series, scale_std = by_stamps(series)
        column = series.column(column.name)
        if counted:
            per_turn = per_turn or recording.run.header.devices[ENCODER].counts_per_turn
        about_run = of_recording(recording.name, gaps(facts_of(recording.run, ENCODER, Facts)))
    if series.rows < FEWEST_ROWS:
        raise DataError(f"{series.path}: {series.rows} rows; a recording has at least {FEWEST_ROWS}.", code="few-rows")
    turns, valid, about_counts = _turns(series, column, per_turn, rig_counts_per_turn)
    series = series if valid is None else series.kept(valid)
    angle_rad, rows, about_angle = continuous(series, turns)
    series = series if rows is None else series.kept(rows)
    time_s = np.zeros(series.rows) if series.time_s is None else series.time_s
    first_s = float(time_s[0])
    place = series.path.name if recording.run is None else f"{recording.name}/{series.path.name}"
    found = (*about_counts, *about_angle)
    if recording.run is None:
        understood = finding(
            "file-read",
            rows=len(time_s),
            step_ms=1e3 * usual_step(time_s),
            column=column.head or column.name,
            low_deg=math.degrees(angle_rad.min()),
            high_deg=math.degrees(angle_rad.max()),
        )
        found = (understood, *found)
    return AngleRecord(
        path=series.path,
        source=series.source or recording.source,
        label=recording.facts.label,
        time_s=time_s - first_s if first_s else time_s,
        angle_rad=angle_rad,
        findings=(*recording.findings, *about_run, *series.findings, *(one.at(place) for one in found)),
        run=None if recording.run is None else recording.name,
        begin_s=first_s + (series.begin_s or 0.0),
        time_scale_std=scale_std,
    )


def _encoder_series(recording: Recording) -> Series | None:
    """Return the series that holds an angle; None for a recording of a gyro without one.

    Raises DataError for a run without either, or without rows of them.
    """
    if recording.run is not None:
        if ENCODER in recording.series:
            return recording.series[ENCODER]
        if _gyro_of(recording) is not None:
            return None
        raise DataError(f"{recording.run.device_file(ENCODER)}: has no rows.", code="no-rows")
    tables = list(recording.series.values())
    named = next((one for one in tables if any(map(is_angle, one.names))), None)
    return named or (tables[0] if _gyro_of(recording) is None else None)


def _gyro_of(recording: Recording) -> Series | None:
    """Return the series that holds a gyro, if any; of a run, devices without one are not read."""
    devices = {} if recording.run is None else recording.run.header.devices
    without = {name for name, record in devices.items() if not any("gyro" in column for column in record.columns)}
    return gyro_series(recording.series[name] for name in recording.series if name not in without)


def _angle_column(series: Series, how: How, run: Run | None) -> Column:
    """Return the column of the angle: the second of a run; of a table the one that is called so, or the only one.

    Raises ConfigError for none, and for several, DataError for a run without one.
    """
    if run is not None:
        names = run.header.devices[ENCODER].columns
        if len(names) < 2:
            place = f"{run.folder / RUN_FILE}: devices.{ENCODER}.columns"
            raise DataError(f"{place}: has no time and angle.", code="no-column")
        return series.column(names[1])
    if ANGLE in (word.partition("=")[0] for word in how.columns if "=" in word):
        return series.column(ANGLE)
    called = [one for one in series.columns if is_angle(one.name)]
    if not called and len(series.columns) == 1 and series.columns[0].name.isdecimal():  # without a head
        called = list(series.columns)
    if len(called) != 1:
        listing = ", ".join(one.head or one.name for one in called or series.columns)
        raise ConfigError(
            f"{series.path}: {'several columns are' if called else 'no column is called'} an angle (phi, angle, theta) "
            f"among {listing}: name one, as in `columns` {ANGLE}=COLUMN.",
            code="no-column",
        )
    return called[0]


def _complete(series: Series, column: Column) -> tuple[Series, Column]:
    """Return a series without the rows whose angle is missing or impossible, and its column of angles."""
    beyond = np.abs(column.values) >= _EXACT
    if beyond.any():
        possible = replace(column, values=np.where(beyond, np.nan, column.values))
        series = replace(series, columns=tuple(possible if one is column else one for one in series.columns))
    series = series.complete([column.name])
    return series, series.column(column.name)


def _turns(
    series: Series, column: Column, per_turn: CountsPerTurn | None, of_rig: CountsPerTurn | None
) -> tuple[Array, Mask | None, tuple[Finding, ...]]:
    """Return a column (n,) in turns, the rows (n,) that it keeps (None for all), and findings."""
    values, name = column.values, column.head or column.name
    unit = column.unit or (COUNTS[0] if per_turn is not None else "")
    if not unit:
        raise ConfigError(
            f"{series.path}: column '{name}' names no unit: give `unit` {column.name}=deg, {column.name}=rad or "
            f"{column.name}=counts with `counts_per_turn`.",
            code="no-unit",
        )
    if unit not in COUNTS:
        scale = factor(unit, "rad")
        if scale is None:
            raise DataError(
                f"{series.path}: column '{name}' is in '{unit}', which is no angle: angles are read in rad, deg and "
                f"counts. Where the name is wrong, give `unit` {column.name}=...",
                code="other-unit",
            )
        return _scaled(values, scale / (2 * np.pi)), None, ()
    setting = of_rig if per_turn is None else per_turn
    if setting is None:
        raise ConfigError(
            f"{series.path}: column '{name}' is in counts: give `counts_per_turn` N, or {RLS_13BIT_IN_22}.",
            code="no-counts-per-turn",
        )
    if not all(np.array_equal(values[part], np.rint(values[part])) for part in parts(len(values))):
        raise DataError(
            f"{series.path}: column '{name}' is read as counts but has fractions: give `unit` {column.name}=rad or "
            f"{column.name}=deg.",
            code="counts-with-fractions",
        )
    if setting == RLS_13BIT_IN_22:
        return _words(series, values)
    return _scaled(values, 1 / float(setting)), None, ()


def _scaled(values: Array, scale: float) -> Array:
    return np.multiply(values, scale, out=empty(len(values)))


def _words(series: Series, values: Array) -> tuple[Array, Mask | None, tuple[Finding, ...]]:
    """Return an encoder's 13-bit words (n,) in turns, without those that fail their check."""
    turns, valid = empty(len(values)), np.empty(len(values), bool)
    for part in parts(len(values)):
        turns[part], valid[part] = turns_of(values[part], RLS_13BIT_IN_22)
    failed = int(np.count_nonzero(~valid))
    if failed > _FAILED_SHARE * len(values):
        raise DataError(
            f"{series.path}: {failed} of {len(values)} samples fail the check of a 13-bit word in 22 bits, more than "
            f"{100 * _FAILED_SHARE:g} %: a loose cable, or another encoder (`counts_per_turn` N, e.g. 4194304).",
            code="words-failed",
        )
    if not failed:
        return turns, None, ()
    line = series.line_number(int(np.argmin(valid)))
    return turns[valid], valid, (finding("angle-words-failed", count=failed, rows=len(values), line=line),)


def continuous(series: Series, turns: Array) -> tuple[Array, Rows | None, tuple[Finding, ...]]:
    """Return the continuous angle of turns (n,) that may be wrapped into one turn, without outliers.

    Returns the rows that are kept, None for all, and findings that name lines of `series`. Raises DataError where more
    than one sample in a hundred jumps. `turns` are overwritten.
    """
    low, high = np.percentile(turns[:: len(turns) // _RANKED + 1], (1, 99))
    wrapped = high - low <= _FOLDED_TURNS
    angle = np.multiply(turns, 2 * np.pi, out=turns)
    rows: Rows | None = None
    findings = list[Finding]()
    off = np.zeros(len(angle), bool)
    for coordinate in (np.cos, np.sin) if wrapped else (np.positive,):  # on the circle, or along the angle
        off |= outliers(coordinate(angle, out=empty(len(angle))), _OUTLIER_RAD / np.sqrt(2 if wrapped else 1))
    if off.any():
        line = series.line_number(int(np.argmax(off)))
        findings.append(finding("angle-outliers", count=int(np.count_nonzero(off)), rows=len(angle), line=line))
        rows, angle = np.flatnonzero(~off), chosen_rows(angle, ~off)
    if wrapped:
        for part in parts(len(angle)):
            begin = max(part.start - 1, 0)  # unwrapped already
            angle[begin : part.stop] = np.unwrap(angle[begin : part.stop])
    order = 1 if wrapped else 2  # where whole turns are known, an axis may turn by any angle from one row to the next
    places = [begin + np.flatnonzero(np.abs(step) > _JUMP_RAD) for begin, step in differences(angle, order=order)]
    jumps = order + np.concatenate([np.empty(0, np.intp), *places])
    if len(jumps):
        line = series.line_number(int(jumps[0] if rows is None else rows[jumps[0]]))
        if len(jumps) > _JUMP_SHARE * len(angle):
            raise DataError(
                f"{series.path}:{line}: the angle jumps by more than a quarter of a turn in {len(jumps)} of "
                f"{len(angle)} samples, here first: a wrong `counts_per_turn` or `unit`, a bad cable, or too fast for "
                "this rate. Whole turns cannot be counted.",
                code="angle-jumps",
            )
        findings.append(finding("angle-jumps", count=len(jumps), rows=len(angle), line=line))
    return angle, rows, tuple(findings)


def _angle_of_gyro(recording: Recording) -> AngleRecord:
    """Return the integral of a gyro's rates as an angle about the axis of their rotation."""
    series = _gyro_of(recording)
    if series is None or series.time_s is None:
        raise DataError(f"{recording.path}: no gyro over time.", code="no-column")
    rotation = rotation_of(series)
    x, y, z = rotation.rates.axis
    about = [finding("gyro-axis", x=x, y=y, z=z)]
    if recording.facts.clock == "unknown":
        about.append(finding("gyro-clock-undecided", "swing.*", "inertia.*", "friction.*"))
    return AngleRecord(
        path=series.path,
        source=series.source or recording.source,
        label=recording.facts.label,
        time_s=rotation.time_s,
        angle_rad=rotation.angle_rad,
        findings=(*recording.findings, *series.findings, *(one.at(recording.name) for one in about)),
        run=None if recording.run is None else recording.name,
        begin_s=series.begin_s or 0.0,
        time_scale_std=rotation.time_scale_std,
        rates=rotation.rates,
    )


def angle_record(recording: AngleSource) -> AngleRecord:
    """Return a record as it is, else read that of a run or a file. Raises as `read_recording` and `angle_of`."""
    if isinstance(recording, AngleRecord):
        return recording
    if isinstance(recording, AxisRecord):
        raise DataError(f"{recording.path}: holds no angle over time.", code="no-column")
    return angle_of(recording_at(recording))


def recording_at(recording: Recording | Run | Path | str) -> Recording:
    """Return a recording as it is, else read a run or a file. Raises as `read_recording`."""
    if isinstance(recording, Recording):
        return recording
    return read_recording(recording.folder if isinstance(recording, Run) else recording)


def labelled(record: AnyRecord, **label: object) -> AnyRecord:
    """Return a record with an `axis`, `weight_g`, `weight_std_g` or `body` in its label.

    Raises ConfigError where the record's own label has another value.
    """
    known = record.label.model_dump()
    for key, value in label.items():
        if value is not None and known[key] not in (None, value):
            raise ConfigError(
                f"{record.name}: {key} {_shown(value)} contradicts the run's own label, {key} {_shown(known[key])}. "
                "Leave it out, or correct the label in run.toml.",
                code="label",
            )
    return replace(record, label=record.label.model_copy(update=label))


def _shown(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else f"'{value}'"


def counts_per_turn(text: str) -> CountsPerTurn:
    """Parse counts per turn: a number, or the name of a word format.

    Raises ConfigError for anything else.
    """
    if text == RLS_13BIT_IN_22:
        return text
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not (np.isfinite(value) and value > 0):
        raise ConfigError(f"`counts_per_turn` {text}: expected a number above zero, or {RLS_13BIT_IN_22}.")
    return value
