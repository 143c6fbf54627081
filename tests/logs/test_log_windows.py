"""A log that is read in parts gives every row of every channel once."""

from pathlib import Path

import numpy as np
import pytest

from cfid.errors import DataError
from cfid.records.logs.log import BLOCK_ROWS, Channel, FlightLog, in_memory
from cfid.records.logs.windows import windows
from cfid.records.parameters import Source

COUNT = BLOCK_ROWS + 5000
FAST_S = np.linspace(7.0, 7.0 + (COUNT - 1) * 1e-3, COUNT)
SLOW_S = np.linspace(7.05, 71.95, 650)
LOG = FlightLog(
    path=Path("log"),
    source=Source("log", ""),
    program="",
    clock="",
    series=(
        in_memory("fast", FAST_S, [Channel("a"), Channel("speed", "rpm")], [FAST_S - 7, np.ones(COUNT)]),
        in_memory("slow", SLOW_S, [Channel("volts", "V")], [4 - SLOW_S / 100]),
    ),
)


def test_parts_hold_what_the_log_holds() -> None:
    parts = list(windows(LOG, ["speed", "volts", "a"], from_s=7.0, long_s=10.0))
    assert len(parts) == 8
    for name in ("a", "speed", "volts"):
        time_s, value = LOG.channel(name)
        np.testing.assert_array_equal(np.concatenate([part[name].time_s for part in parts]), time_s)
        np.testing.assert_array_equal(np.concatenate([part[name].value for part in parts]), value)
    for at, part in enumerate(parts):
        for time_s, _ in part.values():
            assert len(time_s) == 0 or 7 + 10 * at <= time_s[0] <= time_s[-1] < 17 + 10 * at


def test_a_channel_that_is_not_there_is_an_error() -> None:
    with pytest.raises(DataError, match="no channel b; it has fast: a, speed; slow: volts"):
        list(windows(LOG, ["b"], from_s=0.0, long_s=10.0))
