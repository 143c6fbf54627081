"""Work on many campaigns in processes and on a cluster: if a worker dies, another one does its tasks."""

import os
import subprocess
import sys
import threading
from collections.abc import Generator
from pathlib import Path

import pytest

from cfid.errors import DataError
from cfid.fleet.workers import TRIES, on_cluster, on_processes
from tests.fleet.work import die_of_bad, die_once, fail, leave_and_die, length, swallow, threads
from tests.lab import ROOT

pytestmark = pytest.mark.usefixtures("in_time")


def test_each_task_is_answered_once_by_any_number_of_processes() -> None:
    tasks = ["a", "bb", "ccc", "dddd"]

    for number in (1, 3, 9):
        assert sorted(on_processes(length, tasks, number=number)) == [("a", 1), ("bb", 2), ("ccc", 3), ("dddd", 4)]
    assert list(on_processes(length, [], number=2)) == []


def test_what_a_process_that_died_had_is_done_by_another(tmp_path: Path) -> None:
    tasks = [str(tmp_path / name) for name in ("a", "b", "c")]

    assert dict(on_processes(die_once, tasks, number=2)) == dict(zip(tasks, ("a", "b", "c"), strict=True))


def test_processes_begin_also_where_a_temporary_file_has_no_room_for_a_sockets_name(tmp_path: Path) -> None:
    (long := tmp_path / ("long" * 30)).mkdir()
    script = (
        "from tests.fleet.work import length; from cfid.fleet.workers import on_processes\n"
        "if __name__ == '__main__': print(list(on_processes(length, ['bb'], number=1)))"
    )
    environment = os.environ | {"TMPDIR": str(long), "PYTHONPATH": str(ROOT)}
    (tmp_path / "script.py").write_text(script)
    ended = subprocess.run(
        [sys.executable, tmp_path / "script.py"], env=environment, capture_output=True, text=True, check=False
    )

    assert ended.stdout == "[('bb', 2)]\n", ended.stderr
    assert not list(long.iterdir())


def test_a_task_of_which_processes_die_is_given_up_and_the_others_are_done() -> None:
    found = dict(on_processes(die_of_bad, ["good", "bad", "fine"], number=1))

    assert found["good"] == "good"
    assert found["fine"] == "fine"
    assert isinstance(found["bad"], DataError)
    assert str(found["bad"]) == f"bad: {TRIES} processes died of it (SIGKILL)."


def test_what_a_process_that_died_had_made_for_itself_is_removed(tmp_path: Path) -> None:
    task = tmp_path / "made"

    assert isinstance(dict(on_processes(leave_and_die, [str(task)], number=1))[str(task)], DataError)
    assert not Path(task.read_text()).exists()


def test_a_bug_is_the_answer_to_its_task_alone() -> None:
    ((task, answer),) = on_processes(fail, ["a"], number=1)

    assert task == "a"
    assert isinstance(answer, DataError)
    assert str(answer) == "a: TypeError: a is no number"


def test_a_process_that_takes_its_end_for_nothing_ends_all_the_same() -> None:
    """Previously, an interrupted refit waited for such a process without end."""
    answers = on_processes(swallow, ["quick", "slow"], number=1)
    assert isinstance(answers, Generator)
    assert next(answers) == ("quick", "quick")
    closing = threading.Thread(target=answers.close, daemon=True)
    closing.start()
    closing.join(20)
    assert not closing.is_alive()


def test_a_process_has_one_thread_so_that_numbers_add_up_in_one_order() -> None:
    assert dict(on_processes(threads, ["a"], number=1)) == {"a": "1"}


def test_what_a_clusters_worker_that_died_had_is_done_by_another(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="Dask is not installed: pip install 'cfid[fleet]'")
    tasks = [str(tmp_path / name) for name in ("a", "b")]
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=True, dashboard_address=":0", silence_logs=50
    ) as cluster:
        found = dict(on_cluster(die_once, tasks, cluster.scheduler_address))

    assert found == dict(zip(tasks, ("a", "b"), strict=True))
