"""How long a busy computer delayed a test; this is subtracted before a time is compared with a limit."""

import hashlib
import time

_SLEEP_S = 0.005
_WORK = bytes(1 << 19)  # takes a millisecond, without Python's lock


def kept_waiting_s() -> float:
    """Sleep and work for a short time; return how much longer this took than on an idle computer."""
    began_s, worked_s = time.monotonic(), time.thread_time()
    time.sleep(_SLEEP_S)
    hashlib.sha256(_WORK).digest()
    needed_s = _SLEEP_S + time.thread_time() - worked_s
    return max(time.monotonic() - began_s - needed_s, 0.0)
