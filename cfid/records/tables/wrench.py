"""Read forces and torques over time, in seconds, N and N m, from a run folder or any CSV file.

A run contains the scale that the box reported. A CSV file outside a run is read as counts of the usual scale, with a
note; numbers that cannot be counts are an error that asks for the unit.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, of_recording, texts
from cfid.records.files import RUN_FILE
from cfid.records.parameters import Source
from cfid.records.rig_file import STAMP
from cfid.records.run import Facts, Label, Run, facts_of, file_name, gaps, losses, run_at
from cfid.records.tables.blocks import open_table
from cfid.records.tables.force_units import FORCES_N, TORQUES_NM, si_factor
from cfid.records.tables.schema import TIME, Column, Foreign, TableSchema, refuse_clock, unused_in_run
from cfid.records.tables.stamps import stamped_rows
from cfid.records.tables.table import Array, CsvTable
from cfid.records.tables.text import is_finite, short
from cfid.records.tables.times import TIME_COLUMN, complete_rows, line_notes, pauses, seconds_of, times_of
from cfid.records.tables.wrench_range import Units, check_values, possible_rows
from cfid.records.tables.wrench_status import Words, status_notes, status_words
from cfid.records.tables.wrench_units import axis_name, converted_note, refuse_other_units, units_of
from cfid.wire.rdt_status import Family, family_of

LOADCELL = "loadcell"
AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
USUAL_COUNTS = 1e6  # per N and per N m: the thesis' box, and the manufacturer's default

_STATUS = "status"
_RATE = "RDT Sample Rate"
_OF_ATI = (_RATE, "Force Units", "Counts per Unit Force", "Torque Units", "Counts per Unit Torque")
_THESIS_FAMILY: Family = "netft"  # of a file that does not state its box


def _schema(axes: Sequence[str]) -> TableSchema:
    return TableSchema(
        columns=(
            TIME_COLUMN,
            *(Column(axis, axis_name(axis), axis) for axis in axes),
            Column(_STATUS, re.compile(_STATUS, re.IGNORECASE), _STATUS, optional=True),
        ),
        words=("TIME", *(axis.upper() for axis in axes)),
    )


SCHEMA = _schema(AXES)
_Scale = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]


@dataclass(frozen=True, kw_only=True)
class WrenchReading(Foreign):
    """How to read forces and torques from a CSV file outside a run. The scales apply to a run too.

    `gain` (6,) has the ratios of reading to load, from a calibration; a run has its own.
    """

    units: Units | None = None
    counts_per_n: float | None = None
    counts_per_nm: float | None = None
    gain: tuple[float, ...] | None = None


@dataclass(frozen=True, kw_only=True)
class WrenchRecord:
    """Forces (n, 3) and torques (n, 3) at times (n,) from the first sample on; times may repeat.

    `status` (n,) are the box's status words, None where the file has none; `lost` is the number of missing samples,
    None where unknown. `begin_s` is the first sample's time by the file's own clock, None where it has none. A device
    with fewer `axes` has nan in the others.
    """

    path: Path
    source: Source
    label: Label
    time_s: Array
    force_n: Array
    torque_nm: Array
    status: Words | None
    findings: tuple[Finding, ...]
    lost: int | None = None
    run: str | None = None
    begin_s: float | None = None
    axes: tuple[str, ...] = AXES

    @property
    def name(self) -> str:
        """The run's name, or the file's."""
        return self.run or self.path.stem

    @property
    def main_axis(self) -> str:
        """Fz, or the first axis of a load cell without it."""
        return "Fz" if "Fz" in self.axes else self.axes[0]

    def values_of(self, axis: str) -> Array:
        """Return the values (n,) of an axis, in N or N m."""
        place = AXES.index(axis)
        return self.force_n[:, place] if place < 3 else self.torque_nm[:, place - 3]

    def require(self, *axes: str, purpose: str) -> None:
        """Raise DataError where an axis that a purpose needs was not measured."""
        missing = [axis for axis in axes if axis not in self.axes]
        if missing:
            raise DataError(
                f"{self.name}: the load cell measured {', '.join(self.axes)} alone, and {purpose} needs "
                f"{', '.join(missing)}."
            )

    @property
    def notes(self) -> tuple[str, ...]:
        """What the record's reader noted, in sentences that name the run or the file."""
        return texts(self.findings, "warning")


