"""Runs of `cfid log wind`, all commands in one wind, to one mean force a command."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cfid.drag.wind.plan import setting_of
from cfid.drag.wind.recordings import HEARD, Recordings, Reduced, assumptions, shown_rpm, wind_run
from cfid.errors import CfidError, DataError, FitError

if TYPE_CHECKING:
    from cfid.estimate.staircase import Point
    from cfid.records.parameters import Source
    from cfid.records.run import Run
    from cfid.records.tables.vehicle import Rows
    from cfid.records.tables.wrench import WrenchRecord

_SAG = 0.005  # of the voltage: thrust then changes by a hundredth, which is as much as weak drag


def reduce_run(path: Path, how: Recordings) -> Reduced:
    """Reduce each command of a run, and say which lack the rotors' speed.

    Raises DataError or FitError that name the run, the latter where all of them lack it.
    """
    from cfid.drag.wind.mean_forces import of_point
    from cfid.records.tables.times import run_at
    from cfid.records.tables.vehicle import READINGS, begin_s, holds, read_rows
    from cfid.records.tables.wrench import LOADCELL, read_wrench

    run = run_at(path)
    if run is None:
        raise DataError(f"{path}: no run folder; recordings of others are named in an --index FILE.")
    setting, record = setting_of(run), read_wrench(path, how.reading)
    began_s = begin_s(run.device_file(LOADCELL))
    points, said, source = _settled(run, record, began_s)
    readings = read_rows(run, READINGS) if holds(run, READINGS) else None
    facts = how.given.over(run.header.rig)
    said += assumptions(facts, setting, typed=readings is not None)
    windy, runs, kept, unheard = setting.max_mps > 0, [], [], []
    for point in points:
        typed, mean, name = _typed(readings, began_s, point), of_point(point), f"{record.name} command {point.command}"
        try:
            shown = shown_rpm(typed, record, mean, facts, name=name, windy=windy)
        except FitError as error:
            unheard.append(error)
            continue
        said += [HEARD] if windy and not typed else []
        runs.append(wind_run(mean, shown, facts, name=name, command=point.command or 0, place=setting))
        kept.append(point)
    if not runs:
        raise unheard[0]
    said += [f"{error} It is left out." for error in unheard]
    return Reduced(
        runs=tuple(runs),
        notes=(*record.notes, *said),
        sources=(record.source, source, *([readings.source] if readings else [])),
        volts=_volts(run, began_s, kept),
    )


def sagged(parts: Sequence[Reduced]) -> list[str]:
    """Say where the battery was not at the voltage of its reference: the thrust without wind is another one then."""
    told = [pair for part in parts for pair in zip(part.runs, part.volts, strict=bool(part.volts))]
    references = {run.command: level for run, level in told if not run.windy}
    off = {
        run.name: level / references[run.command] - 1
        for run, level in told
        if run.windy and run.command in references and abs(level / references[run.command] - 1) > _SAG
    }
    if not off:
        return []
    name, most = max(off.items(), key=lambda item: abs(item[1]))
    return [
        f"{len(off)} run(s) had another battery voltage than their reference, {name} by {100 * most:+.1f} %: thrust "
        "follows it, and passes for drag along z. Feed the vehicle from a supply of constant voltage."
    ]


def _settled(run: "Run", record: "WrenchRecord", began_s: float) -> "tuple[tuple[Point, ...], list[str], Source]":
    """Reduce the staircase of a run: its rests give the tare, in the wind and with still rotors."""
    from cfid.estimate.staircase import reduce_staircase
    from cfid.records.tables.vehicle import read_commands

    rows, commands = read_commands(run)
    try:
        found = reduce_staircase(
            time_s=record.time_s,
            channels=record.force_n,
            status=record.status,
            command_time_s=rows.time_s - began_s,
            commands=commands,
        )
        settled = found.steady()
    except CfidError as error:
        raise type(error)(f"{run.folder}: {error}") from None
    return settled, [f"{record.name}: {finding.text}" for finding in found.findings], rows.source


def _typed(readings: "Rows | None", began_s: float, point: "Point") -> float | None:
    """Return the reading that was typed at a point, None where there is none."""
    if readings is None:
        return None
    there = (readings.columns["command"] == point.command) & (readings.time_s - began_s >= point.begin_s)
    typed = readings.columns["rpm"][there]
    return float(typed[0]) if len(typed) else None


def _volts(run: "Run", began_s: float, points: "Sequence[Point]") -> tuple[float, ...]:
    """Return the battery's mean voltage at each point, nan where the vehicle logged none."""
    from cfid.estimate.staircase import mean_beside
    from cfid.records.tables.vehicle import VEHICLE_LOG, holds, read_rows

    rows = read_rows(run, VEHICLE_LOG) if holds(run, VEHICLE_LOG) else None
    if rows is None or "pm.vbat" not in rows.columns:
        return (float("nan"),) * len(points)
    return tuple(mean_beside(points, rows.time_s - began_s, rows.columns["pm.vbat"]).tolist())
