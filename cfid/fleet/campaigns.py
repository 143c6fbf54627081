"""Find the campaigns of a fleet, and the processes or the cluster that work on them."""

import glob
import multiprocessing
import os
import signal
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import Any

from cfid.errors import CfidError, ConfigError
from cfid.records.choose import is_glob
from cfid.records.files import read_small

# One thread per process, as for a Dask worker: more threads would wait for each other and sum in another order. Nothing
# is imported from the working directory, which may hold a file such as queue.py.
_ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "PYTHONSAFEPATH": "1"}


def campaign_folders(words: Sequence[str], index: Path | None = None) -> tuple[list[str], list[CfidError]]:
    """Return the folders that names, globs and an index state, each once, and the errors of globs that match none.

    An index is a text file with a folder or a glob on each line, relative to the index. Raises CfidError if no folder
    is left, or if the index cannot be read.
    """
    if index is not None:
        words = [*words, *_listed(index)]
    if not words:
        raise ConfigError("no campaign is given: name folders or globs, or an index with `index`.")
    folders, faults = dict[str, None](), list[CfidError]()
    for word in words:
        try:
            matches = [word]
            if is_glob(word) and not Path(word).exists():
                matches = [path for path in sorted(glob.glob(word)) if Path(path).is_dir()]  # noqa: PTH207 - Path.glob takes no absolute pattern
            folders |= {os.path.realpath(path): None for path in matches}
        except (OSError, ValueError):  # too long a name, or a zero byte in it
            matches = []
        if not matches:
            faults.append(ConfigError(f"{word[:100]}: no folder matches."))
    if not folders:
        raise ConfigError("\n  ".join(map(str, faults)))
    return list(folders), faults


def _listed(index: Path) -> list[str]:
    try:
        lines = [line.strip() for line in read_small(index).decode("utf-8-sig").splitlines()]
    except OSError as error:
        raise ConfigError(f"{index}: cannot be read: {error.strerror}.") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{index}: byte {error.start + 1} is not UTF-8 text: it should list campaigns.") from None
    return [str(index.parent / line) for line in lines if line and not line.startswith("#")]


@contextmanager
def workers(jobs: int, scheduler: str | None = None, *, most: int) -> Iterator[Executor]:
    """Start `jobs` processes, by default one for each processor, but at most `most`; or use the Dask cluster there.

    A single one is a thread of this process. Processes end with the context, also in the middle of their work. Raises
    ConfigError where no cluster answers.
    """
    if scheduler is not None:
        with _client(scheduler) as client:
            yield client.get_executor()
        return
    number = min(jobs or os.cpu_count() or 1, most)
    if number < 2:
        pool: Executor = ThreadPoolExecutor(1)
    else:
        os.environ.update(_ENVIRONMENT)  # the processes inherit it
        spawn = multiprocessing.get_context("spawn")  # so that no answer depends on what this process did before
        pool = ProcessPoolExecutor(number, mp_context=spawn, initializer=_prepare)
    try:
        yield pool
    except BaseException:
        for process in multiprocessing.active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _prepare() -> None:
    Thread(target=_end_with_command, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the command, too, which ends this process
    warnings.simplefilter("ignore")  # warnings of libraries do not name the campaign


def _client(address: str) -> Any:
    try:
        from distributed import Client  # noqa: PLC0415 - an extra
    except ImportError:
        raise ConfigError("`scheduler`: Dask is not installed here: pip install 'cfid[fleet]'.") from None
    try:
        return Client(address, timeout="10s")
    except (OSError, ValueError) as error:
        raise ConfigError(f"`scheduler` {address}: no Dask scheduler answers there: {error}") from None


def _end_with_command() -> None:
    """End this process when the command that started it was killed, after which nobody gives it work or ends it."""
    command = multiprocessing.parent_process()
    if command is not None:
        command.join()
        os._exit(1)
