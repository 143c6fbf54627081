"""What runs against a clock runs before what only computes, where the system grants it (an administrator's tests).

A rig's wires do not wait: a simulated load cell that three other tests keep from the processor is a broken load cell.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

_AHEAD = -10  # as `nice` counts: nine times the share of what computes


@contextmanager
def ahead_of_others() -> Iterator[None]:
    """Run before other programs, and so does all that is started in between."""
    usual = os.getpriority(os.PRIO_PROCESS, 0)
    run_at(_AHEAD)
    try:
        yield
    finally:
        run_at(usual)


def run_at(priority: int) -> None:
    """Take a priority where the system grants it."""
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, priority)


def run_devices(loop: Any) -> None:
    """Run a loop of devices in its thread, which as real ones wait for no processor, where the system grants it.

    cfid's own loop runs ahead of programs that compute: beside it, a device that waits would lose polls.
    """
    with suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    loop.run(installSignalHandlers=False)
