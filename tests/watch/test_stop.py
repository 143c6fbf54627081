"""The page's button stops the vehicle that the shown run drives, whichever vehicle the local campaign names."""

import html
import http.client
import json
import re
import signal
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from cfid.records.rig_file import new_rig_text
from cfid.records.run import read_run
from cfid.watch.door import Door
from cfid.watch.live_run import ShownRun
from cfid.watch.stop import MotorStop, StopReport
from tests.flying_in_a_folder import Bench, Pilot, bench_in
from tests.rig_in_a_folder import wait_until

pytestmark = pytest.mark.usefixtures("in_time")

RECORDED = ("log", "thrust", "--from", 30000, "--to", 30000, "--hold", 600, "--rest", 0.3, "--rate-hz", 700, "--yes")
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


def ask(port: int, method: str, path: str, **headers: str) -> tuple[int, str]:
    """Return the status and the text of the answer to a program that can send any headers."""
    line = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    try:
        line.request(method, path, headers={name.replace("_", "-"): text for name, text in headers.items()}, body=b"")
        answer = line.getresponse()
        return answer.status, answer.read().decode()
    finally:
        line.close()


def token_of(port: int) -> str:
    """Load a page and return its token."""
    token = re.search(r'data-token="([^"]+)"', ask(port, "GET", "/")[1])
    assert token is not None
    return token[1]


def facts_of(port: int) -> str:
    """Return the facts as the page shows them."""
    return ask(port, "GET", "/facts", X_Cfid_Token=token_of(port))[1]


def named(*vehicles: str) -> str:
    """Return the cell that names the vehicles which the button stops."""
    return f'<td class="">{", ".join(vehicles)}</td>'


def press(port: int, token: str = "") -> dict[str, object]:
    """Press the button of a page, which was loaded before where its token is given, and return the answer."""
    origin = f"http://127.0.0.1:{port}"
    _, text = ask(port, "POST", "/stop", Origin=origin, X_Cfid_Token=token or token_of(port))
    answer: dict[str, object] = json.loads(text)
    return answer


@contextmanager
def two_benches(folder: Path) -> Iterator[tuple[Bench, Bench]]:
    """Open two campaigns on one computer, with a vehicle each."""
    folders = folder / "shown", folder / "other"
    for own in folders:
        own.mkdir()
    with bench_in(folders[0]) as bench, bench_in(folders[1]) as other:
        bench.environment["CFID_LOCKS"] = other.environment["CFID_LOCKS"]
        yield bench, other


def driving(bench: Bench, *words: object) -> Pilot:
    recorder = bench.start(*(words or RECORDED))
    recorder.wait_until_motors_run()
    return recorder


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


def test_the_vehicles_of_all_runs_that_are_recorded_in_the_campaign_are_stopped(tmp_path: Path) -> None:
    """The page shows the newer run, in which no motor turns."""
    with two_benches(tmp_path) as (bench, other):
        other.folder = bench.folder
        recorder = driving(other, *RECORDED, "--uri", other.uri)
        gyro = bench.start("log", "gyro", "--for", 600)
        bench.wait_until(lambda: any((bench.folder / "runs").glob("*gyro/crazyflie.csv")), gyro)
        (shown,) = (bench.folder / "runs").glob("*gyro")
        with watching(bench, shown) as port:
            facts = facts_of(port)
            answer = press(port)
            wait_until(lambda: not any(other.motors), "the motors' stop")
        for pilot in (recorder, gyro):
            pilot.end()
    assert named(bench.uri, other.uri) in facts
    assert answer["stopped"], answer
    stopped = [line.partition(": ")[0] for line in str(answer["text"]).splitlines() if "motors stopped" in line]
    assert stopped == [bench.uri, other.uri], answer  # a busy computer's page also names the process that still writes


def test_a_stop_waits_for_no_page_load() -> None:
    """Here no load is ever answered, as by a page that hangs."""
    door = Door(0)
    port = door.server_address[1]
    passed: list[socket.socket] = []
    door.open(AtOnce(), lambda connection, *_: passed.append(connection))
    loads = [socket.create_connection(("127.0.0.1", port)) for _ in range(100)]
    for load in loads:
        load.sendall(f"GET {PLOTS} HTTP/1.1\r\n\r\n".encode())
    wait_until(lambda: len(passed) == len(loads), "the loads' arrival")
    answer = press(port, door.gate.token)
    door.shutdown()
    door.server_close()
    for connection in (*loads, *passed):
        connection.close()
    assert answer == {"stopped": True, "text": "confirmed"}


class AtOnce(MotorStop):
    """A stop of vehicles that confirm it at once."""

    def __init__(self) -> None:
        super().__init__(ShownRun(folder=None, runs_folder=None), None)

    def press(self) -> StopReport:
        """Return the confirmation."""
        return StopReport(True, "confirmed")


BROKEN, NOBODYS = "[vehicle\n", f"[devices.crazyflie]\nuri = '{NOBODY}'\n"
SINE = (
    "log",
    "sine",
    "--hz",
    "4.166667",
    "--for",
    24,
    "--yes",
)  # of which crossings, log and supervisor name the vehicle


@pytest.mark.parametrize(
    ("words", "content", "elsewhere"),
    [(RECORDED, BROKEN, False), (SINE, NOBODYS, True)],
)
def test_the_vehicle_of_the_run_is_named_and_stopped_whatever_any_rig_toml_states(
    tmp_path: Path, words: tuple[object, ...], content: str, elsewhere: bool
) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (other / "rig.toml").write_text(NOBODYS)
    with bench_in(tmp_path) as bench:
        recorder = driving(bench, *words)
        (bench.folder / "rig.toml").write_text(content)
        (run,) = (bench.folder / "runs").iterdir()
        with watching(bench, *((run, "--campaign", other) if elsewhere else ())) as port:
            facts = facts_of(port)
            answer = press(port)
            wait_until(lambda: not any(bench.motors), "the motors' stop")
            recorder.end()
            ended = facts_of(port)
        (bench.folder / "rig.toml").write_text(new_rig_text())
        runs = bench.start("runs")
        assert runs.end() == 0, runs.err
    reason = read_run(run).header.reason
    assert re.fullmatch(r"stopped by the page's button after [\d.]+ s", reason)
    for text in (html.unescape(ended), recorder.out + recorder.err, runs.out):
        assert reason in " ".join(text.split())
    assert named(bench.uri) in facts
    assert answer["stopped"], answer
