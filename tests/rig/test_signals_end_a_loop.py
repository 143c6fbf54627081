"""Signals request the end of a loop: its coroutine ends in its own time, and the program's handlers are restored."""

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


def test_signals_that_mean_no_end_are_none() -> None:
    process = start("say(run_until_done(until_asked))")
    for number in (signal.SIGCHLD, signal.SIGCONT, signal.SIGURG, signal.SIGWINCH, signal.SIGPIPE, signal.SIGTERM):
        process.send_signal(number)
        time.sleep(0.02)  # pending signals are handled by their number, not in order
    assert said(process) == ["SIGTERM"]


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


@pytest.mark.parametrize("name", ["SIGINT", "SIGQUIT"])
def test_a_key_ends_a_program_that_a_script_started_in_the_background(name: str) -> None:
    """A shell without job control starts it with both signals ignored."""
    process = start(
        f"""
signal.signal(signal.{name}, signal.SIG_IGN)
say(run_until_done(until_asked))
"""
    )
    process.send_signal(getattr(signal, name))
    assert said(process) == [name]


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


def test_a_signal_that_another_thread_receives_is_not_slept_through() -> None:
    process = start(
        """
import threading

def receives_it():
    time.sleep(0.3)  # the loop waits by now, without any timer
    signal.pthread_kill(threading.get_ident(), signal.SIGTERM)

async def main(loop, ending):
    threading.Thread(target=receives_it).start()
    say("ready")
    await ending.within(None)
    return ending.signal

say(run_until_done(main))
"""
    )
    try:
        assert process.wait(10) == 0
        assert said(process) == ["SIGTERM"]
    finally:
        process.kill()


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


def test_a_wait_ends_after_its_time_and_at_once_where_the_end_was_requested_before() -> None:
    async def main(loop: Loop, ending: Ending) -> tuple[float, str]:
        begun_s = loop.seconds()
        await ending.within(0.05)
        waited_s = loop.seconds() - begun_s
        ending.request("SIGINT")
        await ending.within(60)
        return waited_s, ending.signal

    waited_s, name = run_until_done(main)
    assert waited_s >= 0.05
    assert name == "SIGINT"


def test_a_thread_that_is_late_neither_fails_nor_writes_to_a_file_that_was_opened_since() -> None:
    process = start(
        """
import os, tempfile, threading
say("ready")
over = False

async def main(loop, ending):
    def keep_waking():
        while not over:
            loop.callFromThread(int)
    threads.append(threading.Thread(target=keep_waking))
    threads[-1].start()
    await ending.within(0.01)

threads = []
sys.setswitchinterval(1e-5)
for _ in range(10):
    over = False
    run_until_done(main)
    opened = [tempfile.TemporaryFile() for _ in range(8)]  # these get the numbers of the loop's closed pipe
    time.sleep(0.01)
    over = True
    threads[-1].join()
    say(sum(os.fstat(file.fileno()).st_size for file in opened))
    for file in opened:
        file.close()
"""
    )
    assert said(process) == ["0"] * 10
