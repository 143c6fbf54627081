"""Samples of a load cell that no force makes: single ones that stand off alone, and stretches that stand still."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.findings import of_recording
from cfid.records.tables.frozen import frozen_readings
from cfid.records.tables.lone import Array, Rows, spikes_in
from cfid.records.tables.wrench import WrenchRecord

Mask = npt.NDArray[np.bool_]


def without_faults(record: WrenchRecord) -> WrenchRecord:
    """Return a record without single samples that stand off alone in an axis by a fifth of all that it shows.

    Samples in which an axis repeats its value while it moves before and after are counted in a note: without them a
    sine would have a gap.
    """
    lone, still = (_in_an_axis(record, find) for find in (spikes_in, frozen_readings))
    texts = []
    if lone.any():
        texts.append(f"{_counted(record, lone)} off alone left out (first at {_first_s(record, lone):.4g} s).")
    if still.any():
        texts.append(
            f"{_counted(record, still)} repeat the one before while forces move (first at "
            f"{_first_s(record, still):.4g} s): the load cell hung. Record the sines of that time again."
        )
    if not texts:
        return record
    kept = ~lone
    return replace(
        record,
        time_s=record.time_s[kept],
        force_n=record.force_n[kept],
        torque_nm=record.torque_nm[kept],
        status=None if record.status is None else record.status[kept],
        findings=(*record.findings, *of_recording(record.name, texts)),
    )


def _counted(record: WrenchRecord, chosen: Mask) -> str:
    return f"{counted(int(np.count_nonzero(chosen)), 'sample')} of {len(record.time_s)}"


def _first_s(record: WrenchRecord, chosen: Mask) -> float:
    return float(record.time_s[int(np.argmax(chosen))])


def _in_an_axis(record: WrenchRecord, find: Callable[[Array], Rows]) -> Mask:
    """Return the samples (n,) that are found in any axis."""
    found = np.zeros(len(record.time_s), bool)
    for value in (*record.force_n.T, *record.torque_nm.T):
        found[find(value)] = True
    return found
