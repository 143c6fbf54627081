"""Signals request the end of a loop, whose handlers are restored; it has priority over programs only while it runs."""

import os
import pty
import select
import signal
import subprocess
import sys
import time

import pytest

from cfid.errors import DeviceError
from cfid.rig.loop import Ending, Loop, run_until_done
from tests.lab import ROOT

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of Unix")

PREFACE = """
import signal, sys, time
from twisted.internet.task import deferLater
from cfid.rig.loop import run_until_done

def say(*words):
    print(*words, flush=True)

async def until_asked(loop, ending):
    say("ready")
    await ending.within(20.0)
    return ending.signal
"""
# Signals that end or suspend a program by default (signal(7)), and can be caught.
BY_DEFAULT = (
    *("SIGHUP", "SIGINT", "SIGQUIT", "SIGTRAP", "SIGABRT", "SIGUSR1", "SIGUSR2", "SIGALRM", "SIGTERM", "SIGSTKFLT"),
    *("SIGTSTP", "SIGTTIN", "SIGTTOU", "SIGXCPU", "SIGVTALRM", "SIGPROF", "SIGIO", "SIGPWR", "SIGSYS"),
)


def start(body: str, *wrapper: str) -> "subprocess.Popen[str]":
    """Start a program and wait for its first line."""
    command = [*wrapper, sys.executable, "-W", "error", "-c", PREFACE + body]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n", process.communicate()
    return process


def said(process: "subprocess.Popen[str]") -> list[str]:
    assert process.stdout is not None
    assert process.stderr is not None
    with process:
        lines, err = process.stdout.read().splitlines(), process.stderr.read()
    assert (process.returncode, err) == (0, "")
    return lines


def test_every_signal_that_ends_or_suspends_a_program_ends_a_wait_by_its_name_and_handlers_come_back() -> None:
    numbers = [*(getattr(signal, name) for name in BY_DEFAULT), signal.SIGRTMIN, signal.SIGRTMIN + 7, signal.SIGRTMAX]
    names = [*BY_DEFAULT, "SIGRTMIN", "SIGRTMIN+7", "SIGRTMAX"]
    process = start(
        f"""
signal.signal(signal.SIGHUP, lambda *_: None)
numbers = {list(map(int, numbers))}
before = [signal.getsignal(number) for number in numbers]
for _ in numbers:
    say(run_until_done(until_asked))
say(before == [signal.getsignal(number) for number in numbers])
"""
    )
    assert process.stdout is not None
    for number, name in zip(numbers, names, strict=True):
        process.send_signal(number)
        assert process.stdout.readline() == f"{name}\n"
        if number != numbers[-1]:
            assert process.stdout.readline() == "ready\n"
    assert said(process) == ["True"]


def test_a_background_job_that_its_terminal_warns_comes_to_its_end() -> None:
    """The terminal sends the signal again whenever the write is retried, forever unless one side gives in."""
    body = (
        PREFACE
        + """
import os, termios

terminal = os.open("/dev/tty", os.O_RDWR)
settings = termios.tcgetattr(terminal)
settings[3] |= termios.TOSTOP
termios.tcsetattr(terminal, termios.TCSANOW, settings)
if os.fork():
    os.waitpid(-1, 0)
    sys.exit()
os.setpgid(0, 0)  # in the background from now on

async def main(loop, ending):
    os.write(terminal, b"written\\n")
    await ending.within(None)
    os.write(terminal, f"{ending.signal}\\n".encode())

run_until_done(main)
"""
    )
    process, terminal = pty.fork()
    if not process:
        os.chdir(ROOT)
        os.execv(sys.executable, [sys.executable, "-c", body])
    try:
        seen = b""
        while b"SIGTTOU" not in seen:
            assert select.select([terminal], [], [], 20)[0], seen
            seen += os.read(terminal, 100)
    finally:
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
        os.close(terminal)
    assert b"written" in seen


