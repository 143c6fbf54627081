"""A loop has priority over programs that compute, where the system permits it, and only while it runs."""

import os
import subprocess
import sys

import pytest

from tests.lab import ROOT

pytestmark = pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="real-time scheduling of Linux")

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


@pytest.mark.parametrize(("user", "may"), [("this", True), ("failing", True), ("nobody", False)])
def test_a_loop_runs_ahead_where_that_is_granted_and_only_while_it_runs(user: str, may: bool) -> None:
    words = [sys.executable, "-W", "error", "-c", LOOP, user]
    ended = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    within = os.SCHED_RR if may and is_granted() else os.SCHED_OTHER

    assert ended.stdout.split() == [str(within), str(os.SCHED_OTHER)]
