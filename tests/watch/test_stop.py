"""The page's button stops the vehicle that the shown run drives, whichever vehicle the local campaign names."""

import http.client
import json
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.cli.test_foreign_modules import planted
from tests.flying_in_a_folder import Bench, Pilot, bench_in
from tests.rig_in_a_folder import wait_until

pytestmark = pytest.mark.usefixtures("in_time")

RECORDED = ("log", "thrust", "--from", 30000, "--to", 30000, "--hold", 600, "--rest", 0.3, "--yes")
PLOTS = "/plots/autoload.js?bokeh-autoload-element=x&bokeh-app-path=/plots"
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


def token_of(port: int) -> str:
    """Load a page and return its token."""
    token = re.search(r'data-token="([^"]+)"', ask(port, "GET", "/"))
    assert token is not None
    return token[1]


def facts_of(port: int) -> str:
    """Return the facts as the page shows them."""
    return ask(port, "GET", "/facts", X_Cfid_Token=token_of(port))


def press(port: int, token: str = "") -> dict[str, object]:
    """Press the button of a page, which was loaded before where its token is given, and return the answer."""
    token = token or token_of(port)
    answer: dict[str, object] = json.loads(
        ask(port, "POST", "/stop", Origin=f"http://127.0.0.1:{port}", X_Cfid_Token=token)
    )
    return answer


@contextmanager
def loading(port: int, clients: int) -> Iterator[list[int]]:
    """Let clients load the plots of a page again and again, each with the headers of the page's own browser.

    Yield the statuses of the answers.
    """
    ended, statuses = threading.Event(), list[int]()

    def load() -> None:
        while not ended.is_set():
            line = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
            try:
                headers = {"Sec-Fetch-Site": "same-origin"}
                line.request(
                    "GET", "/plots/autoload.js?bokeh-autoload-element=x&bokeh-app-path=/plots", headers=headers
                )
                answer = line.getresponse()
                answer.read()
                statuses.append(answer.status)
            except OSError:
                time.sleep(0.05)
            finally:
                line.close()

    threads = [threading.Thread(target=load) for _ in range(clients)]
    for thread in threads:
        thread.start()
    try:
        time.sleep(1.0)
        yield statuses
    finally:
        ended.set()
        for thread in threads:
            thread.join(60)


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
            facts = facts_of(port)
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
            facts = facts_of(port)
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
            facts = facts_of(port)
            answer = press(port)
            wait_until(lambda: not any(other.motors), "the motors' stop")
        for pilot in (recorder, gyro):
            pilot.end()
    assert f'<th>the button stops</th><td class="">{bench.uri}, {other.uri}</td>' in facts
    assert answer["stopped"], answer
    stopped = [line.partition(": ")[0] for line in str(answer["text"]).splitlines() if "motors stopped" in line]
    assert stopped == [bench.uri, other.uri], answer  # a busy computer's page also names the process that still writes


@pytest.mark.parametrize("clients", [20, 30])
def test_page_loads_delay_no_stop(tmp_path: Path, clients: int) -> None:
    """Stock firmware goes on with its motors whatever happens to the program that drives them."""
    with bench_in(tmp_path, crazyflie={"firmware": "stock"}) as bench:
        recorder = driving(bench)
        with watching(bench) as port:
            token = token_of(port)
            with loading(port, clients) as statuses:
                assert any(bench.motors)
                began_s = time.monotonic()
                answer = press(port, token)
                answered_s = time.monotonic() - began_s
                stopped_s = bench.stopped_after(began_s)
        recorder.end()
    print(f"{clients} clients: motors off after {stopped_s:.2f} s, answered after {answered_s:.2f} s")
    assert answer["stopped"], answer
    assert stopped_s < 3.0
    assert 0 < statuses.count(200) <= 16  # the others are refused, so that the page itself still works


