"""Writes the motors' commands to a file for other processes, a line at each change."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cfid.errors import ConfigError
from cfid.sim.propulsion import STILL, Four, OnMotors


@contextmanager
def trace_motors(path: Path | None, *, begin_s: float) -> Iterator[OnMotors]:
    """Yield a function that appends `t m1 m2 m3 m4`, t in s of the monotonic clock; without a path it does nothing.

    The first line has all motors off. Raises ConfigError when the file cannot be written.
    """
    if path is None:
        yield lambda time_s, motors: None
        return
    try:
        file = path.open("a", encoding="utf-8", buffering=1)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}.") from None
    with file:

        def trace(time_s: float, motors: Four) -> None:
            file.write(f"{time_s:.6f} {' '.join(map(str, motors))}\n")

        trace(begin_s, STILL)
        yield trace
