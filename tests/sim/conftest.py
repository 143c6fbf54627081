"""Reactors for tests with real wires: each test that needs a reactor gets its own, which runs in a thread."""

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from twisted.internet.posixbase import PosixReactorBase
from twisted.internet.selectreactor import SelectReactor
from twisted.internet.threads import blockingCallFromThread


class _Loop(SelectReactor):
    def seconds(self) -> float:
        return time.monotonic()


@pytest.fixture
def reactor(in_time: None) -> Iterator[PosixReactorBase]:
    """A reactor whose devices run against a clock, so that other tests must not delay them."""
    loop = _Loop()
    thread = threading.Thread(target=loop.run, kwargs={"installSignalHandlers": False})
    thread.start()
    yield loop
    loop.callFromThread(loop.stop)
    thread.join(5)
    assert not thread.is_alive()


@pytest.fixture
def in_reactor(reactor: PosixReactorBase) -> Callable[[Callable[[], Any]], Any]:
    """Return a function that runs another one in the reactor's thread and waits for its result."""
    return lambda act: blockingCallFromThread(reactor, act)  # type: ignore[arg-type]  # twisted hides that it is one
