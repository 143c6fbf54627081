"""Which part of a recording is the swing to fit: what --peaks, --min-angle-deg, --from and --to ask for."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from cfid.console.options import CutOptions, WindowOptions
from cfid.errors import ConfigError, DataError

if TYPE_CHECKING:
    from cfid.records.tables.angle import AngleRecord
    from cfid.swing.free_swing import FreeSwing


def find(
    record: "AngleRecord", window: WindowOptions, *, axis: str | None, cut: CutOptions | None = None
) -> "FreeSwing":
    """Find the free swing of a recording within the window asked for.

    Raises DataError that names the file.
    """
    from cfid.swing.free_swing import find_swing

    cut = cut or CutOptions()
    smallest = {} if window.min_angle_deg is None else {"smallest_peak_rad": math.radians(window.min_angle_deg)}
    try:
        return find_swing(
            record.time_s,
            record.angle_rad,
            peaks=peaks_of(window.peaks, axis),
            from_s=cut.from_s,
            to_s=cut.to_s,
            **smallest,
        )
    except DataError as error:
        raise DataError(f"{record.path}: {error}") from None


def peaks_of(text: str | None, axis: str | None) -> int | None:
    """Return the number of peaks that --peaks asks for on an axis: one number, or `x=11,z=16`.

    Raises ConfigError when it is neither, or below four.
    """
    by_axis = _by_axis(text)
    return by_axis.get(None, by_axis.get(axis))


def check_peaks(text: str | None, axes: Sequence[str]) -> None:
    """Check that every axis that --peaks names is one that swings.

    Raises ConfigError naming the one that is not.
    """
    for axis in _by_axis(text):
        if axis is not None and axis not in axes:
            raise ConfigError(
                f"--peaks {text}: no swing is about '{axis}', but about {', '.join(axes) or 'an axis not named'}."
            )


def _by_axis(text: str | None) -> dict[str | None, int]:
    """Parse --peaks; a single number holds for all axes and has None as its key."""
    from cfid.swing.free_swing import FEWEST_PEAKS

    if text is None:
        return {}
    try:
        if "=" not in text:
            counts: dict[str | None, int] = {None: int(text)}
        else:
            pairs = (part.split("=") for part in text.split(","))
            counts = {axis.strip(): int(count) for axis, count in pairs}
    except ValueError:
        raise ConfigError(f"--peaks {text}: expected a number, or AXIS=NUMBER,AXIS=NUMBER,...") from None
    if min(counts.values()) < FEWEST_PEAKS:
        raise ConfigError(f"--peaks {text}: a fit needs {FEWEST_PEAKS} peaks at least, the release being the first.")
    return counts
