"""The page's button stops the vehicle that the shown run drives, whichever vehicle the local campaign names."""

import http.client
import json
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.flying_in_a_folder import Bench, Pilot, bench_in
from tests.rig_in_a_folder import wait_until

pytestmark = pytest.mark.usefixtures("in_time")

RECORDED = ("log", "thrust", "--from", 30000, "--to", 30000, "--hold", 600, "--rest", 0.3, "--yes")
NOBODY = "udp://127.0.0.1:9"


@contextmanager
def watching(bench: Bench, *words: object) -> Iterator[int]:
    """Run `cfid watch` and yield its port."""
    watcher = bench.start("watch", *words)
    bench.wait_until(lambda: "http://" in watcher.err or watcher.process.poll() is not None, watcher)
    found = re.search(r"http://127\.0\.0\.1:(\d+)/", watcher.err)
    assert found is not None, watcher.err
    yield int(found[1])
    watcher.send(signal.SIGINT)
    watcher.end()


def ask(port: int, method: str, path: str, **headers: str) -> str:
    line = http.client.HTTPConnection("127.0.0.1", port, timeout=40)
    line.request(method, path, headers={name.replace("_", "-"): value for name, value in headers.items()}, body=b"")
    answer = line.getresponse().read().decode()
    line.close()
    return answer


def press(port: int) -> dict[str, object]:
    """Press the button of a page and return the answer."""
    token = re.search(r'data-token="([^"]+)"', ask(port, "GET", "/"))
    assert token is not None
    answer: dict[str, object] = json.loads(
        ask(port, "POST", "/stop", Origin=f"http://127.0.0.1:{port}", X_Cfid_Token=token[1])
    )
    return answer


def driving(bench: Bench) -> Pilot:
    recorder = bench.start(*RECORDED)
    recorder.wait_until_motors_run()
    return recorder


def test_a_run_of_another_campaign_is_stopped_from_its_page(tmp_path: Path) -> None:
    with bench_in(tmp_path) as bench:
        recorder = driving(bench)
        (run,) = (bench.folder / "runs").iterdir()
        elsewhere = tmp_path / "elsewhere"
        elsewhere.mkdir()
        rig = (bench.folder / "rig.toml").read_text()
        (elsewhere / "rig.toml").write_text(rig.replace(bench.uri, NOBODY))
        with watching(bench, run, "--campaign", elsewhere) as port:
            answer = press(port)
            wait_until(lambda: not any(bench.motors), "the motors' stop")
        recorder.end()
    assert answer["stopped"], answer
    assert f"{bench.uri}: motors stopped, confirmed in" in str(answer["text"])


def test_a_vehicle_that_rig_toml_does_not_name_any_more_is_stopped_and_the_page_names_it(tmp_path: Path) -> None:
    with bench_in(tmp_path) as bench:
        recorder = driving(bench)
        rig = bench.folder / "rig.toml"
        rig.write_text(rig.read_text().replace(bench.uri, NOBODY))
        with watching(bench) as port:
            answer = press(port)
            facts = ask(port, "GET", "/facts")
            wait_until(lambda: not any(bench.motors), "the motors' stop")
        recorder.end()
    assert f'<th>the button stops</th><td class="">{bench.uri}</td>' in facts
    assert answer["stopped"], answer


def test_a_stop_that_fails_says_that_motors_may_run(tmp_path: Path) -> None:
    with bench_in(tmp_path) as bench:
        recorder = driving(bench)
        (run,) = (bench.folder / "runs").iterdir()
        file = run / "run.toml"
        file.write_text(file.read_text().replace(bench.uri, NOBODY))  # where no program listens
        with watching(bench, run) as port:
            answer = press(port)
        assert not answer["stopped"], (answer, file.read_text()[:900])
        assert "THE MOTORS MAY STILL BE RUNNING. KEEP CLEAR AND PULL THE BATTERY" in str(answer["text"])
        recorder.send(signal.SIGINT)
        recorder.end()


def test_a_sine_drives_the_vehicle_that_its_run_states_whatever_rig_toml_names(tmp_path: Path) -> None:
    """A sine records no commands: its crossings, log and supervisor state name the vehicle."""
    with bench_in(tmp_path) as bench:
        rig = bench.folder / "rig.toml"
        rig.write_text(rig.read_text().replace(bench.uri, NOBODY))
        recorder = bench.start("log", "sine", "--l", 100, "--n", 12000, "--uri", bench.uri, "--yes")
        recorder.wait_until_motors_run()
        (run,) = (bench.folder / "runs").iterdir()
        with watching(bench, run) as port:
            facts = ask(port, "GET", "/facts")
            answer = press(port)
            wait_until(lambda: not any(bench.motors), "the motors' stop")
        recorder.end()
    assert f'<th>the button stops</th><td class="">{bench.uri}</td>' in facts
    assert answer["stopped"], answer


def test_the_vehicles_of_all_runs_that_are_recorded_in_the_campaign_are_stopped(tmp_path: Path) -> None:
    """The page shows the newer run, in which no motor turns."""
    folders = tmp_path / "shown", tmp_path / "other"
    for folder in folders:
        folder.mkdir()
    with bench_in(folders[0]) as bench, bench_in(folders[1]) as other:
        bench.environment["CFID_LOCKS"] = other.environment["CFID_LOCKS"]
        other.folder = bench.folder
        recorder = other.start(*RECORDED, "--uri", other.uri)
        recorder.wait_until_motors_run()
        gyro = bench.start("log", "gyro", "--for", 600)
        bench.wait_until(lambda: any((bench.folder / "runs").glob("*gyro/crazyflie.csv")), gyro)
        (shown,) = (bench.folder / "runs").glob("*gyro")
        with watching(bench, shown) as port:
            facts = ask(port, "GET", "/facts")
            answer = press(port)
            wait_until(lambda: not any(other.motors), "the motors' stop")
        for pilot in (recorder, gyro):
            pilot.end()
    assert f'<th>the button stops</th><td class="">{bench.uri}, {other.uri}</td>' in facts
    assert answer["stopped"], answer
    assert [line.partition(": ")[0] for line in str(answer["text"]).splitlines()] == [bench.uri, other.uri]
