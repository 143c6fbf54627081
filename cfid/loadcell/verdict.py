"""Judges a recording of the load cell as soon as it ends: its noise, its drift, and whether an axis hung."""

import numpy as np

from cfid.counted import counted
from cfid.errors import DataError
from cfid.recordings.outliers import stuck
from cfid.recordings.read import read_recording
from cfid.recordings.wrench import WrenchRecord, wrench_of
from cfid.records.run import Run

_FEWEST = 100
_MOST_STUCK = 0.1  # of the samples: less is a note
_NOISE = 1.5  # usual change of samples in steps: above it, one value for long is no coincidence


def verdict(run: Run) -> str:
    """Return the mean, the noise and the drift of the vertical force, or else of the first axis.

    Raises DataError for few samples, a force that never changes, and an axis that hangs for a tenth of the samples.
    """
    record = wrench_of(read_recording(run.folder))
    axis, shown = record.main_axis, 1e3 * record.values_of(record.main_axis)
    if len(shown) < _FEWEST:
        raise DataError(f"{counted(len(shown), 'sample is', 'samples are')} too few (at least {_FEWEST}).")
    if not np.ptp(shown):
        raise DataError(f"{axis} is {shown[0]:.6g} in all {len(shown)} samples: press on the cell and see it change.")
    hung = [axis_hung for axis in record.axes if (axis_hung := _hung(record, axis))]
    if any(share > _MOST_STUCK for share, _ in hung):
        raise DataError(" ".join(text for _, text in hung))
    tenth, unit = len(shown) // 10, "mN" if axis.startswith("F") else "mNm"
    drift = float(shown[-tenth:].mean() - shown[:tenth].mean())
    noise = float(np.diff(shown).std() / np.sqrt(2))
    return (
        f"{axis} {shown.mean():.1f} {unit}, noise {noise:.2g} {unit} from sample to sample, "
        f"{drift:+.2g} {unit} from the first tenth to the last.{''.join(f' {text}' for _, text in hung)}"
    )


def _hung(record: WrenchRecord, axis: str) -> tuple[float, str] | None:
    """Return the share of samples that repeat one value, while others always change, and a sentence on them."""
    value = record.values_of(axis)
    change, wrong = np.abs(np.diff(value)), stuck(value, record.time_s)
    if not wrong.any() or np.median(change[~wrong[1:]]) < _NOISE * change[change > 0].min():
        return None
    first, unit = int(np.argmax(wrong)), "mN" if axis.startswith("F") else "mNm"
    text = (
        f"{axis} repeats one value in {counted(int(np.count_nonzero(wrong)), 'sample')} of {len(value)}, as "
        f"{1e3 * value[first]:.6g} {unit} from {record.time_s[first]:.4g} s on: the load cell hung. Check its wires "
        "and its amplifier."
    )
    return float(np.mean(wrong)), text
