"""The event loop of the rig: Twisted's, on a clock that nobody can set, and ended by a signal as by itself."""

import contextlib
import signal
import time
from collections.abc import Callable, Coroutine, Iterator
from types import FrameType
from typing import Any, TypeVar

from twisted.internet.defer import Deferred
from twisted.internet.selectreactor import SelectReactor
from twisted.python.failure import Failure

Result = TypeVar("Result")

# A program that is killed or suspended leaves motors to themselves. So every signal that does either, and can be
# caught, asks for the end; but for those of a processor's fault, after which no handler of Python's would run.
_UNCATCHABLE = {"SIGKILL", "SIGSTOP"}
_FAULTS = {"SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL"}
_HARMLESS = {"SIGCHLD", "SIGCLD", "SIGCONT", "SIGURG", "SIGWINCH", "SIGINFO"}
_LEFT_ALONE = {int(getattr(signal, n)) for n in _UNCATCHABLE | _FAULTS | _HARMLESS if hasattr(signal, n)}
ENDING_SIGNALS = tuple(sorted(set(map(int, signal.valid_signals())) - _LEFT_ALONE))

# A background job that touches its terminal gets these each time it tries again, until it ignores them.
_REPEATED = {int(getattr(signal, name)) for name in ("SIGTTIN", "SIGTTOU") if hasattr(signal, name)}


class Loop(SelectReactor):
    """Twisted's loop that waits with select.

    select takes its time-out in microseconds where epoll takes milliseconds, too coarse to poll an encoder
    at 1 kHz. Twisted's own clock is the wall clock: a step of it would stop every timer, or fire them all.
    """

    def seconds(self) -> float:
        """Return the time on the monotonic clock."""
        return time.monotonic()


class Ending:
    """The operator's wish to end: `signal` names what asked for it, empty until then."""

    def __init__(self, loop: Any) -> None:
        """Start without one; `loop` is Twisted's, or its Clock in a test."""
        self.signal = ""
        self._loop = loop
        self._waiting: list[Deferred[None]] = []

    def ask(self, name: str) -> None:
        """Ask for the end; only the first time counts."""
        if not self.signal:
            self.signal = name
            waiting, self._waiting = self._waiting, []
            for deferred in waiting:
                deferred.callback(None)

    def within(self, for_s: float | None) -> "Deferred[None]":
        """Return a Deferred that fires when the end is asked for, or after so many seconds."""
        deferred: Deferred[None] = Deferred()
        if self.signal:
            deferred.callback(None)
            return deferred
        self._waiting.append(deferred)
        if for_s is not None:
            self._loop.callLater(for_s, self._time_over, deferred)
        return deferred

    def _time_over(self, deferred: "Deferred[None]") -> None:
        if deferred in self._waiting:
            self._waiting.remove(deferred)
            deferred.callback(None)


def until_over(ending: Ending, running: "Deferred[None]") -> "Deferred[None]":
    """Return a Deferred that fires when a procedure is over, or when the end is asked for.

    In the second case, and when it is cancelled, the procedure is cancelled before anything else happens: nothing
    that it might still do comes after the devices' stop.
    """
    asked: list[None] = []
    first: Deferred[None] = Deferred(lambda _: running.cancel())

    def over(result: object) -> None:
        if first.called or asked:
            return
        if isinstance(result, Failure):
            first.errback(result)
        else:
            first.callback(None)

    def end(_: object) -> None:
        if not first.called:
            asked.append(None)
            running.cancel()
            first.callback(None)

    running.addBoth(over)
    ending.within(None).addCallback(end)
    return first


def run_until_done(main: Callable[[Loop, Ending], Coroutine[Any, Any, Result]]) -> Result:
    """Run a coroutine in a loop of its own and return its result, or raise what it raised.

    Signals only ask for the end, those that the program was told to ignore not even that (nohup): the coroutine
    stops its devices and closes its files. Once it has, a signal ends the program at once, should a thread that
    still waits for a device keep it.
    """
    loop = Loop()
    ending = Ending(loop)
    outcome: list[Result | Failure] = []

    def done(result: Result | Failure) -> None:
        outcome.append(result)
        for number in _heeded():
            signal.signal(number, signal.SIG_DFL)
        loop.callLater(0, loop.stop)  # one turn later: ports that were told to close do it in their next one

    def begin() -> None:
        Deferred.fromCoroutine(main(loop, ending)).addBoth(done)

    loop.callWhenRunning(begin)
    with _asking(loop, ending):
        loop.run(installSignalHandlers=False)
    result = outcome[0]
    if isinstance(result, Failure):
        result.raiseException()
    return result


@contextlib.contextmanager
def _asking(loop: Loop, ending: Ending) -> Iterator[None]:
    def handle(number: int, frame: FrameType | None) -> None:
        # A handler runs between any two steps of the program: the loop takes it up when it is ready.
        if number in _REPEATED:
            signal.signal(number, signal.SIG_IGN)
        loop.callFromThread(ending.ask, signal_name(number))

    before = {number: signal.signal(number, handle) for number in _heeded()}
    # The handler itself runs in this thread alone. A signal that meets another thread, or this one just before it
    # begins to wait, would be slept through: the interpreter's own part of the handler wakes the loop.
    woken = signal.set_wakeup_fd(loop.waker.o, warn_on_full_buffer=False)
    try:
        yield
    finally:
        signal.set_wakeup_fd(woken)
        for number, handler in before.items():
            signal.signal(number, handler)


def signal_name(number: int) -> str:
    """Return what a signal is called; those for real time are counted from the first."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"SIGRTMIN+{number - signal.SIGRTMIN}"


def _heeded() -> list[int]:
    """Return the signals that ask for the end, but for those that are ignored, or another library's own."""
    return [number for number in ENDING_SIGNALS if signal.getsignal(number) not in (signal.SIG_IGN, None)]
