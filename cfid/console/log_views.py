"""The views of recordings of other programs, for `cfid show`: logs of a vehicle, and tables of thrust stands."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from cfid.console.views import View, curve_of, sampling, shown_columns
from cfid.quantities.registry import unit_of
from cfid.records.parameters import Parameter

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cfid.records.logs.log import Array, FlightLog, Series

_MOST_FIGURES = 8  # of a log with one series per topic: a hundred figures would take minutes
_DRAWN_ROWS = 20_000  # more than the dots across a page


def log_views(path: Path) -> list[View]:
    """Return a view of every series of a log. Raises DataError or ConfigError as `read_log` does."""
    from cfid.records.logs.any_kind import read_log

    log = read_log(path)
    stated = tuple(f"assumed: {text}." for text in log.assumed)
    drawn = _to_draw(log)
    views = [replace(_view(log, series), drawn=series in drawn) for series in log.series]
    notes = (*log.notes, *stated)
    if len(drawn) < len(views):
        names = ", ".join(series.name for series in drawn)
        notes += (
            f"figures of {len(drawn)} of {len(views)} series, those of known units with most rows: {names}. --json has "
            "the ranges of all, `cfid convert` their numbers.",
        )
    return [replace(views[0], lines=(log.understood,), notes=notes), *views[1:]]


def _to_draw(log: "FlightLog") -> "list[Series]":
    """Return the series that get a figure: first those with channels of known units, then those with the most rows."""
    return sorted(log.series, key=lambda one: (not any(channel.own_unit for channel in one.channels), -one.rows))[
        :_MOST_FIGURES
    ]


def stand_view(path: Path) -> View:
    """Return the view of a thrust stand's table. Raises DataError or ConfigError as `read_stand_table` does."""
    import numpy as np

    from cfid.findings import texts
    from cfid.records.tables.stand import read_stand_table

    table = read_stand_table(path)
    columns = {"cmd": None if np.isnan(table.command).all() else table.command}
    columns |= {key: getattr(table, key) for key in ("thrust_n", "torque_nm", "vbat_v", "grams")}
    if table.speeds_rad_s is not None:
        count = table.speeds_rad_s.shape[1]
        names = [f"speed_{at + 1}_rad_per_s" for at in range(count)] if count > 1 else ["speed_rad_per_s"]
        columns |= dict(zip(names, table.speeds_rad_s.T, strict=True))
    known = {name: column for name, column in columns.items() if column is not None}
    rows = np.arange(len(table.command), dtype=np.float64)
    along = "row" if table.time_s is None else "time (s)"
    at = rows if table.time_s is None else table.time_s
    return View(
        device="stand",
        name=path.name,
        path=path,
        source=table.source,
        lines=texts(table.findings, "note"),
        notes=texts(table.findings, "warning"),
        parameters=({"samples": Parameter(value=len(rows), unit="1")} if table.time_s is None else sampling(at))
        | {f"range.{name}": _range(column, unit_of(name) or "1") for name, column in known.items()},
        curve=curve_of(at, next(iter(known.values())), next(iter(known))),
        draw=lambda: _figure(at, known, title=path.name, along=along),
    )


def _view(log: "FlightLog", series: "Series") -> View:
    import numpy as np

    time_s, low, high, rows = _walked(series)
    since_s = time_s - time_s[0]
    columns = shown_columns(dict(zip(series.names, rows[:, 1:].T, strict=True)), len(rows))
    first = next((channel.name for channel in series.channels if channel.own_unit), next(iter(columns)))
    ranges = {
        f"range.{channel.name}": _range(np.array(both) * channel.factor, channel.unit)
        for channel, *both in zip(series.channels, low, high, strict=True)
    }
    return View(
        device=series.name,
        name=f"{log.path.name}, {series.name}",
        path=log.path,
        figure=log.path.stem if len(log.series) == 1 else f"{log.path.stem}_{series.name}",
        source=log.source,
        parameters=sampling(since_s) | ranges,
        curve=curve_of(rows[:, 0] - time_s[0], columns[first], first),
        draw=lambda: _figure(rows[:, 0], columns, title=f"{log.path.name}, {series.name}", along="time (s)"),
    )


def _walked(series: "Series") -> "tuple[Array, Array, Array, Array]":
    """Return a series' times (n,), each channel's lowest and highest value, and the rows (m, 1 + channels) to draw."""
    import numpy as np

    step = -(-series.rows // _DRAWN_ROWS)
    times, drawn, begun = [], [], 0
    low, high = np.full(len(series.names), np.nan), np.full(len(series.names), np.nan)
    for block in series.blocks():
        times.append(block[:, 0].copy())
        low, high = np.fmin(low, np.fmin.reduce(block[:, 1:])), np.fmax(high, np.fmax.reduce(block[:, 1:]))
        drawn.append(block[-begun % step :: step].copy())
        begun += len(block)
    return np.concatenate(times), low, high, np.concatenate(drawn)


def _range(values: "Array", unit: str) -> Parameter:
    import numpy as np

    known = values[np.isfinite(values)]
    return Parameter(value=[float(known.min()), float(known.max())] if len(known) else [np.nan, np.nan], unit=unit)


def _figure(time_s: "Array", columns: "Mapping[str, Array]", *, title: str, along: str) -> "Figure":
    from cfid.drawing.device import device_figure

    return device_figure(time_s, columns, title=title, notes=(), along=along)
