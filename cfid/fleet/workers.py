"""Run one task for each of many campaigns: in processes of this computer, or on a Dask cluster.

If a process dies, for example from a lack of memory, nothing is lost: another process repeats its campaign.
"""

import multiprocessing
import os
import pickle
import shutil
import signal
import sys
import tempfile
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from cfid.errors import ConfigError, DataError

Answer = TypeVar("Answer")
Work = Callable[[str], Answer]

TRIES = 3  # after this many deaths of its processes, the campaign is at fault, not the computer
# One thread per process, as for a Dask worker: more threads would wait for each other and sum in another order. Nothing
# is imported from the working directory, which may hold a file such as queue.py.
_ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "PYTHONSAFEPATH": "1"}


@dataclass(kw_only=True)
class _Worker:
    """A process, this end of the pipe to it, the folder of its temporary folders, and its current task."""

    process: BaseProcess
    pipe: Connection
    room: "tempfile.TemporaryDirectory[str]"
    task: str = ""

    def do(self, task: str) -> None:
        """Send a task to the process; if the process has died, this is noticed when its answer is due."""
        self.task = task
        try:
            self.pipe.send(task)
        except OSError:
            return


def on_processes(
    work: Work[Answer], tasks: Sequence[str], *, number: int, imports: Sequence[str] = ()
) -> Iterator[tuple[str, Answer | DataError]]:
    """Yield each task with its answer when it ends, or with an error if its process died for the third time.

    The processes are new, so that an answer does not depend on what this process did before. They end with the
    iterator. `imports` names modules that the work needs; if the system allows, they are imported once for all.
    """
    left, tries = deque(tasks), Counter[str]()
    workers: dict[Connection, _Worker] = {}

    def employ(worker: _Worker) -> None:
        if left:
            worker.do(left.popleft())
            workers[worker.pipe] = worker
        else:
            worker.pipe.close()  # the process then ends
            worker.room.cleanup()

    try:
        for _ in range(min(max(number, 1), len(tasks))):
            employ(_start(work, imports))
        while workers:
            for pipe in wait(list(workers)):
                worker = workers.pop(pipe)  # type: ignore[call-overload]
                task = worker.task
                try:
                    answer = worker.pipe.recv()
                except (EOFError, OSError, pickle.UnpicklingError):
                    worker.process.join()
                    worker.room.cleanup()  # remove what the dead process left
                    tries[task] += 1
                    if tries[task] < TRIES:
                        left.appendleft(task)
                    else:
                        yield (
                            task,
                            DataError(f"{task}: {TRIES} processes died of it ({_end(worker.process.exitcode)})."),
                        )
                    if left:
                        employ(_start(work, imports))
                else:
                    employ(worker)
                    yield task, answer
    finally:
        for worker in workers.values():
            worker.pipe.close()  # ends even a process in which a library's callback swallows the signal
            worker.process.terminate()
            worker.process.join()
            worker.room.cleanup()


def on_cluster(work: Work[Answer], tasks: Sequence[str], address: str) -> Iterator[tuple[str, Answer | DataError]]:
    """Yield the same from an existing Dask cluster, which repeats the tasks of workers that died."""
    with _client(address) as client:
        from distributed import as_completed  # noqa: PLC0415 - an extra

        futures = {client.submit(work, task, pure=False): task for task in tasks}
        for future in as_completed(list(futures)):
            task = futures.pop(future)
            try:
                answer = future.result()
            except Exception as error:  # the cluster may raise an error of any type
                yield task, DataError(f"{task}: no worker of the cluster could do it: {error}".splitlines()[0])
            else:
                yield task, answer
            future.release()


@contextmanager
def _client(address: str) -> Iterator[Any]:
    try:
        from distributed import Client  # noqa: PLC0415 - an extra
    except ImportError:
        raise ConfigError("`scheduler`: Dask is not installed here: pip install 'cfid[fleet]'.") from None
    try:
        client = Client(address, timeout="10s")
    except (OSError, ValueError) as error:
        raise ConfigError(f"`scheduler` {address}: no Dask scheduler answers there: {error}") from None
    with client:
        yield client


def _start(work: Work[Any], imports: Sequence[str]) -> _Worker:
    ours, its = multiprocessing.Pipe()
    room = tempfile.TemporaryDirectory(prefix="cfid-fleet-", ignore_cleanup_errors=True)
    with _environment(_ENVIRONMENT):
        process = _begun(its, work, room.name, imports=imports)
    its.close()
    return _Worker(process=process, pipe=ours, room=room)


def _begun(*given: Any, imports: Sequence[str]) -> BaseProcess:
    """Start a worker process, forked if the system allows from a process that only imports the modules."""
    if "forkserver" in multiprocessing.get_all_start_methods():
        forking = multiprocessing.get_context("forkserver")
        forking.set_forkserver_preload([*imports])
        forked = forking.Process(target=_serve, args=given, daemon=True)
        with suppress(OSError):  # the path of the temporary folder may be too long for its socket
            forked.start()
            return forked
    spawned = multiprocessing.get_context("spawn").Process(target=_serve, args=given, daemon=True)
    spawned.start()
    return spawned


@contextmanager
def _environment(added: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables that processes started in this context inherit."""
    before = {name: os.environ.get(name) for name in added}
    os.environ.update(added)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _serve(pipe: Connection, work: Work[Any], room: str) -> None:
    """Work in a separate process, until the pipe is closed or the command ends the process."""
    tempfile.tempdir = room
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C also reaches the command, which ends this process
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())  # so that its temporary folders are removed
    warnings.simplefilter("ignore")  # warnings of libraries do not name the campaign
    try:
        _do_each(pipe, work)
    finally:
        shutil.rmtree(room, ignore_errors=True)  # a killed command cannot remove it
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # only libraries have anything left to close


def _do_each(pipe: Connection, work: Work[Any]) -> None:
    """Do each task that arrives through a pipe, until the pipe is closed."""
    while True:
        try:
            task = pipe.recv()
        except (EOFError, OSError):
            return
        try:
            answer = work(task)
        except Exception as error:  # a bug in one campaign must not stop the others
            answer = DataError(f"{task}: {type(error).__name__}: {error}")
        try:
            pipe.send(answer)
        except OSError:  # the command has ended
            return


def _end(code: int | None) -> str:
    if code is None or code >= 0:
        return f"exit code {code}"
    return signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
