"""Settings and fixtures that the tests of all packages share."""

import gc
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from tests.priority import ahead_of_others

pytest_plugins = ["tests.campaigns", "tests.drawn"]

# Tests already run on all processors, so threads of the linear algebra, also in programs that tests start, would wait
# for each other. NumPy reads the variable when it is imported, so it is set here.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Programs that tests start load compiled modules; otherwise each program would compile all of cfid again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False


# The examples are the same every time, and have no deadline, since the time they take depends on the computer. There
# are ten times as many with --hypothesis-profile many.
settings.register_profile("cfid", deadline=None, derandomize=True, max_examples=50)
settings.register_profile("many", settings.get_profile("cfid"), max_examples=500)
settings.load_profile("cfid")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Start with the tutorial, which takes longest, and spread tests that wait for clocks among tests that compute.

    Every worker starts with a part of its own, so otherwise all workers would wait at the end.
    """
    timed = [item for item in items if _against_a_clock(item)]
    place = dict[Path, float]()
    for some in (timed, [item for item in items if not _against_a_clock(item)]):
        for i, item in enumerate(some):
            place.setdefault(item.path, i / len(some))
    items.sort(key=lambda item: (item.path.name != "test_tours.py", place[item.path]))
    for item in timed:
        # A test that runs against a clock is tried up to three times, since a computer with more tasks than cores, or a
        # virtual one that its host suspends, may have kept the devices and programs of a try from the processor. A
        # witness, as in the tests of killed runs, can measure how late rows are for that reason, but not what a delayed
        # program does: a device that is silent for half a second is lost, and an answer after 50 ms belongs to no poll.
        # Further tries wait until a short load may be over. pytest lists them; a real fault fails each time.
        if item.get_closest_marker("flaky") is None:
            item.add_marker(pytest.mark.flaky(reruns=2, reruns_delay=5))


def _against_a_clock(item: pytest.Item) -> bool:
    return "in_time" in getattr(item, "fixturenames", ())


def pytest_collection_finish() -> None:
    """Exclude the collected tests from garbage collection, which would take half a second each time to search them."""
    _keep_what_is_there()


@pytest.fixture(autouse=True, scope="session")
def locks_of_the_tests(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Separate the locks that tests take from those of the computer's users."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(os.environ, "CFID_LOCKS", str(tmp_path_factory.mktemp("locks") / "cfid"))
        yield


@pytest.fixture(autouse=True, scope="session")
def signals_that_are_not_ignored() -> None:
    """Stop ignoring signals that tests send to programs, which would inherit this, for example under nohup."""
    for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP):
        if signal.getsignal(number) == signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)


@pytest.fixture(scope="module")
def in_time() -> Iterator[None]:
    """Keep tests that only compute from delaying this one, whose devices and programs run against a clock."""
    with ahead_of_others():
        # No simulated device answers during a garbage collection in its process, and after half a second it is lost.
        _keep_what_is_there()
        yield


def _keep_what_is_there() -> None:
    gc.collect()
    gc.freeze()
