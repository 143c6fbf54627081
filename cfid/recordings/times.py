"""Find the times of a table's rows, in seconds, and refuse those that cannot be: back, still, or in another unit."""

from dataclasses import replace

import numpy as np

from cfid.counted import counted
from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, finding
from cfid.large import differences, usual_step
from cfid.recordings.recording import TIME, Array, Column, How, Series, is_time
from cfid.recordings.table import Table
from cfid.units import factor

_UNIT_OF_NAME = {"timeus": "us", "millis": "ms", "micros": "us"}  # what Arduino's functions and PX4 call their times
_PER_SECOND = {1e-3: 1e3, 1e-6: 1e6, 1e-9: 1e9}  # to divide by, since the factors are not exact
_FASTEST_S, _SLOWEST_S = 1.9e-5, 0.11  # steps of a rig's recordings without a unit: 50 kHz to 10 Hz, with margin
_REPEATED_SHARE = 0.01  # of rows that may repeat the previous time without a finding
_GAP, _LEAST_GAP_S = 10, 0.1  # usual steps, and seconds: a busy computer's stamps are late by tens of milliseconds


def time_column(table: Table, how: How) -> Column | None:
    """Return the column of times: the one that an option names `t`, else the one that is called so; None for none.

    Raises ConfigError for several, unless a rate replaces them.
    """
    named = [one for one in table.columns if one.name == TIME] if any("=" in word for word in how.columns) else []
    called = named or [one for one in table.columns if is_time(one.name)]
    if len(called) > 1 and how.rate_hz is None:
        heads = ", ".join(one.head for one in called)
        raise ConfigError(f"{table.path}: several columns of time: {heads}. Name one: `columns` t={called[0].head}.")
    return called[0] if called else None


def series_of(table: Table, how: How, *, name: str = "", sort: bool = False, timed: bool = True) -> Series:
    """Return a table's columns over its times, without the rows that have none.

    `timed` tables need times; others have none where no column and no rate gives them. With `sort`, rows
    whose time goes back are sorted. Raises DataError for times that go back or stand still, and ConfigError where there
    are none, or their unit is not known.
    """
    column = time_column(table, how)
    series = Series(
        name=name,
        path=table.path,
        columns=table.columns,
        rows=table.rows,
        line_of_row=table.line_of_row,
        source=table.source,
        findings=table.findings,
    )
    if how.rate_hz is not None:
        return _at_rate(series, how.rate_hz)
    if column is not None:
        return _over_times(series, column, sort=sort)
    if timed:
        listing = ", ".join(table.heads)
        raise ConfigError(
            f"{table.path}: no column of time among {listing}: name it, as in `columns` t=1, or give `rate_hz`.",
            code="no-time",
        )
    return series


def _over_times(series: Series, column: Column, *, sort: bool) -> Series:
    if not np.isfinite(column.values).any():
        raise DataError(
            f"{series.path}: column '{column.head}' has no number in any row. Dates and times of day are not read: "
            "write seconds, name another column by `columns`, or give `rate_hz`.",
            code="no-number",
        )
    series = series.complete([column.name])
    raw, findings = series.column(column.name).values, list[Finding]()
    back = sum(int(np.count_nonzero(step < 0)) for _, step in differences(raw))
    if back and not sort:
        row = next(at + 1 + int(np.argmax(step < 0)) for at, step in differences(raw) if np.any(step < 0))
        raise DataError(
            f"{series.line(row)}: time goes back from {raw[row - 1]:.16g} to {raw[row]:.16g}"
            f"{f', {back} times in all' if back > 1 else ''}. Are two recordings in one file, or was the clock set? "
            "Cut the file before that line, sort its rows, or give `rate_hz` for evenly spaced ones.",
            code="time-goes-back",
        )
    if back:
        series = series.kept(np.argsort(raw, kind="stable"))
        raw = series.column(column.name).values
        findings.append(finding("time-sorted", count=back, rows=len(raw)))
    if len(raw) > 1 and raw[-1] == raw[0]:
        raise DataError(
            f"{series.path}: time stands still at {raw[0]:.12g}. Were its last digits cut off, or is this not the time "
            "column? See `columns` and `rate_hz`.",
            code="time-stands-still",
        )
    scale = _seconds_per_unit(series, column, raw)
    time_s = _scaled(raw - raw[0], scale)
    repeated = sum(int(np.count_nonzero(step == 0)) for _, step in differences(raw))
    if repeated > _REPEATED_SHARE * len(raw):
        findings.append(finding("time-repeats", count=repeated, rows=len(raw)))
    findings += _gaps(series, time_s)
    return replace(
        series,
        columns=tuple(one for one in series.columns if one.head != column.head),
        time_s=time_s,
        begin_s=float(_scaled(raw[:1], scale)[0]),
        findings=(*series.findings, *(one.at(series.path.name) for one in findings)),
    )


def _gaps(series: Series, time_s: Array) -> list[Finding]:
    """Return a finding on the intervals without a row at times (n,), where one is much longer than usual."""
    usual_s = usual_step(time_s)
    least_s = max(_GAP * usual_s, _LEAST_GAP_S)
    gaps = [
        (at + int(place), float(step[place]))
        for at, step in differences(time_s)
        for place in np.flatnonzero(step > least_s)
    ]
    if not gaps:
        return []
    row, longest_s = max(gaps, key=lambda gap: gap[1])
    return [
        finding(
            "time-gaps",
            gaps=counted(len(gaps), "gap"),
            longest_s=longest_s,
            line=series.line_number(row),
            at_s=float(time_s[row]),
            usual_ms=1e3 * usual_s,
        )
    ]


def _at_rate(series: Series, rate_hz: float) -> Series:
    """Return a series over evenly spaced times, without its columns of times."""
    if not 0 < rate_hz < np.inf:
        raise ConfigError(f"`rate_hz` {rate_hz:g}: has to be above zero.")
    replaced = [one.head for one in series.columns if is_time(one.name)]
    about = (
        [finding("time-replaced", name="', '".join(replaced), rate_hz=rate_hz).at(series.path.name)] if replaced else []
    )
    return replace(
        series,
        columns=tuple(one for one in series.columns if not is_time(one.name)),
        time_s=np.arange(series.rows) / rate_hz,
        findings=(*series.findings, *about),
    )


def _seconds_per_unit(series: Series, column: Column, raw: Array) -> float:
    """Return the factor of times in their unit to seconds; 1 without a unit, where their step is one of seconds.

    Raises ConfigError that names what would fit for other steps, DataError for a unit of something else.
    """
    if unit := column.unit or _UNIT_OF_NAME.get(column.name.lower(), ""):
        scale = factor(unit, "s")
        if scale is None:
            raise DataError(
                f"{series.path}: column '{column.head}' is in '{unit}', which is no time.", code="other-unit"
            )
        return scale
    step = usual_step(raw)
    if _FASTEST_S <= step <= _SLOWEST_S:
        return 1.0
    fitting = [unit for unit, per in (("ms", 1e3), ("us", 1e6), ("ns", 1e9)) if _FASTEST_S <= step / per <= _SLOWEST_S]
    like = (
        f", as in `unit` {column.name}={fitting[0]} for its step of {step:g}" if fitting else f"; its step is {step:g}"
    )
    raise ConfigError(
        f"{series.path}: column '{column.head}' names no unit: give `unit` {column.name}=s, ms, us or ns{like}.",
        code="no-unit",
    )


def _scaled(value: Array, scale: float) -> Array:
    return value / _PER_SECOND[scale] if scale in _PER_SECOND else value * scale
