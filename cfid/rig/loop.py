"""The rig's event loop: Twisted's on the monotonic clock, with signals that end it in order."""

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Coroutine, Iterator
from types import FrameType
from typing import Any, TypeVar

from twisted.internet.defer import Deferred
from twisted.internet.selectreactor import SelectReactor
from twisted.python.failure import Failure

Result = TypeVar("Result")

# A program that is killed or suspended leaves motors running. So every signal that does either and can be caught
# requests the end, except those of a processor fault, after which no handler of Python's would run.
_UNCATCHABLE = {signal.SIGKILL, signal.SIGSTOP}
_FAULTS = {signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL}
_HARMLESS = {signal.SIGCHLD, signal.SIGCONT, signal.SIGURG, signal.SIGWINCH}
_TYPED = {signal.SIGINT, signal.SIGQUIT}
ENDING_SIGNALS = tuple(sorted(map(int, signal.valid_signals() - _UNCATCHABLE - _FAULTS - _HARMLESS)))

# A background job that touches its terminal gets these each time it tries again, until it ignores them.
_REPEATED = {signal.SIGTTIN, signal.SIGTTOU}


class Loop(SelectReactor):
    """Twisted's loop that waits with select.

    select takes its time-out in microseconds where epoll takes milliseconds, too coarse to poll an encoder
    at 1 kHz. Twisted's own clock is the wall clock: a step of it would stop every timer, or fire them all.
    """

    def __init__(self) -> None:
        """Make a loop that does not run yet."""
        self._using_waker = threading.RLock()  # a signal's handler may run while its own thread closes
        super().__init__()

    def seconds(self) -> float:
        """Return the time on the monotonic clock."""
        return time.monotonic()

    def wakeUp(self) -> None:  # noqa: N802 - Twisted's name
        """Wake the loop from any thread; a call after the end does nothing.

        Without the lock, a late thread could write to a pipe that has just been closed, whose number may by then be
        that of a run's file.
        """
        with self._using_waker:
            if self.waker is not None:
                self.waker.wakeUp()

    def close(self) -> None:
        """Release the pipe that wakes the loop, which cannot run again."""
        with self._using_waker:
            waker, self.waker = self.waker, None
            waker.connectionLost(None)


class Ending:
    """A request to end: `signal` names what requested it, and is empty until then."""

    def __init__(self, loop: Any) -> None:
        """Start without a request; `loop` is Twisted's, or its Clock in a test."""
        self.signal = ""
        self._loop = loop
        self._waiting: list[Deferred[None]] = []

    def request(self, name: str) -> None:
        """Request the end; only the first request counts."""
        if not self.signal:
            self.signal = name
            waiting, self._waiting = self._waiting, []
            for deferred in waiting:
                deferred.callback(None)

    def within(self, for_s: float | None) -> Deferred[None]:
        """Return a Deferred that fires when the end is requested, or after `for_s` seconds."""
        deferred: Deferred[None] = Deferred()
        if self.signal:
            deferred.callback(None)
            return deferred
        self._waiting.append(deferred)
        if for_s is not None:
            self._loop.callLater(for_s, self._time_over, deferred)
        return deferred

    def _time_over(self, deferred: Deferred[None]) -> None:
        if deferred in self._waiting:
            self._waiting.remove(deferred)
            deferred.callback(None)


def until_over(ending: Ending, running: Deferred[None]) -> Deferred[None]:
    """Return a Deferred that fires when a procedure is over, or when the end is requested.

    In the second case, and when the Deferred is cancelled, the procedure is cancelled first, so that it can do nothing
    after the devices have stopped.
    """
    requested = False
    first: Deferred[None] = Deferred(lambda _: running.cancel())

    def over(result: object) -> None:
        if first.called or requested:
            return
        if isinstance(result, Failure):
            first.errback(result)
        else:
            first.callback(None)

    def end(_: object) -> None:
        nonlocal requested
        if not first.called:
            requested = True
            running.cancel()
            first.callback(None)

    running.addBoth(over)
    ending.within(None).addCallback(end)
    return first


def run_until_done(main: Callable[[Loop, Ending], Coroutine[Any, Any, Result]]) -> Result:
    """Run a coroutine in a loop of its own and return its result, or raise what it raised.

    Signals only request the end, and ignored ones (nohup) not even that: the coroutine stops its devices and closes
    its files. After that a signal ends the program at once, in case a thread that still waits for a device keeps it
    running.
    """
    loop = Loop()
    ending = Ending(loop)
    outcome: list[Result | Failure] = []

    def done(result: Result | Failure) -> None:
        outcome.append(result)
        for number in _ending_signals():
            signal.signal(number, signal.SIG_DFL)
        loop.callLater(0, loop.stop)  # one turn later: ports close in their next turn

    def begin() -> None:
        Deferred.fromCoroutine(main(loop, ending)).addBoth(done)

    loop.callWhenRunning(begin)
    try:
        with _signals_to(loop, ending), _ahead_of_others():
            loop.run(installSignalHandlers=False)
    finally:
        loop.close()
    result = outcome[0]
    if isinstance(result, Failure):
        result.raiseException()
    return result


@contextlib.contextmanager
def _signals_to(loop: Loop, ending: Ending) -> Iterator[None]:
    def handle(number: int, frame: FrameType | None) -> None:
        # A handler runs between any two steps of the program: the loop handles the request when it is ready.
        if number in _REPEATED:
            signal.signal(number, signal.SIG_IGN)
        loop.callFromThread(ending.request, signal_name(number))

    before = {number: signal.signal(number, handle) for number in _ending_signals()}
    # The handler itself runs in this thread only. A signal that reaches another thread, or this one just before it
    # begins to wait, would go unnoticed until the wait ends: the interpreter's part of the handler wakes the loop.
    woken = signal.set_wakeup_fd(loop.waker.o, warn_on_full_buffer=False)
    try:
        yield
    finally:
        signal.set_wakeup_fd(woken)
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def _ahead_of_others() -> Iterator[None]:
    """Run ahead of programs that compute, where the system grants it: a poll that waits for the processor is skipped.

    The loop's threads run ahead too, since they hold what the loop waits for. On a single processor a loop that hung
    would leave `cfid motors stop` only a twentieth of it, and so it runs like other programs there.
    """
    usual = _went_ahead()
    try:
        yield
    finally:
        if usual is not None:
            os.sched_setscheduler(0, *usual)


def _went_ahead() -> "tuple[int, os.sched_param] | None":
    """Go ahead of programs that compute; return the scheduling until then, None where going ahead is not granted."""
    try:
        usual = os.sched_getscheduler(0), os.sched_getparam(0)
        if len(os.sched_getaffinity(0)) < 2:
            return None
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(os.sched_get_priority_min(os.SCHED_RR)))
    except (AttributeError, OSError):  # not on this system, or not for this user
        return None
    return usual


def signal_name(number: int) -> str:
    """Return a signal's name; real-time signals are numbered from the first."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"SIGRTMIN+{number - signal.SIGRTMIN}"


def _ending_signals() -> list[int]:
    """Return the signals that request the end, except those that are ignored or handled outside Python.

    A shell ignores Ctrl-C for what a script starts with `&`: an operator who presses it means these motors too.
    """
    return [
        number
        for number in ENDING_SIGNALS
        if number in _TYPED or signal.getsignal(number) not in (signal.SIG_IGN, None)
    ]