def test_the_vehicle_that_another_program_drives_is_not_stopped(tmp_path: Path) -> None:
    """The page shows a finished run of one campaign, while another campaign's program drives its own vehicle."""
    folders = tmp_path / "shown", tmp_path / "other"
    for folder in folders:
        folder.mkdir()
    with bench_in(folders[0]) as bench, bench_in(folders[1]) as other:
        bench.environment["CFID_LOCKS"] = other.environment["CFID_LOCKS"]
        rig = bench.folder / "rig.toml"
        rig.write_text(rig.read_text().replace(f"uri = '{bench.uri}'", ""))  # as where a radio finds the vehicle
        encoder = bench.start("log", "gyro", "--for", 0.3, "--uri", bench.uri)
        assert encoder.end() == 0, encoder.err
        pilot = other.start("motors", "set", 30000, "--yes")
        pilot.wait_until_motors_run()
        with watching(bench) as port:
            facts = facts_of(port)
            answer = press(port)
        assert any(other.motors), answer
        pilot.send(signal.SIGINT)
        assert pilot.end() == 0, pilot.err
    assert f'<th>the button stops</th><td class="">{bench.uri}</td>' in facts
    assert answer["stopped"], answer
    assert str(answer["text"]).startswith(f"{bench.uri}: motors stopped")


def test_where_no_run_has_a_vehicle_nobody_elses_is_stopped_and_the_held_ones_are_named(tmp_path: Path) -> None:
    folders = tmp_path / "shown", tmp_path / "other"
    for folder in folders:
        folder.mkdir()
    with bench_in(folders[0]) as bench, bench_in(folders[1]) as other:
        bench.environment["CFID_LOCKS"] = other.environment["CFID_LOCKS"]
        rig = bench.folder / "rig.toml"
        rig.write_text(rig.read_text().replace(f"uri = '{bench.uri}'", ""))
        pilot = other.start("motors", "set", 30000, "--yes")
        pilot.wait_until_motors_run()
        with watching(bench) as port:
            answer = press(port)
        assert any(other.motors), answer
        pilot.send(signal.SIGINT)
        assert pilot.end() == 0, pilot.err
    assert not answer["stopped"]
    assert f"cfid motors stop --uri {other.uri}" in str(answer["text"])


@pytest.mark.parametrize("content", ["[vehicle\n", "[devices.crazyflie]\nuri = 5\n"])
def test_a_page_with_a_broken_rig_toml_opens_and_stops(tmp_path: Path, content: str) -> None:
    with bench_in(tmp_path) as bench:
        recorder = driving(bench)
        (bench.folder / "rig.toml").write_text(content)
        with watching(bench) as port:
            facts = facts_of(port)
            answer = press(port)
            wait_until(lambda: not any(bench.motors), "the motors' stop")
        recorder.end()
    assert f'<th>the button stops</th><td class="">{bench.uri}</td>' in facts
    assert answer["stopped"], answer


def test_the_stop_runs_no_file_of_the_folder_that_bears_the_name_of_a_module(tmp_path: Path) -> None:
    folders = tmp_path / "here", tmp_path / "campaign"
    for folder in folders:
        folder.mkdir()
    with bench_in(folders[1]) as bench:
        recorder = driving(bench)
        (run,) = (bench.folder / "runs").iterdir()
        ran = [planted(folder) for folder in folders]
        for where in folders:
            words = [sys.executable, "-P", "-m", "cfid.cli.main", "watch", str(run)]
            with subprocess.Popen(
                words, cwd=where, env=bench.environment, stderr=subprocess.PIPE, text=True
            ) as watcher:
                assert watcher.stderr is not None
                address = re.search(r":(\d+)/", watcher.stderr.readline())
                assert address is not None
                answer = press(int(address[1]))
                watcher.send_signal(signal.SIGINT)
            assert answer["stopped"], answer
            assert not any(bench.motors)
        recorder.end()
    assert not any(file.exists() for file in ran)
