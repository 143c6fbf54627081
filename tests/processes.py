"""`cfid` in separate processes, forked from a process that has imported it, so that they start at once.

Imports are nine tenths of the processor time of `python -m cfid.cli.main log encoder`. A forked process can be
signalled, suspended, typed to and killed like any other; only its name in the kernel is that of its parent.
"""

import atexit
import contextlib
import functools
import gc
import importlib
import json
import os
import pkgutil
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from cfid.sim.app_core import load_library
from tests.lab import ROOT
from tests.priority import run_at

_ROOMS = ("cfid.cli", "cfid.console", "cfid.rig", "cfid.sim")  # common to the commands that reach devices
_NUMBER = 8  # characters of a number that is reported
_AT_THE_DOOR = """#!{python} -IS
import json, os, signal, socket, sys
words = sys.argv[4:] if sys.argv[1:4] == ["-P", "-m", "cfid.cli.main"] else sys.argv[1:]
wanted = json.dumps([words, os.getcwd(), dict(os.environ), os.getpriority(os.PRIO_PROCESS, 0)]).encode()
reports, report = os.pipe()
with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking:
    asking.connect({door!r})
    socket.send_fds(asking, [wanted], [0, 1, 2, report])
os.close(report)
child = int(os.read(reports, {length}))
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, lambda number, _: os.kill(child, number))
code = os.waitstatus_to_exitcode(int(os.read(reports, {length})))
sys.exit(code if code >= 0 else 128 - code)
"""


def started(
    words: Iterable[object], *, anew: bool = False, wrapper: Sequence[str] = (), **options: Any
) -> "Forked | subprocess.Popen[bytes]":
    """Start `cfid` by a fork, or in a new Python if `anew`, with a wrapper, or with a `preexec_fn`."""
    arguments = [str(word) for word in words]
    if not (anew or wrapper or "preexec_fn" in options):
        return Forked(arguments, **options)
    command = [*wrapper, sys.executable, "-P", "-W", "error", "-m", "cfid.cli.main", *arguments]
    return subprocess.Popen(command, **{"stdin": subprocess.DEVNULL, **options})


class Forked:
    """A running `cfid` with those methods of `subprocess.Popen` that tests use; its output goes to files."""

    def __init__(
        self,
        words: Sequence[str],
        *,
        cwd: Path,
        env: Mapping[str, str],
        stdout: int | IO[Any],
        stderr: int | IO[Any],
        stdin: int | IO[Any] = subprocess.DEVNULL,
    ) -> None:
        self.returncode: int | None = None
        self.stdin: IO[bytes] | None = None
        self._reports, report = os.pipe()
        with contextlib.ExitStack() as opened:
            opened.callback(os.close, report)
            if stdin == subprocess.DEVNULL:
                stdin = opened.enter_context(Path(os.devnull).open("rb"))
            elif stdin == subprocess.PIPE:
                stdin, end = os.pipe()
                opened.callback(os.close, stdin)
                self.stdin = os.fdopen(end, "wb")
            files = [file if isinstance(file, int) else file.fileno() for file in (stdin, stdout, stderr)]
            priority = os.getpriority(os.PRIO_PROCESS, 0)
            wanted = json.dumps([list(words), str(cwd), dict(env), priority]).encode()
            socket.send_fds(_nursery(), [wanted], [*files, report])
        self.pid = self._reported()

    def poll(self) -> int | None:
        """Return the exit code, or minus the number of the signal that ended the program; None while it runs."""
        if self.returncode is None and self._has_reported(0.0):
            self.returncode = os.waitstatus_to_exitcode(self._reported())
            os.close(self._reports)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        if self.returncode is None and not self._has_reported(timeout):
            raise subprocess.TimeoutExpired("cfid", timeout or 0.0)
        code = self.poll()
        assert code is not None
        return code

    def communicate(self, typed: bytes = b"", timeout: float | None = None) -> None:
        """Type text, close standard input, and wait for the end of the program."""
        assert self.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # raised if the program ends before it has read all
            self.stdin.write(typed)
            self.stdin.close()
        self.wait(timeout)

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def _has_reported(self, within_s: float | None) -> bool:
        return bool(select.select([self._reports], [], [], within_s)[0])

    def _reported(self) -> int:
        return int(os.read(self._reports, _NUMBER))


