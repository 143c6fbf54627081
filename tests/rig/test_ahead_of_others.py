"""A loop has priority over programs that compute, where the system permits it, and only while it runs."""

import os
import subprocess
import sys

import pytest

from tests.places import ROOT

pytestmark = pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="real-time scheduling of Linux")

LOOP = """
import os, sys
from cfid.rig.loop import run_until_done

if sys.argv[1] == "nobody" and os.geteuid() == 0:
    os.setuid(65534)

def granted():
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    except OSError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True

if sys.argv[1] == "single":
    os.sched_setaffinity(0, [min(os.sched_getaffinity(0))])

async def main(loop, ending):
    if sys.argv[1] == "failing":
        raise RuntimeError("a bug")
    return os.sched_getscheduler(0)

right, seen = granted(), None
try:
    seen = run_until_done(main)
except RuntimeError as error:
    seen = str(error)
for each in (right, seen, os.sched_getscheduler(0)):
    print(each)
"""


def looped(user: str) -> list[str]:
    """Return whether a user has the permission, what the loop returned, and the scheduling policy afterwards."""
    words = [sys.executable, "-W", "error", "-c", LOOP, user]
    ended = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")
    return ended.stdout.splitlines()


def test_whoever_has_the_right_runs_ahead_as_long_as_the_loop_runs() -> None:
    right, within, after = looped("this one")
    ahead = right == "True" and len(os.sched_getaffinity(0)) > 1
    assert int(within) == (os.SCHED_RR if ahead else os.SCHED_OTHER)
    assert int(after) == os.SCHED_OTHER


def test_whoever_has_not_records_all_the_same() -> None:
    assert looped("nobody") == ["False", str(os.SCHED_OTHER), str(os.SCHED_OTHER)]


def test_on_a_single_processor_a_loop_runs_among_the_others() -> None:
    """A loop that hung with priority would leave `cfid motors stop` only a twentieth of the processor."""
    assert looped("single")[1:] == [str(os.SCHED_OTHER), str(os.SCHED_OTHER)]


def test_a_loop_that_fails_leaves_what_comes_after_it_among_the_others() -> None:
    assert looped("failing")[1:] == ["a bug", str(os.SCHED_OTHER)]
