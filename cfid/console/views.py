"""The view of each series in a recording, for `cfid show`: numbers and a figure."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cfid.console.inputs import Workplace, counts_of_rig, find_recording
from cfid.drawing.recordings import device_figure, recording_figure, wrench_figure
from cfid.errors import DataError
from cfid.findings import texts
from cfid.large import differences, some_steps
from cfid.quantities.registry import unit_of
from cfid.recordings.angle import angle_of
from cfid.recordings.crazyflie import si_unit
from cfid.recordings.read import description, kind_of, read_recording
from cfid.recordings.recording import ENCODER, Column
from cfid.recordings.stand import stand_of
from cfid.recordings.vehicle import SUPERVISOR
from cfid.recordings.wrench import AXES, LOADCELL, wrench_of
from cfid.records.parameters import Parameter, Source
from cfid.wire.supervisor import VehicleState

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cfid.recordings.angle import AngleRecord
    from cfid.recordings.recording import Array, Column, Recording, Series
    from cfid.recordings.wrench import WrenchRecord

_MOST_FIGURES = 8  # of a log with one series per topic: a hundred figures would take minutes
_DRAWN_ROWS = 20_000  # more than the dots across a page


@dataclass(frozen=True, kw_only=True)
class View:
    """One device's recording, ready to show; `lines` state how a file of another program was read.

    `figure` is the name of the figure's file, "" for a view of a log with too many series, which is not drawn.
    """

    device: str
    path: Path
    source: Source
    parameters: dict[str, Parameter]
    draw: "Callable[[], Figure]"
    notes: tuple[str, ...] = ()
    lines: tuple[str, ...] = ()
    figure: str


def views_of(word: str, workplace: Workplace) -> tuple[list[View], tuple[str, ...]]:
    """Read a RUN; return a view of every readable device in it, and why the others could not be read.

    A file outside a run is identified by its columns. Raises DataError when nothing can be read, and ConfigError for a
    file that needs an option of `cfid import`.
    """
    recording = read_recording(find_recording(word, workplace))
    of_rig = counts_of_rig(recording, workplace)
    readers: dict[str, Callable[[], View]] = {
        ENCODER: lambda: _angle_view(angle_of(recording, rig_counts_per_turn=of_rig)),
        LOADCELL: lambda: _wrench_view(wrench_of(recording)),
    }
    if recording.run is None:
        series = list(recording.series.values())
        kind = kind_of(series[0].columns) if len(series) == 1 else "flight"
        if kind in ("angle", "wrench"):
            return [readers[ENCODER if kind == "angle" else LOADCELL]()], ()
        return ([_stand_view(recording)] if kind == "stand" else _log_views(recording)), ()
    order = sorted(recording.run.header.devices, key=lambda device: [*readers, device].index(device))
    views: list[View] = []
    faults: list[DataError] = []
    for device in order or [ENCODER]:
        try:
            read = readers.get(device)
            views.append(_device_view(recording, device) if read is None else read())
        except DataError as fault:  # a fault in one does not hide the others
            faults.append(fault)
    if not views:
        raise faults[0]
    return views, tuple(str(fault) for fault in faults)


def _angle_view(record: "AngleRecord") -> View:
    range_rad = Parameter(value=float(np.ptp(record.angle_rad)), unit="rad")
    return _record_view(ENCODER, record, {"range_rad": range_rad}, lambda: recording_figure(record, title=record.name))


def _wrench_view(record: "WrenchRecord") -> View:
    return _record_view(LOADCELL, record, _means(record), lambda: wrench_figure(record, title=record.name))


def _record_view(
    device: str, record: "AngleRecord | WrenchRecord", parameters: dict[str, Parameter], draw: "Callable[[], Figure]"
) -> View:
    return View(
        device=device,
        path=record.path,
        source=record.source,
        notes=texts(record.findings, "warning", "rejection"),
        lines=texts(record.findings, "note"),
        parameters=_sampling(record.time_s, len(record.time_s)) | parameters,
        draw=draw,
        figure=f"{record.path.stem}_recording",
    )


def _means(record: "WrenchRecord") -> dict[str, Parameter]:
    """Return means and scatter of forces and torques: as vectors, or axis by axis for a load cell with fewer axes."""
    if record.axes == AXES:
        return {
            "mean_n": Parameter(value=record.force_n.mean(axis=0), unit="N"),
            "std_n": Parameter(value=record.force_n.std(axis=0), unit="N"),
            "mean_nm": Parameter(value=record.torque_nm.mean(axis=0), unit="N m"),
            "std_nm": Parameter(value=record.torque_nm.std(axis=0), unit="N m"),
        }
    parameters = {}
    for axis in record.axes:
        values, unit = record.values_of(axis), "N" if axis.startswith("F") else "N m"
        parameters[f"mean.{axis}"] = Parameter(value=float(values.mean()), unit=unit)
        parameters[f"std.{axis}"] = Parameter(value=float(values.std()), unit=unit)
    return parameters


def _device_view(recording: "Recording", device: str) -> View:
    series = recording.series.get(device)
    if series is None:
        raise DataError(f"{recording.path}: {device} has no rows.")
    time_s = series.time_s
    notes = texts(series.findings)
    if device == SUPERVISOR and time_s is not None:
        notes += (_states(time_s, series.column("state").values),)
    means = {
        f"mean.{column.name}": Parameter(
            value=float(column.values.mean()), unit=unit_of(f"recording.mean.{column.name}")
        )
        for column in series.columns
        if device != SUPERVISOR  # a word of bits has no mean
    }
    view = _series_view(series, title=f"{recording.name}, {device}", notes=notes)
    return replace(view, parameters=view.parameters | means)


def _log_views(recording: "Recording") -> list[View]:
    """Return a view of every series of a log; figures only of those of known units with most rows."""
    several = list(recording.series.values())
    most = sorted(several, key=lambda series: (not any(column.unit for column in series.columns), -series.rows))[
        :_MOST_FIGURES
    ]
    views = []
    for series in several:
        view = _series_view(series, title=f"{recording.path.name}, {series.name}")
        stem = recording.path.stem if len(several) == 1 else f"{recording.path.stem}_{series.name}"
        ranges = {f"range.{column.name}": _range_of(column) for column in series.columns}
        figure = f"{stem}_recording" if series in most else ""
        views.append(replace(
            view, path=recording.path, source=recording.source, figure=figure, parameters=view.parameters | ranges
        ))  # fmt: skip
    notes = texts(recording.findings, "warning", "rejection")
    if len(most) < len(views):
        names = ", ".join(series.name for series in most)
        notes += (
            f"figures of {len(most)} of {len(views)} series, those of known units with most rows: {names}. `json` has "
            "the ranges of all, `cfid convert` their numbers.",
        )
    lines = (description(recording), *texts(recording.findings, "note"))
    return [replace(views[0], lines=lines, notes=notes), *views[1:]]


def _stand_view(recording: "Recording") -> View:
    """Return the view of a thrust stand's table in SI units."""
    table = stand_of(recording)
    values = {"cmd": table.command, "thrust_n": table.thrust_n, "torque_nm": table.torque_nm, "vbat_v": table.vbat_v}
    values |= {"grams": table.grams}
    if table.speeds_rad_s is not None:
        count = table.speeds_rad_s.shape[1]
        names = [f"speed_{at + 1}_rad_per_s" for at in range(count)] if count > 1 else ["speed_rad_per_s"]
        values |= dict(zip(names, table.speeds_rad_s.T, strict=True))
    columns = tuple(
        Column(name=name, unit=unit_of(name) or "1", values=column)
        for name, column in values.items()
        if column is not None and not np.isnan(column).all()
    )
    series = replace(
        next(iter(recording.series.values())), columns=columns, rows=len(table.command), time_s=table.time_s
    )
    view = _series_view(series, title=recording.path.name)
    return replace(
        view,
        device="stand",
        path=recording.path,
        source=table.source,
        lines=texts(table.findings, "note"),
        notes=texts(table.findings, "warning", "rejection"),
        parameters=view.parameters | {f"range.{column.name}": _range_of(column) for column in columns},
        figure=f"{recording.path.stem}_recording",
    )


