"""What the tests of all rooms share."""

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

# Tests run on all processors already: threads of the linear algebra, also of programs that tests start, would wait
# for each other. Read when NumPy is imported, hence here.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Programs that tests start load compiled modules, where each would compile the whole of cfid anew.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False


# The same examples every time; how long one takes is the computer's business. Ten times as many with
# --hypothesis-profile many.
settings.register_profile("cfid", deadline=None, derandomize=True, max_examples=50)
settings.register_profile("many", settings.get_profile("cfid"), max_examples=500)
settings.load_profile("cfid")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the tutorial, which takes longest, and spread what waits for clocks among what computes.

    Every worker begins with a part of its own, and all of them would wait at the end.
    """
    timed = [item for item in items if _against_a_clock(item)]
    place = dict[Path, float]()
    for some in (timed, [item for item in items if not _against_a_clock(item)]):
        for i, item in enumerate(some):
            place.setdefault(item.path, i / len(some))
    items.sort(key=lambda item: (item.path.name != "test_tutorial.py", place[item.path]))
    for item in timed:
        # What runs against a clock gets a second try: a computer with more to do than it has cores may have kept the
        # devices and programs of the first from the processor. A witness, as of killed runs, can tell by how much rows
        # are late for that, but not what a program does that was held up: a device that is silent for half a second
        # is lost, and an answer after 50 ms is to no poll. The closing line counts it; a fault fails twice.
        if item.get_closest_marker("flaky") is None:
            item.add_marker(pytest.mark.flaky(reruns=1))


def _against_a_clock(item: pytest.Item) -> bool:
    return "in_time" in getattr(item, "fixturenames", ())


def pytest_collection_finish() -> None:
    """Keep what was collected for good: to look through it again for garbage takes half a second, over and over."""
    _keep_what_is_there()


@pytest.fixture(autouse=True, scope="session")
def locks_of_the_tests(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep the locks that tests take apart from those of the computer's users."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(os.environ, "CFID_LOCKS", str(tmp_path_factory.mktemp("locks") / "cfid"))
        yield


@pytest.fixture(autouse=True, scope="session")
def signals_that_are_not_ignored() -> None:
    """Heed what tests send to the programs that they start, which inherit what is ignored: under nohup, say."""
    for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP):
        if signal.getsignal(number) == signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)


@pytest.fixture(scope="module")
def in_time() -> Iterator[None]:
    """Keep tests that only compute from delaying this one, whose devices and programs run against a clock."""
    with ahead_of_others():
        # No simulated device answers while its process looks for garbage, and half a second is a device that is lost.
        _keep_what_is_there()
        yield


def _keep_what_is_there() -> None:
    gc.collect()
    gc.freeze()
