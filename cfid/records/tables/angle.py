"""Read an angle over time, in seconds and radians, from a run folder or any CSV file.

Columns are found by name, units by suffix or option. A unit that cannot be determined is an error that asks for the
option, never a guess; time and counts are checked before use.
"""

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, note, of_recording, rejection, texts
from cfid.large import usual_step
from cfid.records.files import RUN_FILE
from cfid.records.parameters import Source
from cfid.records.rig_file import STAMP
from cfid.records.run import Facts, Label, Run, facts_of, file_name, gaps, losses, run_at
from cfid.records.tables.blocks import open_table
from cfid.records.tables.column_units import column_name, unit_of
from cfid.records.tables.counts import CountsPerTurn, continuous_angle, is_angle
from cfid.records.tables.few_rows import without_few
from cfid.records.tables.gyro import Rates, gyro_device, read_gyro
from cfid.records.tables.schema import TIME, Column, Foreign, TableSchema, refuse_clock, unused_in_run
from cfid.records.tables.stamps import stamped_rows
from cfid.records.tables.table import Array, CsvTable
from cfid.records.tables.times import TIME_COLUMN, complete_rows, line_notes, pauses, times_of
from cfid.wire.rls import RLS_13BIT_IN_22

AngleUnit = Literal["counts", "rad", "deg"]

ENCODER = "encoder"
_UNDECIDED = "the log does not show whether they run at 84/85 of real time"  # of an import by version 0.2
_CLOCK_UNDECIDED = rejection(
    "gyro-clock-undecided",
    f"{_UNDECIDED}, which would make an inertia 2.4 % wrong. Import it again with `clock` 84/85 or true.",
    *("swing.*", "inertia.*", "friction.*"),
)

_ANGLE = Column(
    "angle",
    column_name(
        r"(?:phi|angle|theta|alpha|winkel|auslenkung|[φϕθϑα]|pos|position|enc|encoder(?:[ _]angle)?)_?\d?",
        ("rad", "deg", "counts"),
    ),
    "of angle (phi, angle, theta)",
)
_OTHER_UNIT = re.compile(r"[ _/,\[(]+(gon|grads?|mrad|arcmin|arcsec|turns?|revs?|revolutions?)[\])_]?$", re.IGNORECASE)
SCHEMA = TableSchema(
    columns=(TIME_COLUMN, _ANGLE),
    words=("TIME", "ANGLE"),
    hint=(
        "A log of a swing by a vehicle's gyro, gyro.x to gyro.z, becomes a run by `cfid import` with its `axis`, and "
        "fits take that."
    ),
)


@dataclass(frozen=True, kw_only=True)
class Reading(Foreign):
    """How to read an angle from a CSV file outside a run; counts without `counts_per_turn` are read with the rig's."""

    angle_unit: AngleUnit | None = None
    counts_per_turn: CountsPerTurn | None = None
    rig_counts_per_turn: CountsPerTurn | None = None


class _EncoderFacts(Facts):
    """The further keys in run.toml of an encoder; an angle that was imported is in radians."""

    angle_unit: AngleUnit = "counts"


@dataclass(frozen=True, kw_only=True)
class AngleRecord:
    """An angle (n,), continuous over turns, at increasing times (n,) since the first sample.

    `begin_s` is the first sample's Unix time in a run, `time_scale_std` the relative standard uncertainty of intervals
    beyond that of this computer's clock. A gyro's angle is the integral of its `rates`, which fits use.
    """

    path: Path
    source: Source
    label: Label
    time_s: Array
    angle_rad: Array
    findings: tuple[Finding, ...]
    run: str | None = None
    begin_s: float = 0.0
    time_scale_std: float = 0.0
    rates: Rates | None = None

    @property
    def name(self) -> str:
        """The run's name, or the file's."""
        return self.run or self.path.stem

    @property
    def notes(self) -> tuple[str, ...]:
        """What the record's reader noted, in sentences that name the run or the file."""
        return texts(self.findings, "warning")


def read_angle(path: Path, reading: Reading) -> AngleRecord:
    """Read a run folder's encoder, its vehicle's gyro where it has no encoder, or a CSV file outside a run.

    Raises DataError with file, line and next step; ConfigError when options contradict the file.
    """
    run = run_at(path)
    if run is None:
        return _read(path, reading, Label())[0]
    if ENCODER not in run.header.devices and (device := gyro_device(run)) is not None:
        return _of_gyro(run, device)
    file, record = run.device_file(ENCODER), run.header.devices[ENCODER]
    if len(record.columns) < 2:
        raise DataError(f"{path / RUN_FILE}: devices.{ENCODER}.columns: has no time and angle.")
    facts = facts_of(run, ENCODER, _EncoderFacts)
    counted = facts.angle_unit == "counts"
    own = Reading(
        time_unit="s",
        angle_unit=facts.angle_unit,
        counts_per_turn=(reading.counts_per_turn or record.counts_per_turn) if counted else None,
        columns=record.columns[:2],
    )
    found, rows = _read(file, own, run.header.label, own=True)
    unused = unused_in_run(reading, "rig_counts_per_turn", *(["counts_per_turn"] if counted else []))
    name = path.resolve().name
    about_run = of_recording(name, [*losses(run, record, rows), *gaps(facts), *unused])
    return replace(found, run=name, findings=about_run + found.findings)