def _series_view(series: "Series", *, title: str, notes: tuple[str, ...] = ()) -> View:
    """Return a view of any series: its columns over time, or for settled points over the rows."""
    step = -(-series.rows // _DRAWN_ROWS)
    along = np.arange(float(series.rows)) if series.time_s is None else series.time_s
    # Events without variables are only times: a running count shows them.
    columns = {column.name: column.values for column in series.columns} or {"events": np.arange(1.0, series.rows + 1)}

    def draw() -> "Figure":
        drawn = {name: values[::step] for name, values in columns.items()}
        axis = "row" if series.time_s is None else "time (s)"
        return device_figure(along[::step], drawn, title=title, notes=notes, along=axis)

    return View(
        device=series.name,
        path=series.path,
        source=series.source or Source(str(series.path), ""),
        notes=notes,
        parameters=_sampling(series.time_s, series.rows),
        draw=draw,
        figure=f"{series.path.stem}_recording",
    )


def _states(since_s: "Array", words: "Array") -> str:
    """Return the vehicle's states in order, each with the time in seconds at which it began."""
    named = [(time_s, VehicleState.of(int(word)).name) for time_s, word in zip(since_s, words, strict=True)]
    changes = [named[0], *(after for before, after in pairwise(named) if after[1] != before[1])]
    return "vehicle: " + ", ".join(f"{name} at {time_s:.1f} s" for time_s, name in changes)


def _range_of(column: "Column") -> Parameter:
    """Return the lowest and the highest number of a column, in its SI unit where its unit is known."""
    values = column.values[np.isfinite(column.values)]
    unit, factor = si_unit(column)
    both = [factor * float(values.min()), factor * float(values.max())] if len(values) else [np.nan, np.nan]
    return Parameter(value=both, unit=unit)


def _sampling(time_s: "Array | None", rows: int) -> dict[str, Parameter]:
    """Return the number of rows and, for times (rows,) since the first, their duration and their intervals."""
    samples = {"samples": Parameter(value=rows, unit="1")}
    if time_s is None or rows < 2:
        return samples
    return samples | {
        "duration_s": Parameter(value=float(time_s[-1]), unit="s"),
        "median_interval_s": Parameter(value=float(np.median(some_steps(time_s))), unit="s"),
        "longest_interval_s": Parameter(value=max(float(step.max()) for _, step in differences(time_s)), unit="s"),
    }
