"""Samples of a load cell that no force makes: single ones that stand off alone, and stretches that repeat one."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.findings import of_recording
from cfid.records.tables.lone import spikes_in
from cfid.records.tables.wrench import WrenchRecord

Mask = npt.NDArray[np.bool_]

_HUNG = 10  # samples that are alike in every axis, which noise makes of none
_SLOW_SHARE = 0.5  # of the samples that are alike: more show a load cell that is slower than its rows


def without_faults(record: WrenchRecord) -> WrenchRecord:
    """Return a record without single samples that stand off alone in an axis by a fifth of all that it shows.

    Samples that repeat the one before are counted in a note: without them a sine would have a gap.
    """
    values = np.hstack([record.force_n, record.torque_nm])
    lone, hung = np.zeros(len(values), bool), _hung(values)
    for value in values.T:
        lone[spikes_in(value)] = True
    texts = []
    if lone.any():
        texts.append(f"{_counted(record, lone)} off alone left out (first at {_first_s(record, lone):.4g} s).")
    if hung.any():
        texts.append(
            f"{_counted(record, hung)} repeat the one before, {_HUNG} and more in a row (first at "
            f"{_first_s(record, hung):.4g} s): the load cell hung. Record the sines of that time again."
        )
    if not texts:
        return record
    return replace(
        record,
        time_s=record.time_s[~lone],
        force_n=record.force_n[~lone],
        torque_nm=record.torque_nm[~lone],
        status=None if record.status is None else record.status[~lone],
        findings=(*record.findings, *of_recording(record.name, texts)),
    )


def _hung(values: npt.NDArray[np.float64]) -> Mask:
    """Return the samples (n, axes) that repeat the one before in every axis that there is, many in a row."""
    steps = np.diff(values, axis=0, prepend=np.inf)
    alike: Mask = np.all((steps == 0) | np.isnan(values), axis=1)
    changes = np.flatnonzero(np.diff(alike, prepend=False, append=False))
    if np.mean(alike) > _SLOW_SHARE:
        return np.zeros_like(alike)
    for begin, end in zip(changes[::2], changes[1::2], strict=True):
        alike[begin:end] = end - begin >= _HUNG
    return alike


def _counted(record: WrenchRecord, chosen: Mask) -> str:
    return f"{counted(int(np.count_nonzero(chosen)), 'sample')} of {len(record.time_s)}"


def _first_s(record: WrenchRecord, chosen: Mask) -> float:
    return float(record.time_s[int(np.argmax(chosen))])
