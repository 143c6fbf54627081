"""Run what depends on a clock before what only computes, if the system allows it (for tests of an administrator).

How long a busy computer delayed a test is subtracted before a time is compared with a limit.

A rig's wires do not wait: a simulated load cell that three other tests keep from the processor acts like a broken one.
"""

import hashlib
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

_AHEAD = -10  # a value of `nice`: nine times the share of a program that computes
_SLEEP_S = 0.005
_WORK = bytes(1 << 19)  # takes a millisecond, without Python's lock


@contextmanager
def ahead_of_others() -> Iterator[None]:
    """Run before other programs in this context, together with all programs started in it."""
    usual = os.getpriority(os.PRIO_PROCESS, 0)
    run_at(_AHEAD)
    try:
        yield
    finally:
        run_at(usual)


def run_at(priority: int) -> None:
    """Set the priority of this process, if the system allows it."""
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, priority)


def run_devices(loop: Any) -> None:
    """Run a loop of devices in this thread with real-time priority, if the system allows it.

    Real devices do not wait for a processor. cfid's own loop runs ahead of programs that compute, so a simulated device
    that waited would lose polls.
    """
    with suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    loop.run(installSignalHandlers=False)


def kept_waiting_s() -> float:
    """Sleep and work for a short time; return how much longer this took than on an idle computer."""
    began_s, worked_s = time.monotonic(), time.thread_time()
    time.sleep(_SLEEP_S)
    hashlib.sha256(_WORK).digest()
    needed_s = _SLEEP_S + time.thread_time() - worked_s
    return max(time.monotonic() - began_s - needed_s, 0.0)