class _Facts(Facts):
    """The further keys in run.toml of a load cell."""

    counts_per_n: _Scale | None = None
    counts_per_nm: _Scale | None = None
    units: Units = "counts"  # forces that were imported are in N and N m
    settings: Mapping[str, Any] = Field(default_factory=dict)

    @property
    def family(self) -> Family:
        return family_of(str(self.settings.get("product")))


def read_wrench(path: Path, reading: WrenchReading) -> WrenchRecord:
    """Read a run folder's load cell, or a CSV file outside a run.

    Raises DataError with file, line and next step; ConfigError when options contradict the file.
    """
    run = run_at(path)
    if run is None:
        return _read(path, reading, Label(), family=_THESIS_FAMILY)
    file, record = run.device_file(LOADCELL), run.header.devices[LOADCELL]
    facts = facts_of(run, LOADCELL, _Facts)
    counted = facts.units == "counts"
    own = WrenchReading(
        time_unit="s",
        units=facts.units,
        counts_per_n=_scale(run, "counts_per_n", reading.counts_per_n, facts.counts_per_n) if counted else None,
        counts_per_nm=_scale(run, "counts_per_nm", reading.counts_per_nm, facts.counts_per_nm) if counted else None,
        gain=run.header.rig.loadcell.gain,
    )
    axes = tuple(axis for axis in AXES if axis in record.columns)
    found = _read(file, own, run.header.label, family=facts.family, own=True, axes=axes)
    name = path.resolve().name
    unused = unused_in_run(reading, "gain", *(["counts_per_n", "counts_per_nm"] if counted else []))
    about_run = of_recording(name, [*losses(run, record, len(found.time_s)), *gaps(facts), *unused])
    return replace(found, run=name, findings=about_run + found.findings, lost=record.lost)


def holds_wrench(path: Path, reading: WrenchReading) -> bool:
    """Return whether a CSV file is a load cell's, by its header or else by its number of columns.

    Raises DataError when the file is not a table.
    """
    if reading.columns:
        return len(reading.columns) >= len(AXES) and not any("=" in one for one in reading.columns)
    table = open_table(path, skip_lines=reading.skip_lines)
    if not table.has_head:
        return len([name for name in table.names if name]) == len(AXES) + (reading.rate_hz is None)
    return any(name.fullmatch(column) for name in map(axis_name, AXES) for column in table.names)


def _scale(run: Run, key: str, given: float | None, recorded: float | None) -> float:
    value = recorded if given is None else given
    if value is None:
        raise DataError(f"{run.folder / RUN_FILE}: devices.{LOADCELL}.{key} is missing: give `{key}`.")
    return value


def _read(
    path: Path,
    reading: WrenchReading,
    label: Label,
    *,
    family: Family,
    own: bool = False,
    axes: tuple[str, ...] = AXES,
) -> WrenchRecord:
    refuse_clock(path, reading)
    table = open_table(path, skip_lines=reading.skip_lines, columns=reading.columns)
    reading, scale_notes = _as_stated(table, reading)
    if not reading.columns:
        refuse_other_units(table, axes)
    places = _schema(axes).places(table, named=reading.columns, rate_hz=reading.rate_hz)
    names, time_name = {axis: places[axis] for axis in axes}, places.get(TIME)
    table, values, missing = complete_rows(table, list(places.values()), own=own, timed=TIME in places)
    wrench = values[:, time_name is not None :][:, : len(axes)]
    units = units_of(table, names, reading.units)
    if not own:
        table, values, beyond = possible_rows(table, values, wrench, units)
        wrench, missing = values[:, time_name is not None :][:, : len(axes)], (*missing, *beyond)
    check_values(table, list(names.values()), wrench, units)
    stamped, stamp_notes = None, tuple[str, ...]()
    if own:
        table, values, stamped, stamp_notes = stamped_rows(table, values, STAMP)
    raw = values[:, 0] if stamped is None else stamped.time_s
    time, notes = times_of(table, time_name, raw, unit=reading.time_unit, rate_hz=reading.rate_hz, own=own)
    begin_s = _begin_s(table, time_name, raw[:1], reading)
    wrench = values[:, time_name is not None :][:, : len(axes)]
    scale, assumed = _scales(reading, units.name)
    if axes != AXES:
        shown, wrench = wrench, np.full((len(values), len(AXES)), np.nan)
        wrench[:, [AXES.index(axis) for axis in axes]] = shown
    scale = scale * np.array(reading.gain or np.ones(len(AXES)))
    scale[[AXES.index(axis) for axis in axes]] /= units.factors
    words = status_words(table, values[:, -1]) if _STATUS in places else None
    notes = (*missing, *stamp_notes, *notes, *(() if own or missing else pauses(table, time)))
    notes += converted_note(table, names, units)
    notes += (*scale_notes, *assumed, *(() if words is None else status_notes(table, words, family)))
    notes += line_notes(table)
    wrench /= scale  # in place: it may be larger than the memory
    return WrenchRecord(
        path=path,
        source=Source(str(path), table.sha256),
        label=label,
        time_s=time,
        force_n=wrench[:, :3],
        torque_nm=wrench[:, 3:],
        status=words,
        findings=of_recording(file_name(path, own=own), notes),
        begin_s=begin_s,
        axes=axes,
    )


