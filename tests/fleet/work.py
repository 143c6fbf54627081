"""Tasks of the tests' workers: functions that a separate process can import."""

import contextlib
import os
import signal
import tempfile
import time
from pathlib import Path


def length(task: str) -> int:
    """Return the length of a task."""
    return len(task)


def die_once(task: str) -> str:
    """Die at the first call, as if for lack of memory; the file `task` records that call."""
    path = Path(task)
    if not path.exists():
        path.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return path.name


def die_of_bad(task: str) -> str:
    """Die at every call whose task is a file named "bad"."""
    if Path(task).name == "bad":
        os.kill(os.getpid(), signal.SIGKILL)
    return Path(task).name


def leave_and_die(task: str) -> None:
    """Make a temporary folder, write its name to the file `task`, and die without removing the folder."""
    Path(task).write_text(tempfile.mkdtemp())
    os.kill(os.getpid(), signal.SIGKILL)


def fail(task: str) -> str:
    """Fail as a bug would."""
    raise TypeError(f"{task} is no number")


def swallow(task: str) -> str:
    """Answer at once, except to the task "slow", which suppresses the end of its process, as callbacks may do."""
    if task == "slow":
        with contextlib.suppress(SystemExit):
            time.sleep(30)
    return task


def threads(_: str) -> str | None:
    """Return how many threads the linear algebra may use."""
    return os.environ.get("OPENBLAS_NUM_THREADS")
