"""Find samples of a load cell that no force makes: off alone, far beyond the others, or repeating one value."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.findings import of_recording
from cfid.large import chosen_rows, parts
from cfid.records.tables.lone import Array, far_in, spikes_in
from cfid.records.tables.repeated import repeated
from cfid.records.tables.wrench import WrenchRecord

Mask = npt.NDArray[np.bool_]

_HUNG = 10  # equal samples in a row in every axis, which noise never gives
_SLOW_SHARE = 0.5  # of the samples may be equal; more show a load cell that is slower than its rows


def without_faults(record: WrenchRecord) -> WrenchRecord:
    """Return a record without samples that, in an axis, are off alone by a fifth of its range, or far beyond others.

    Samples that repeat the one before stay and are counted in a note: without them a sine would have a gap.
    """
    axes = (*record.force_n.T, *record.torque_nm.T)
    lone, far, hung = np.zeros(len(record.time_s), bool), np.zeros(len(record.time_s), bool), _hung(axes)
    for value in axes:
        lone[spikes_in(value)] = True
        far[far_in(value)] = True
    far &= ~lone
    texts = [
        f"{_counted(record, wrong)} {what} left out (first at {_first_s(record, wrong):.4g} s)."
        for wrong, what in ((lone, "off alone"), (far, "far beyond the others"))
        if wrong.any()
    ]
    if hung.any():
        texts.append(
            f"{_counted(record, hung)} repeat the one before, {_HUNG} and more in a row (first at "
            f"{_first_s(record, hung):.4g} s): the load cell hung. Record the sines of that time again."
        )
    return _without(record, lone | far, texts)


def without_stuck(record: WrenchRecord) -> WrenchRecord:
    """Return a record without the samples at which an axis repeats one value for long, with a note."""
    stuck = {axis: repeated(record.time_s, record.values_of(axis)) for axis in record.axes}
    texts = [
        f"{axis} repeats one value in {_counted(record, wrong)} (first at {_first_s(record, wrong):.4g} s), which are "
        "left out: the load cell's wire, or its reading, failed."
        for axis, wrong in stuck.items()
        if wrong.any()
    ]
    return _without(record, np.any(list(stuck.values()), axis=0), texts)


def _without(record: WrenchRecord, wrong: Mask, texts: Sequence[str]) -> WrenchRecord:
    """Return a record without the samples that are `wrong` (n,), with notes."""
    if not texts:
        return record
    return replace(
        record,
        time_s=chosen_rows(record.time_s, ~wrong),
        force_n=chosen_rows(record.force_n, ~wrong),
        torque_nm=chosen_rows(record.torque_nm, ~wrong),
        status=None if record.status is None else record.status[~wrong],
        findings=(*record.findings, *of_recording(record.name, texts)),
    )


def _hung(axes: Sequence[Array]) -> Mask:
    """Return the samples (n,) that repeat the one before in every measured axis, many in a row."""
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