@contextlib.contextmanager
def cfid_in_a_shell() -> Iterator[Path]:
    """Make a folder for a shell's PATH with a program `cfid` that runs by a fork, also when cfid itself runs cfid."""
    with (
        tempfile.TemporaryDirectory(prefix="cfid") as folder,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as door,
    ):
        program, place = Path(folder) / "cfid", f"{folder}/door"
        door.bind(place)
        program.write_text(_AT_THE_DOOR.format(python=sys.executable, door=place, length=_NUMBER))
        program.chmod(0o755)
        with _nursery_of(door):
            yield program.parent


@functools.cache
def _nursery() -> socket.socket:
    """Start the process that others are forked from; it ends with this process."""
    opened = contextlib.ExitStack()
    atexit.register(opened.close)
    return opened.enter_context(_nursery_of())


@contextlib.contextmanager
def _nursery_of(*doors: socket.socket) -> Iterator[socket.socket]:
    ours, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with its:
        handles = [handle.fileno() for handle in (its, *doors)]
        # `motors stop` signals only processes of this user with the word cfid in their command line.
        command = [sys.executable, "-W", "error", "-m", "tests.processes", "cfid", *map(str, handles)]
        process = subprocess.Popen(command, pass_fds=handles, cwd=ROOT)
    try:
        yield ours
    finally:
        ours.close()
        process.wait()


def _import_all(rooms: Iterable[str]) -> None:
    for room in map(importlib.import_module, rooms):
        for module in pkgutil.walk_packages(room.__path__, f"{room.__name__}."):
            importlib.import_module(module.name)
    load_library()  # compile it once for all processes
    gc.freeze()  # a child that exits need not search all this


def _born(asking: Sequence[socket.socket]) -> list[str]:
    """Fork a process for each request and return its words in the child; exit when the first socket is closed."""
    while True:
        asked = select.select(asking, [], [])[0][0]
        wanted, handles, _, _ = socket.recv_fds(asked, 1 << 20, 4)
        if not wanted:
            sys.exit()
        if os.fork() == 0:
            break
        for handle in handles:
            os.close(handle)
        with contextlib.suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
    for each in asking:
        each.close()
    *files, report = handles
    _keep(report)
    os.close(report)
    for number, handle in enumerate(files):
        os.dup2(handle, number)
        os.close(handle)
    words, folder, environment, priority = json.loads(wanted)
    run_at(priority)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    if asked is not asking[0]:  # programs that it starts with its own Python are forked too
        sys.executable = str(shutil.which("cfid"))
    sys.stdin, sys.stdout = open(0, closefd=False), open(1, "w", closefd=False)  # noqa: SIM115 - as Python opens them
    sys.stderr = open(2, "w", buffering=1, errors="backslashreplace", closefd=False)  # noqa: SIM115
    return [str(word) for word in words]


def _keep(report: int) -> None:
    """Fork again and return in the child; in the parent, wait for the child, and report its number and its status."""
    child = os.fork()
    if child:
        os.write(report, f"{child:{_NUMBER}}".encode())
        _, status = os.waitpid(child, 0)
        os.write(report, f"{status:{_NUMBER}}".encode())
        os._exit(0)


def _leave(ended: Sequence[SystemExit]) -> None:
    """Exit without Python's final cleanup of modules, which is half of the cost of a short command.

    Threads and exit handlers have ended by then. If output cannot be written, Python handles the error.
    """
    if len(ended) == 1 and isinstance(ended[0].code, int | None):
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(ended[0].code or 0)


if __name__ == "__main__":
    ended: list[SystemExit] = []
    atexit.register(_leave, ended)  # registered first, so called last
    sockets = [socket.socket(fileno=int(number)) for number in sys.argv[2:]]
    _import_all(_ROOMS if len(sockets) == 1 else ["cfid"])
    from cfid.cli.main import main

    try:
        main(_born(sockets))
    except SystemExit as error:
        ended.append(error)
        raise
