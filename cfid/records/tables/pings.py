"""Read round trips to the vehicle from a run folder or any CSV file."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cfid.errors import DataError
from cfid.findings import Finding, of_recording
from cfid.records.parameters import Source
from cfid.records.run import losses, run_at
from cfid.records.tables.blocks import open_table
from cfid.records.tables.column_units import SECONDS, column_name, unit_of
from cfid.records.tables.few_rows import without_few
from cfid.records.tables.schema import Column, TableSchema
from cfid.records.tables.table import Array, CsvTable
from cfid.records.tables.times import TIME_COLUMN, VEHICLE_CLOCK, known_rows, line_notes, vehicle_us
from cfid.records.tables.wrong_times import wrong_times

PINGS = "pings"

_RTT = Column(
    "rtt_s",
    column_name(r"rtt|round[ _-]?trip(?:[ _-]?time)?|latency|ping", tuple(SECONDS)),
    "of round trips (rtt_s, rtt_ms)",
)
_SENT = TIME_COLUMN._replace(optional=True)
SCHEMA = TableSchema(
    columns=(_RTT, _SENT, VEHICLE_CLOCK),
    hint="It should hold round trips, one a row.",
)
_SHORTEST_S, _LONGEST_S = 3e-4, 0.3  # of usual round trips; values are usual in one unit only
_LATEST_S = 60.0  # by when an answer comes, if at all
_SLOWEST_S = 20.0  # from one ping to the next


@dataclass(frozen=True, kw_only=True)
class PingRecord:
    """Round-trip times (n,) in seconds; the host's times of sending and the vehicle's of answering, where known.

    `circumstances` is the operator's note.
    """

    path: Path
    source: Source
    rtt_s: Array
    sent_s: Array | None
    vehicle_us: Array | None
    circumstances: str
    findings: tuple[Finding, ...]

    @property
    def name(self) -> str:
        """The run's name, or the file's."""
        return self.path.stem


def read_pings(path: Path) -> PingRecord:
    """Read a run of `cfid log ping`, or a CSV file with a column rtt_s, and t and vehicle_us if it has them.

    Other names and units are read too; a unit that the name does not state is the one that gives usual round trips.
    From a file outside a run, the few rows without a number or with an impossible round trip are left out.
    Raises DataError with file, line and next step.
    """
    run = run_at(path)
    file = path if run is None else run.device_file(PINGS)
    table = open_table(file)
    places = SCHEMA.places(table)
    names, left_out = list(places.values()), tuple[str, ...]()
    if run is None:
        table, values, left_out = known_rows(table, names, timed=False)
    else:
        values = table.numbers(names)
    place = list(places).index(_RTT.key)
    shown = values[:, place].copy()
    values[:, place], notes = _seconds(table, _RTT, places[_RTT.key], shown, usual_s=(_SHORTEST_S, _LONGEST_S))
    if run is None:
        possible = (values[:, place] > 0) & (values[:, place] < _LATEST_S)
        table, values, impossible = without_few(table, values, ~possible, shown, "no round trip takes")
        left_out = (*left_out, *impossible)
        if VEHICLE_CLOCK.key in places:
            stamps = values[:, list(places).index(VEHICLE_CLOCK.key)]
            off = np.isin(np.arange(len(stamps)), wrong_times(stamps))
            table, values, lone = without_few(table, values, off, stamps, "is off the vehicle's clock")
            left_out = (*left_out, *lone)
    columns = dict(zip(places, values.T, strict=True))
    rtt_s = columns[_RTT.key]
    wrong = np.flatnonzero(rtt_s <= 0)
    if len(wrong):
        raise DataError(
            f"{file}:{table.line_of_row(int(wrong[0]))}: a round trip takes more than zero seconds. Delete that line."
        )
    sent_s = None
    if _SENT.key in places:
        sent_s, of_times = _seconds(table, _SENT, places[_SENT.key], columns[_SENT.key], usual_s=(0.0, _SLOWEST_S))
        notes += of_times
    notes += (*left_out, *line_notes(table))
    notes += () if run is None else tuple(one.sentence for one in losses(run, run.header.devices[PINGS], len(rtt_s)))
    return PingRecord(
        path=path,
        source=Source(str(file), table.sha256),
        rtt_s=rtt_s,
        sent_s=sent_s,
        vehicle_us=vehicle_us(table, places, columns),
        circumstances="" if run is None else run.header.label.note or "",
        findings=of_recording(path.name, notes),
    )


def _seconds(
    table: CsvTable, column: Column, name: str, values: Array, *, usual_s: tuple[float, float]
) -> tuple[Array, tuple[str, ...]]:
    """Return a column's values (n,) in seconds, and a note where their size decided the unit.

    `usual_s` are the smallest and the largest usual value, or step of a time.
    """
    stated = unit_of(table, column.called, name, None, "")
    if stated is not None:
        return values * SECONDS[stated], ()
    size = float(np.median(np.diff(values) if column is _SENT and len(values) > 1 else values))
    unit = next((unit for unit, scale in SECONDS.items() if usual_s[0] <= size * scale <= usual_s[1]), "s")
    text = f"column '{name}' is read in {unit}, by its size: write the unit into its name, as in {name}_ms."
    return values * SECONDS[unit], (text,) if unit != "s" else ()
