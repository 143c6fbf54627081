"""Single samples of a load cell that stand off alone: faults of the wire, which no force makes."""

from dataclasses import replace

import numpy as np

from cfid.counted import counted
from cfid.findings import of_recording
from cfid.records.tables.lone import MOST_SHARE, lone_readings, usual_bend
from cfid.records.tables.wrench import WrenchRecord

# A spike: of all that an axis shows, and times the bend that this share of its samples does not exceed.
_SPIKE, _SPIKE_TIMES, _USUAL = 0.2, 8.0, 0.99


def without_spikes(record: WrenchRecord) -> WrenchRecord:
    """Return a record without single samples that stand off alone in an axis by a fifth of all that it shows."""
    lone = np.zeros(len(record.time_s), bool)
    for value in (*record.force_n.T, *record.torque_nm.T):
        limit = max(_SPIKE * float(np.ptp(value)), _SPIKE_TIMES * usual_bend(value, _USUAL))
        places = lone_readings(value, limit) if limit > 0 else ()
        if 0 < len(places) <= MOST_SHARE * len(lone):
            lone[places] = True
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
