"""Samples of a load cell that no force makes: single ones that stand off alone, and stretches that repeat one."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.findings import of_recording
from cfid.large import chosen_rows, parts
from cfid.records.tables.lone import Array, spikes_in
from cfid.records.tables.wrench import WrenchRecord

Mask = npt.NDArray[np.bool_]

_HUNG = 10  # samples that are alike in every axis, which noise makes of none
_SLOW_SHARE = 0.5  # of the samples that are alike: more show a load cell that is slower than its rows


def without_faults(record: WrenchRecord) -> WrenchRecord:
    """Return a record without single samples that stand off alone in an axis by a fifth of all that it shows.

    Samples that repeat the one before are counted in a note: without them a sine would have a gap.
    """
    axes = (*record.force_n.T, *record.torque_nm.T)
    lone, hung = np.zeros(len(record.time_s), bool), _hung(axes)
    for value in axes:
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
    kept = ~lone
    return replace(
        record,
        time_s=chosen_rows(record.time_s, kept),
        force_n=chosen_rows(record.force_n, kept),
        torque_nm=chosen_rows(record.torque_nm, kept),
        status=None if record.status is None else record.status[kept],
        findings=(*record.findings, *of_recording(record.name, texts)),
    )


def _hung(axes: Sequence[Array]) -> Mask:
    """Return the samples (n,) that repeat the one before in every axis that there is, many in a row."""
    alike = np.zeros(len(axes[0]), bool)
    for part in parts(len(alike) - 1):
        rows = slice(part.start, part.stop + 1)
        each = [(np.diff(value[rows]) == 0) | np.isnan(value[part]) for value in axes]
        alike[part.start + 1 : part.stop + 1] = np.all(each, axis=0)
    if np.mean(alike) > _SLOW_SHARE:
        return np.zeros_like(alike)
    changes = np.flatnonzero(np.diff(alike, prepend=False, append=False))
    for begin, end in zip(changes[::2], changes[1::2], strict=True):
        alike[begin:end] = end - begin >= _HUNG
    return alike


def _counted(record: WrenchRecord, chosen: Mask) -> str:
    return f"{counted(int(np.count_nonzero(chosen)), 'sample')} of {len(record.time_s)}"


def _first_s(record: WrenchRecord, chosen: Mask) -> float:
    return float(record.time_s[int(np.argmax(chosen))])