def _as_stated(table: CsvTable, reading: WrenchReading) -> tuple[WrenchReading, tuple[str, ...]]:
    """Return a reading with what ATI's demo program writes above its columns, where no option states it, and a note.

    Raises ConfigError for a unit or number there that is not read.
    """
    lines = (line.strip(' "').partition(":") for line in table.above.splitlines())
    stated = {key: value.strip(' "') for key, _, value in lines if key in _OF_ATI}
    if not all(f"Counts per Unit {what}" in stated for what in ("Force", "Torque")):
        return reading, ()
    found: dict[str, float] = {}
    for what, option, units in (("Force", "counts_per_n", FORCES_N), ("Torque", "counts_per_nm", TORQUES_NM)):
        if getattr(reading, option) is None:
            factor = si_factor(stated.get(f"{what} Units", ""), units)
            found[option] = _number(table, stated, f"Counts per Unit {what}", option) / (factor or np.nan)
            if factor is None:
                unit = stated.get(f"{what} Units", "")
                raise ConfigError(f"{table.path}: its {what} Units, '{short(unit)}', are not read: give `{option}`.")
    if reading.rate_hz is None and reading.time_unit is None and not reading.columns and _RATE in stated:
        found["rate_hz"] = _number(table, stated, _RATE, "rate_hz")
    listed = ", ".join(f"`{option}` {value:.6g}" for option, value in found.items())
    notes = (f"above its columns the file states {listed}.",) if found else ()
    stated_reading = replace(
        reading,
        counts_per_n=found.get("counts_per_n", reading.counts_per_n),
        counts_per_nm=found.get("counts_per_nm", reading.counts_per_nm),
        rate_hz=found.get("rate_hz", reading.rate_hz),
    )
    return stated_reading, notes


def _number(table: CsvTable, stated: Mapping[str, str], key: str, option: str) -> float:
    if not (is_finite(stated[key]) and float(stated[key]) > 0):
        raise ConfigError(f"{table.path}: its {key}, '{short(stated[key])}', is no number above zero: give `{option}`.")
    return float(stated[key])


def _begin_s(table: CsvTable, column: str | None, first: Array, reading: WrenchReading) -> float | None:
    return None if column is None else float(seconds_of(table, column, first, unit=reading.time_unit)[0])


def _scales(reading: WrenchReading, units: Units) -> tuple[Array, tuple[str, ...]]:
    """Return the divisors (6,) to N and N m, and a note where they are assumed."""
    scales = {"`counts_per_n`": reading.counts_per_n, "`counts_per_nm`": reading.counts_per_nm}
    given = [name for name, value in scales.items() if value is not None]
    if units == "n,nm":
        if given:
            raise ConfigError(f"{' and '.join(given)}: the file is in N and Nm, not in counts.")
        return np.ones(len(AXES)), ()
    for name in given:
        if not 0 < (scales[name] or 0.0) < np.inf:
            raise ConfigError(f"{name} {scales[name]:g}: has to be above zero.")
    scale = np.repeat([USUAL_COUNTS if value is None else value for value in scales.values()], 3)
    taken = " ".join(f"{name} {USUAL_COUNTS:.0f}" for name in scales if name not in given)
    return scale, (f"counts are read as {taken}.",) if taken else ()
