"""Real wires in time: a reactor of its own for each test that needs one, running in a thread beside it."""

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


@pytest.fixture(autouse=True, scope="module")
def wires_in_time(in_time: None) -> None:
    """Run the wires of this room in time."""


@pytest.fixture
def reactor() -> Iterator[PosixReactorBase]:
    loop = _Loop()
    thread = threading.Thread(target=loop.run, kwargs={"installSignalHandlers": False})
    thread.start()
    yield loop
    loop.callFromThread(loop.stop)
    thread.join(5)
    assert not thread.is_alive()


@pytest.fixture
def in_reactor(reactor: PosixReactorBase) -> Callable[[Callable[[], Any]], Any]:
    """Run something in the reactor's thread and wait for what comes of it."""
    return lambda act: blockingCallFromThread(reactor, act)  # type: ignore[arg-type]  # twisted hides that it is one
