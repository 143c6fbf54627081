"""`cfid next` becomes a command that drives motors, and leaves it every further answer."""

import subprocess
from pathlib import Path

import pytest

from tests.flying_in_a_folder import bench_in

pytestmark = pytest.mark.usefixtures("in_time")


def test_answers_after_the_first_are_those_of_the_command_that_next_becomes(tmp_path: Path) -> None:
    with bench_in(tmp_path) as bench:
        pilot = bench.start("next", "--kind", "motors", stdin=subprocess.PIPE)
        pilot.process.communicate(b"y\nn\n")

        assert pilot.process.returncode == 2
        assert "Is the vehicle fastened and everyone clear?" in pilot.err
        assert "not confirmed: no motor was started." in pilot.err
        assert "next: cfid log thrust" in pilot.out
        assert len(bench.history) == 1
