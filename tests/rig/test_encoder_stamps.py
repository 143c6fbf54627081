"""The encoder's own stamps compared with the host's clock: unwrapped, and accepted only if they count microseconds."""

import numpy as np
import pytest

from cfid.rig.e201_stamps import Stamps

HZ = 1000
BLOCK = 50
BEGAN_S = 5000.0  # on the host's clock


def blocks(stamps: Stamps, taken_s: np.ndarray, came_s: np.ndarray, *, ticks_per_s: float = 1e6) -> np.ndarray:
    """Pass positions on in blocks of 50 ms; return which ones were found late."""
    late = []
    for begin in range(0, len(taken_s), BLOCK):
        part = slice(begin, begin + BLOCK)
        counts = (taken_s[part] * ticks_per_s).astype(np.int64) % 2**32
        late.append(stamps.late(stamps.unwrapped(counts.tolist()), came_s[part]))
    return np.concatenate(late)


def seconds(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return times at which positions are taken, on a device 100 ppm fast, and at which they come, 1 to 4 ms later."""
    taken_s = np.arange(count) / HZ
    return taken_s * (1 + 1e-4), BEGAN_S + taken_s + np.random.default_rng(1).uniform(1e-3, 4e-3, count)


def test_sound_stamps_make_nothing_late() -> None:
    assert not blocks(Stamps(), *seconds(60 * HZ)).any()


def test_an_answer_that_waited_longer_than_50_ms_is_late() -> None:
    taken_s, came_s = seconds(10 * HZ)
    old = np.arange(5 * HZ, 10 * HZ, 777)
    taken_s[old] -= np.linspace(0.06, 0.5, len(old))

    late = blocks(Stamps(), taken_s, came_s)

    assert np.flatnonzero(late).tolist() == old.tolist()


def test_an_answer_that_waited_less_is_not() -> None:
    taken_s, came_s = seconds(10 * HZ)
    taken_s[5 * HZ :: 777] -= 0.04

    assert not blocks(Stamps(), taken_s, came_s).any()


@pytest.mark.parametrize("ticks_per_s", [1e3, 1e5, 3e6])
def test_stamps_that_count_something_else_make_nothing_late(ticks_per_s: float) -> None:
    assert not blocks(Stamps(), *seconds(60 * HZ), ticks_per_s=ticks_per_s).any()


def test_a_device_that_counts_anew_loses_a_block_at_most() -> None:
    taken_s, came_s = seconds(20 * HZ)
    taken_s[10 * HZ :] -= taken_s[10 * HZ]

    assert blocks(Stamps(), taken_s, came_s).sum() <= BLOCK
