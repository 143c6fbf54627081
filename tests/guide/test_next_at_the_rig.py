"""`cfid next` becomes a command that drives motors, and all further answers go to that command."""

import subprocess
from pathlib import Path

import pytest

from cfid.guide.plan import tasks
from cfid.records.rig_file import load_rig
from tests.flying_in_a_folder import bench_in as served_bench_in
from tests.virtual_bench import bench_in


@pytest.mark.usefixtures("in_time")
def test_answers_after_the_first_are_those_of_the_command_that_next_becomes(tmp_path: Path) -> None:
    with served_bench_in(tmp_path) as bench:  # since next ends as a process, and becomes another program
        pilot = bench.start("next", "--kind", "motors", stdin=subprocess.PIPE)
        pilot.process.communicate(b"y\nn\n")

    assert pilot.process.returncode == 2
    assert "next: cfid log thrust" in pilot.out
    assert "not confirmed" in pilot.err
    assert len(bench.history) == 1


def test_a_brushless_is_sent_to_a_staircase_that_its_rotors_allow(tmp_path: Path) -> None:
    with bench_in(tmp_path, crazyflie={"platform": "cf21bl"}) as bench:
        file = tmp_path / "rig.toml"
        file.write_text(file.read_text().replace('platform = "cf2"', 'platform = "cf21bl"'))
        planned = {task.section: task.recordings[0].words for task in tasks(load_rig(file), kind="motors")}
        pilot = bench.start(*planned["speed"], typed="n\n")

        assert pilot.end() == 2
        assert "not confirmed" in pilot.err
    assert "torque" not in planned  # the torques of four rotors cancel
