"""For how long a busy computer kept a test from what it waits for: taken off before a time is compared with a bound."""

import hashlib
import time

_SLEEP_S = 0.005
_WORK = bytes(1 << 19)  # a millisecond, without Python's lock


def kept_waiting_s() -> float:
    """Sleep a little and work a little; return by how much that took longer than on a computer with time to spare."""
    began_s, worked_s = time.monotonic(), time.thread_time()
    time.sleep(_SLEEP_S)
    hashlib.sha256(_WORK).digest()
    needed_s = _SLEEP_S + time.thread_time() - worked_s
    return max(time.monotonic() - began_s - needed_s, 0.0)
