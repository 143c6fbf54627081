"""What the tests' workers do: functions that a process of its own can import."""

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
    """Die the first time, as by a lack of memory; `task` is a file that remembers it."""
    path = Path(task)
    if not path.exists():
        path.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return path.name


def die_of_bad(task: str) -> str:
    """Die whenever the task is bad."""
    if Path(task).name == "bad":
        os.kill(os.getpid(), signal.SIGKILL)
    return Path(task).name


def leave_and_die(task: str) -> None:
    """Make a temporary folder, and die in it; `task` is a file that gets its name."""
    Path(task).write_text(tempfile.mkdtemp())
    os.kill(os.getpid(), signal.SIGKILL)


def fail(task: str) -> str:
    """Fail as a bug does."""
    raise TypeError(f"{task} is no number")


def swallow(task: str) -> str:
    """Answer at once, but for a task "slow", which takes the end of its process for nothing, as callbacks may."""
    if task == "slow":
        with contextlib.suppress(SystemExit):
            time.sleep(30)
    return task


def threads(_: str) -> str | None:
    """Return how many threads the linear algebra may have."""
    return os.environ.get("OPENBLAS_NUM_THREADS")