def _of_gyro(run: Run, device: str) -> AngleRecord:
    """Return the integral of a run's gyro rates as an angle about the axis of their rotation."""
    found, record = read_gyro(run, device), run.header.devices[device]
    name = run.folder.resolve().name
    x, y, z = found.rates.axis
    axis = note("gyro-axis", f"the gyro turned about ({x:+.3f}, {y:+.3f}, {z:+.3f}) of the body frame.").at(name)
    origin = run.header.origin
    clock = (_CLOCK_UNDECIDED.at(name),) if origin is not None and origin.clock == "unknown" else ()
    return AngleRecord(
        path=Path(found.rows.source.path),
        source=found.rows.source,
        label=run.header.label,
        time_s=found.time_s,
        angle_rad=found.angle_rad,
        findings=(*of_recording(name, losses(run, record, len(found.time_s))), *found.rows.findings, axis, *clock),
        run=name,
        begin_s=float(found.rows.time_s[0]),
        time_scale_std=found.time_scale_std,
        rates=found.rates,
    )


Recording = AngleRecord | Run | Path | str


def angle_record(recording: Recording) -> AngleRecord:
    """Return a record as it is, else read the encoder of a run or the angle of a file. Raises as `read_angle`."""
    if isinstance(recording, AngleRecord):
        return recording
    return read_angle(recording.folder if isinstance(recording, Run) else Path(recording), Reading())


def labelled(record: AngleRecord, **label: object) -> AngleRecord:
    """Return a record with an `axis`, `weight_g`, `weight_std_g` or `body` in its label.

    Raises ConfigError where the record's own label has another value.
    """
    own = record.label.model_dump()
    for key, value in label.items():
        if value is not None and own[key] not in (None, value):
            raise ConfigError(
                f"{record.name}: {key} {_shown(value)} contradicts the run's own label, {key} {_shown(own[key])}. "
                "Leave it out, or correct the label in run.toml."
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


def _read(path: Path, reading: Reading, label: Label, *, own: bool = False) -> tuple[AngleRecord, int]:
    """Return a file's record, and its number of rows."""
    refuse_clock(path, reading)
    table = open_table(path, skip_lines=reading.skip_lines, columns=reading.columns)
    places = SCHEMA.places(table, named=reading.columns, rate_hz=reading.rate_hz)
    time_name, angle_name = places.get(TIME), places[_ANGLE.key]
    table, values, gaps_notes = complete_rows(table, list(places.values()), own=own, timed=TIME in places)
    if not own:
        table, values, beyond = without_few(table, values, ~is_angle(values[:, -1]), values[:, -1], "is not an angle")
        gaps_notes = (*gaps_notes, *beyond)
    rows, stamped, stamp_notes = len(values), None, tuple[str, ...]()
    if own:
        table, values, stamped, stamp_notes = stamped_rows(table, values, STAMP)
    raw = values[:, 0] if stamped is None else stamped.time_s
    time, notes = times_of(table, time_name, raw, unit=reading.time_unit, rate_hz=reading.rate_hz, own=own)
    unit = _unit_of_angle(table, angle_name, reading.angle_unit)
    angle = continuous_angle(
        table,
        angle_name,
        values[:, -1],
        unit=unit,
        counts_per_turn=reading.counts_per_turn,
        rig_counts_per_turn=reading.rig_counts_per_turn,
    )
    notes = (
        *gaps_notes,
        *stamp_notes,
        *notes,
        *(() if own or gaps_notes else pauses(table, time)),
        *angle.notes,
        *line_notes(table),
    )
    low, high = (math.degrees(extreme) for extreme in (angle.angle_rad.min(), angle.angle_rad.max()))
    understood = (
        f"{len(values)} rows {1e3 * usual_step(time):.4g} ms apart, angle from column '{angle_name}', from "
        f"{low:.1f} to {high:.1f} degrees{table.layout}."
    )
    time = time if angle.rows is None else time[angle.rows]
    begin_s = float(raw[0] + time[0]) if own else 0.0
    np.subtract(time, float(time[0]), out=time)
    read = () if own else (note("file-read", understood).at(path.name),)
    record = AngleRecord(
        path=path,
        source=Source(str(path), table.sha256),
        label=label,
        time_s=time,
        angle_rad=angle.angle_rad,
        findings=(*read, *of_recording(file_name(path, own=own), notes)),
        begin_s=begin_s,
        time_scale_std=0.0 if stamped is None else stamped.scale_std,
    )
    return record, rows


def _unit_of_angle(table: CsvTable, column: str, given: AngleUnit | None) -> str | None:
    """Return the unit of an angle as `unit_of`. Raises ConfigError where its name states a unit that is not read."""
    name = table.names[table.place(column)]
    if given is None and (other := _OTHER_UNIT.search(name)) is not None:
        raise ConfigError(
            f"{table.path}: column '{name}' is in '{other[1]}'; angles are read in rad, deg or counts. Convert "
            "them, or give `angle_unit` where the name is wrong."
        )
    return unit_of(table, _ANGLE.called, column, given, "angle_unit")
