"""Read round trips to the vehicle from a run folder or any CSV file."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cfid.errors import DataError
from cfid.findings import Finding, of_recording
from cfid.records.parameters import Source
from cfid.records.tables.schema import TIME, Column, TableSchema
from cfid.records.tables.table import Array, open_table
from cfid.records.tables.times import CUT_LINE, losses, run_at

PINGS = "pings"

_RTT, _VEHICLE = "rtt_s", "vehicle_us"
SCHEMA = TableSchema(
    columns=(Column.named(_RTT), Column.named(TIME, optional=True), Column.named(_VEHICLE, optional=True)),
    hint="It should hold round trips in seconds.",
)


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

    Raises DataError with file, line and next step.
    """
    run = run_at(path)
    file = path if run is None else run.device_file(PINGS)
    table = open_table(file)
    places = SCHEMA.places(table)
    columns = dict(zip(places, table.numbers(list(places.values())).T, strict=True))
    wrong = np.flatnonzero(columns[_RTT] <= 0)
    if len(wrong):
        raise DataError(
            f"{file}:{table.line_of_row(int(wrong[0]))}: a round trip takes more than zero seconds. Delete that line."
        )
    notes = [CUT_LINE] if table.cut else []
    notes += [] if run is None else losses(run, run.header.devices[PINGS], len(columns[_RTT]))
    return PingRecord(
        path=path,
        source=Source(str(file), table.sha256),
        rtt_s=columns[_RTT],
        sent_s=columns.get(TIME),
        vehicle_us=columns.get(_VEHICLE),
        circumstances="" if run is None else run.header.label.note or "",
        findings=of_recording(path.name, notes),
    )
