"""Do one piece of work for each of many campaigns: in processes of this computer, or on a Dask cluster.

A process that dies, by a lack of memory say, takes nothing with it: another repeats the campaign it had.
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

TRIES = 3  # of a campaign, after which the processes that it kills are not the computer's fault
# One thread each, as a Dask worker has: more would wait for each other, and add up in another order.
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


@dataclass(kw_only=True)
class _Worker:
    """A process, the end of the pipe to it, the folder of its temporary ones, and what it is doing."""

    process: BaseProcess
    pipe: Connection
    room: "tempfile.TemporaryDirectory[str]"
    task: str = ""

    def do(self, task: str) -> None:
        """Give it work; one that has died is found out when it should answer."""
        self.task = task
        try:
            self.pipe.send(task)
        except OSError:
            return


def on_processes(
    work: Work[Answer], tasks: Sequence[str], *, number: int, imports: Sequence[str] = ()
) -> Iterator[tuple[str, Answer | DataError]]:
    """Yield each task with its answer, as they end; with an error where its process died for the third time.

    Processes are new ones, so that an answer does not depend on what this one did before. They end with the iterator.
    `imports` are modules that the work needs, which are imported once for all processes where systems can.
    """
    left, tries = deque(tasks), Counter[str]()
    workers: dict[Connection, _Worker] = {}

    def employ(worker: _Worker) -> None:
        if left:
            worker.do(left.popleft())
            workers[worker.pipe] = worker
        else:
            worker.pipe.close()  # upon which it ends
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
                    worker.room.cleanup()  # of what it could not
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
            worker.pipe.close()  # upon which also one ends in which a library's callback swallowed the signal
            worker.process.terminate()
            worker.process.join()
            worker.room.cleanup()


def on_cluster(work: Work[Answer], tasks: Sequence[str], address: str) -> Iterator[tuple[str, Answer | DataError]]:
    """Yield the same from a Dask cluster that exists, which repeats what a worker that died had."""
    with _client(address) as client:
        from distributed import as_completed  # noqa: PLC0415 - an extra

        futures = {client.submit(work, task, pure=False): task for task in tasks}
        for future in as_completed(list(futures)):
            task = futures.pop(future)
            try:
                answer = future.result()
            except Exception as error:  # of the cluster, of any kind
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
    with _environment(_ONE_THREAD):
        process = _begun(its, work, room.name, imports=imports)
    its.close()
    return _Worker(process=process, pipe=ours, room=room)


def _begun(*given: Any, imports: Sequence[str]) -> BaseProcess:
    """Begin a process that serves: forked from one that imports modules and does nothing else, where systems can."""
    if "forkserver" in multiprocessing.get_all_start_methods():
        forking = multiprocessing.get_context("forkserver")
        forking.set_forkserver_preload([*imports])
        forked = forking.Process(target=_serve, args=given, daemon=True)
        with suppress(OSError):  # it has a socket among temporary files, whose folder's name may be too long for one
            forked.start()
            return forked
    spawned = multiprocessing.get_context("spawn").Process(target=_serve, args=given, daemon=True)
    spawned.start()
    return spawned


@contextmanager
def _environment(added: Mapping[str, str]) -> Iterator[None]:
    """Set variables that a process inherits which is started meanwhile."""
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
    """Work in a process of its own, until the pipe is closed or the command ends it."""
    tempfile.tempdir = room
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the command too, which ends this
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())  # so that its temporary folders go
    warnings.simplefilter("ignore")  # of libraries: nobody could tell of which campaign
    try:
        _do_each(pipe, work)
    finally:
        shutil.rmtree(room, ignore_errors=True)  # of a command that was killed
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # nothing of its own is left, and libraries close what is theirs


def _do_each(pipe: Connection, work: Work[Any]) -> None:
    """Do what comes through a pipe until it is closed."""
    while True:
        try:
            task = pipe.recv()
        except (EOFError, OSError):
            return
        try:
            answer = work(task)
        except Exception as error:  # a bug, which one campaign meets and the others need not
            answer = DataError(f"{task}: {type(error).__name__}: {error}")
        try:
            pipe.send(answer)
        except OSError:  # the command has ended
            return


def _end(code: int | None) -> str:
    if code is None or code >= 0:
        return f"exit code {code}"
    return signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