def test_a_program_under_nohup_does_not_end_when_its_terminal_does() -> None:
    process = start(
        """
async def main(loop, ending):
    say("ready")
    for _ in range(4):
        await deferLater(loop, 0.05, lambda: None)
        say("going on")
    await ending.within(None)
    return ending.signal

say(run_until_done(main))
say(signal.getsignal(signal.SIGHUP) == signal.SIG_IGN)
""",
        "nohup",
    )
    assert process.stdout is not None
    process.send_signal(signal.SIGHUP)
    for _ in range(4):
        assert process.stdout.readline() == "going on\n"
    process.send_signal(signal.SIGTERM)
    assert said(process) == ["SIGTERM", "True"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_a_signal_ends_a_program_whose_work_is_done_though_a_thread_keeps_it(number: signal.Signals) -> None:
    process = start(
        """
def waits_for_ever():
    say("ready")
    time.sleep(3600)

async def main(loop, ending):
    loop.callInThread(waits_for_ever)
    await ending.within(None)
    await deferLater(loop, 0.2, lambda: None)  # more signals come
    say("closed")

run_until_done(main)
"""
    )
    assert process.stdout is not None
    for _ in range(3):
        process.send_signal(number)
    assert process.stdout.readline() == "closed\n"
    time.sleep(0.3)
    still_there = process.poll() is None
    process.send_signal(number)
    with process:
        assert process.wait(5) == -number
        assert process.stderr is not None
        assert process.stderr.read() == ""
    assert still_there


def test_a_signal_during_work_that_blocks_is_taken_up_after_it_and_the_first_of_many_counts() -> None:
    process = start(
        """
async def main(loop, ending):
    say("ready")
    end_s = time.monotonic() + 0.4
    while time.monotonic() < end_s:
        sum(range(1000))
    say("worked", ending.signal or "unasked")
    await ending.within(None)
    say("closing")
    await deferLater(loop, 0.4, lambda: None)  # more signals come
    return ending.signal

say(run_until_done(main))
"""
    )
    assert process.stdout is not None
    process.send_signal(signal.SIGTERM)
    assert [process.stdout.readline() for _ in range(2)] == ["worked unasked\n", "closing\n"]
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGINT):
        process.send_signal(number)
        time.sleep(0.02)
    assert said(process) == ["SIGTERM"]


@pytest.mark.parametrize("error", [DeviceError("no device"), KeyError("a slip"), KeyboardInterrupt()])
def test_errors_come_out_of_a_loop_and_handlers_come_back(error: BaseException) -> None:
    async def fails(loop: Loop, ending: Ending) -> None:
        raise error

    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(type(error)):
        run_until_done(fails)
    assert signal.getsignal(signal.SIGINT) is before


LOOP = """
import os, sys
from cfid.rig.loop import run_until_done

if sys.argv[1] == "nobody" and os.geteuid() == 0:
    os.setuid(65534)

async def main(loop, ending):
    print(os.sched_getscheduler(0))
    if sys.argv[1] == "failing":
        raise RuntimeError("a bug")

try:
    run_until_done(main)
except RuntimeError:
    pass
print(os.sched_getscheduler(0))
"""


def is_granted() -> bool:
    """Return whether this user may have real-time priority, on more than one processor."""
    body = "import os; os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))"
    ended = subprocess.run([sys.executable, "-c", body], capture_output=True, check=False)
    return ended.returncode == 0 and len(os.sched_getaffinity(0)) > 1


@pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="real-time scheduling of Linux")
@pytest.mark.parametrize(("user", "may"), [("this", True), ("failing", True), ("nobody", False)])
def test_a_loop_runs_ahead_where_that_is_granted_and_only_while_it_runs(user: str, may: bool) -> None:
    words = [sys.executable, "-W", "error", "-c", LOOP, user]
    ended = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    within = os.SCHED_RR if may and is_granted() else os.SCHED_OTHER

    assert ended.stdout.split() == [str(within), str(os.SCHED_OTHER)]
