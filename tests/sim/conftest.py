"""Reactors for tests with real wires: each test that needs a reactor gets its own, which runs in a thread."""

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from twisted.internet.threads import blockingCallFromThread

from cfid.rig.loop import Loop


@pytest.fixture
def reactor(in_time: None) -> Iterator[Loop]:
    """A reactor whose devices run against a clock, so that other tests must not delay them."""
    loop = Loop()
    thread = threading.Thread(target=loop.run, kwargs={"installSignalHandlers": False})
    thread.start()
    yield loop
    loop.callFromThread(loop.stop)
    thread.join(5)
    assert not thread.is_alive()
    loop.close()


@pytest.fixture
def in_reactor(reactor: Loop) -> Callable[[Callable[[], Any]], Any]:
    """Return a function that runs another one in the reactor's thread and waits for its result."""
    return lambda act: blockingCallFromThread(reactor, act)
