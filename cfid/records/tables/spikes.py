"""Single samples of a load cell that stand off alone: faults of the wire, which no force makes."""

from dataclasses import replace

import numpy as np

from cfid.counted import counted
from cfid.findings import of_recording
from cfid.records.tables.lone import spikes_in
from cfid.records.tables.wrench import WrenchRecord


def without_spikes(record: WrenchRecord) -> WrenchRecord:
    """Return a record without single samples that stand off alone in an axis by a fifth of all that it shows."""
    lone = np.zeros(len(record.time_s), bool)
    for value in (*record.force_n.T, *record.torque_nm.T):
        lone[spikes_in(value)] = True
    if not lone.any():
        return record
    kept, count = ~lone, int(np.count_nonzero(lone))
    at_s = float(record.time_s[int(np.argmax(lone))])
    text = f"{counted(count, 'sample')} of {len(lone)} off alone left out (first at {at_s:.4g} s)."
    return replace(
        record,
        time_s=record.time_s[kept],
        force_n=record.force_n[kept],
        torque_nm=record.torque_nm[kept],
        status=None if record.status is None else record.status[kept],
        findings=(*record.findings, *of_recording(record.name, (text,))),
    )
