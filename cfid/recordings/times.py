"""Find the times of a table's rows, in seconds, and refuse those that cannot be: back, still, or in another unit."""

from dataclasses import dataclass, replace

import numpy as np

from cfid.counted import counted
from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, finding
from cfid.large import differences, usual_step
from cfid.recordings.recording import TIME, Array, Column, How, Rows, Series, is_time
from cfid.recordings.table import Table
from cfid.units import factor

_UNIT_OF_NAME = {"timeus": "us", "millis": "ms", "micros": "us"}  # what Arduino's functions and PX4 call their times
_PER_SECOND = {1e-3: 1e3, 1e-6: 1e6, 1e-9: 1e9}  # to divide by, since the factors are not exact
_FASTEST_S, _SLOWEST_S = 1.9e-5, 0.11  # steps of a rig's recordings without a unit: 50 kHz to 10 Hz, with margin
_REPEATED_SHARE = 0.01  # of rows that may repeat the previous time without a finding
_GAP, _LEAST_GAP_S = 10, 0.1  # usual steps, and seconds: a busy computer's stamps are late by tens of milliseconds


@dataclass(frozen=True, kw_only=True, eq=False)
class Times:
    """Times (n,) in s since the first row, the first row's time by the file's clock (None without), and findings.

    `order` are the places of the rows in the file, None where they are in order.
    """

    time_s: Array
    begin_s: float | None
    findings: tuple[Finding, ...]
    order: Rows | None = None


def time_column(table: Table, how: How) -> Column | None:
    """Return the column of times: the one that an option names `t`, else the one that is called so; None for none.

    Raises ConfigError for several.
    """
    named = [one for one in table.columns if one.name == TIME] if any("=" in word for word in how.columns) else []
    called = named or [one for one in table.columns if is_time(one.name)]
    if len(called) > 1:
        heads = ", ".join(one.head for one in called)
        raise ConfigError(f"{table.path}: several columns of time: {heads}. Name one: `columns` t={called[0].head}.")
    return called[0] if called else None


def series_of(table: Table, how: How, *, name: str = "", sort: bool = False, timed: bool = True) -> Series:
    """Return a table's columns over its times, without the rows that have none.

    `timed` tables need times; others have none where no column and no rate gives them. With `sort`, or
    `how.sort_times`, rows whose time goes back are sorted. Raises DataError for times that go back or stand still, and
    ConfigError where there are none, or their unit is not known.
    """
    column = time_column(table, how)
    others = tuple(one for one in table.columns if one is not column)
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
        return _at_rate(replace(series, columns=others), column, how.rate_hz)
    if column is None:
        if timed:
            listing = ", ".join(table.heads)
            raise ConfigError(
                f"{table.path}: no column of time among {listing}: name it, as in `columns` t=1, or give `rate_hz`.",
                code="no-time",
            )
        return series
    series = series.complete([column.name])
    raw = series.column(column.name).values
    times = times_of(series, replace(column, values=raw), sort=sort or how.sort_times)
    series = series if times.order is None else series.kept(times.order)
    kept = tuple(one for one in series.columns if one.head != column.head)
    findings = (*series.findings, *(one.at(table.path.name) for one in times.findings))
    return replace(series, columns=kept, time_s=times.time_s, begin_s=times.begin_s, findings=findings)


def times_of(series: Series, column: Column, *, sort: bool = False) -> Times:
    """Return the times of a column's finite numbers (n,). Raises as `series_of`."""
    raw, order, findings = column.values, None, list[Finding]()
    unit = column.unit or _UNIT_OF_NAME.get(column.name.lower(), "")
    back = sum(int(np.count_nonzero(step < 0)) for _, step in differences(raw))
    if back and not sort:
        row = next(at + 1 + int(np.argmax(step < 0)) for at, step in differences(raw) if np.any(step < 0))
        raise DataError(
            f"{series.line(row)}: time goes back from {raw[row - 1]:.16g} to {raw[row]:.16g}"
            f"{f', {back} times in all' if back > 1 else ''}. Are two recordings in one file, or was the clock set? "
            "Cut the file before that line, sort its rows by `sort_times`, or give `rate_hz` for evenly spaced ones.",
            code="time-goes-back",
        )
    if back:
        order = np.argsort(raw, kind="stable")
        raw = raw[order]
        findings.append(finding("time-sorted", count=back, rows=len(raw)))
    if len(raw) > 1 and raw[-1] == raw[0]:
        raise DataError(
            f"{series.path}: time stands still at {raw[0]:.12g}. Were its last digits cut off, or is this not the time "
            "column? See `columns` and `rate_hz`.",
            code="time-stands-still",
        )
    scale = factor(unit, "s") if unit else _of_seconds(series, column, raw)
    if scale is None:
        raise DataError(f"{series.path}: column '{column.head}' is in '{unit}', which is no time.", code="other-unit")
    time_s = _scaled(raw - raw[0], scale)
    repeated = sum(int(np.count_nonzero(step == 0)) for _, step in differences(raw))
    if repeated > _REPEATED_SHARE * len(raw):
        findings.append(finding("time-repeats", count=repeated, rows=len(raw)))
    findings += gaps_in(series, time_s)
    return Times(time_s=time_s, begin_s=float(_scaled(raw[:1], scale)[0]), findings=tuple(findings), order=order)


def gaps_in(series: Series, time_s: Array) -> list[Finding]:
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


def _at_rate(series: Series, column: Column | None, rate_hz: float) -> Series:
    if not 0 < rate_hz < np.inf:
        raise ConfigError(f"`rate_hz` {rate_hz:g}: has to be above zero.")
    unused = (
        () if column is None else (finding("time-replaced", name=column.head, rate_hz=rate_hz).at(series.path.name),)
    )
    return replace(series, time_s=np.arange(series.rows) / rate_hz, findings=(*series.findings, *unused))


def _of_seconds(series: Series, column: Column, raw: Array) -> float:
    """Return 1 for times without a unit whose step is one of seconds. Raises ConfigError that names what would fit."""
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
