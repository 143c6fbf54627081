"""A tachometer and scales that send lines during a staircase: `fit speed` and `--verify` read these lines."""

import json
import math
import os
import re
import signal
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pandas as pd
import pytest

from cfid.records.rig_file import load_rig
from cfid.records.run import read_run
from cfid.rig.motors import Four
from tests.campaigns import in_this_process
from tests.flying_in_a_folder import Bench, bench_in

STAIRCASE = ("--from", 20000, "--to", 50000, "--step", 10000, "--hold", 1.5, "--rest", 0.8, "--yes")
IDLE_RAD_PER_S, RAD_PER_S_PER_COMMAND = 381.0, 0.0408  # of the simulated rotors
DEVICE = "\n[devices.{name}]\nkind = 'lines'\nport = '{port}'\nrate_hz = 20\nvalues = [{{ name = '{value}' }}]\n"


@contextmanager
def sending(bench: Bench, name: str, line: Callable[[Four], str]) -> Iterator[Path]:
    """Serve a device at a pseudo terminal that sends twenty lines per second, which depend on the motors' commands."""
    host, device = os.openpty()
    tty.setraw(host)
    tty.setraw(device)
    link, over = bench.folder / name, threading.Event()
    link.symlink_to(os.ttyname(device))

    def send() -> None:
        while not over.wait(0.05):
            with suppress(OSError):
                os.write(host, f"{line(bench.motors)}\r\n".encode())

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield link
    finally:
        over.set()
        thread.join()
        os.close(host)
        os.close(device)


@contextmanager
def showing(bench: Bench, name: str, value: str, shown: Callable[[Four], float], more: str = "") -> Iterator[None]:
    """Serve such a device, with a number in each line, and add it to rig.toml."""
    with sending(bench, name, lambda motors: f"{shown(motors):.1f}") as link:
        with (bench.folder / "rig.toml").open("a") as file:
            file.write(DEVICE.format(name=name, port=link, value=value) + more)
        yield


def rpm(motors: Four) -> float:
    """Return what a tachometer shows of a rotor; the last speed stays on display while the rotor stands."""
    speed = IDLE_RAD_PER_S + RAD_PER_S_PER_COMMAND * (motors[0] or 50000)
    return speed * 60 / math.tau


@pytest.mark.parametrize("markers", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_a_speed_map_is_fitted_to_what_a_tachometer_sent_as_lines_by_its_own_markers(
    tmp_path: Path, markers: int
) -> None:
    """One device sends the rotor's speed and one counts both blades, while a hand-held one has two markers."""
    with (
        bench_in(tmp_path) as bench,
        showing(bench, "tachometer", "rpm", lambda motors: markers * rpm(motors), f"markers = {markers}"),
    ):
        assert load_rig(bench.folder / "rig.toml").tachometer.markers == 2
        pilot = bench.start("log", "speed", "--tachometer", "lines", *STAIRCASE)
        assert pilot.end() == 0, pilot.err
        fitted = in_this_process(["fit", "speed", str(bench.run().folder), "--json", "--no-figures"], tmp_path)

    assert f"counts {markers} marker{'s'[: markers - 1]} a turn" in " ".join(pilot.out.split())
    assert fitted.returncode == 0, fitted.stderr
    slope, offset = json.loads(fitted.stdout)["parameters"]["motor.speed_poly"]["value"]
    assert slope == pytest.approx(RAD_PER_S_PER_COMMAND, rel=1e-3)
    assert offset == pytest.approx(IDLE_RAD_PER_S, rel=1e-3)


@pytest.mark.parametrize(("share", "reason"), [(0.5, "the speeds are 0.50 times"), (4.0, "implausible at 65535 cmd")])
def test_speeds_of_a_tachometer_that_the_fit_rejects_are_of_no_use_at_once(
    tmp_path: Path, share: float, reason: str
) -> None:
    short = ("--from", 20000, "--to", 40000, "--step", 20000, "--hold", 1, "--rest", 0.5, "--yes")
    with (
        bench_in(tmp_path) as bench,
        showing(bench, "tachometer", "rpm", lambda motors: share * rpm(motors), "markers = 1"),
    ):
        pilot = bench.start("log", "speed", "--tachometer", "lines", *short)
        assert pilot.end() == 0, pilot.err
        fitted = in_this_process(["fit", "speed", str(bench.run().folder), "--json", "--no-figures"], tmp_path)

    verdict = bench.run().header.verdict
    assert verdict is not None
    assert not verdict.usable
    assert reason in verdict.text
    assert fitted.returncode == 5
    assert reason in fitted.stderr


def test_no_motor_starts_before_a_line_of_the_tachometer_matches(tmp_path: Path) -> None:
    with bench_in(tmp_path) as bench, sending(bench, "tachometer", lambda motors: "28187500,83943") as link:
        with (bench.folder / "rig.toml").open("a") as file:
            file.write(DEVICE.format(name="tachometer", port=link, value="rpm") + "markers = 1\n")
        pilot = bench.start("log", "speed", "--tachometer", "lines", *STAIRCASE)
        assert pilot.end() == 3, pilot.err

    run, said = bench.run(), " ".join(pilot.err.split())
    assert not pd.read_csv(run.device_file("commands"))[["m1", "m2", "m3", "m4"]].to_numpy().any()
    assert "compare baud, pattern and values of devices.tachometer in rig.toml with what it sends" in said


def test_a_first_line_that_comes_late_delays_the_staircase_and_costs_no_step(tmp_path: Path) -> None:
    recording_s: list[float] = []

    def late(motors: Four) -> str:
        """Send lines only two seconds after the recording began, like a board that restarts."""
        if any(tmp_path.glob("runs/*_speed")):
            recording_s.append(time.monotonic())
        return f"{rpm(motors):.1f}" if recording_s and recording_s[-1] - recording_s[0] > 2 else "starting"

    with bench_in(tmp_path) as bench, sending(bench, "tachometer", late) as link:
        with (bench.folder / "rig.toml").open("a") as file:
            file.write(DEVICE.format(name="tachometer", port=link, value="rpm") + "markers = 1\n")
        pilot = bench.start("log", "speed", "--tachometer", "lines", *STAIRCASE)
        assert pilot.end() == 0, pilot.err

    commands = pd.read_csv(bench.run().device_file("commands"))
    shown = pd.read_csv(bench.run().device_file("tachometer"))
    assert shown["t"].iloc[0] < commands["t"][commands["m1"] > 0].iloc[0]
    assert sorted(set(commands["m1"])) == [0, 20000, 30000, 40000, 50000]


def grams(motors: Four) -> float:
    return 50 - 1e3 * sum(map(thrust_n, motors)) / 9.81


def thrust_n(command: int) -> float:
    return 1.8e-8 * (IDLE_RAD_PER_S + RAD_PER_S_PER_COMMAND * command) ** 2 if command else 0.0


def test_a_thrust_map_is_verified_by_what_scales_sent_as_lines(tmp_path: Path) -> None:
    rows = [f"{command},{thrust_n(command):.6f}" for command in range(16000, 60000, 4000)]
    (tmp_path / "forces.csv").write_text("\n".join(["cmd,thrust_n", "0,0", *rows]) + "\n")
    with bench_in(tmp_path) as bench, showing(bench, "scales", "grams", grams):
        pilot = bench.start("log", "scales", *STAIRCASE)
        assert pilot.end() == 0, pilot.err
        words = ["fit", "thrust", "forces.csv", "--verify", str(bench.run().folder), "--no-figures"]
        fitted = in_this_process(words, tmp_path)

    assert fitted.returncode == 0, fitted.stderr
    (verified,) = re.findall(r"verification: (\d+) readings, .* at most ([0-9.]+) mN from the map", fitted.stdout)
    assert int(verified[0]) == 9
    assert float(verified[1]) < 1
    verdict = bench.run().header.verdict
    assert verdict is not None
    assert re.match(r"the scales show 4\d[.\d]* g at command 20000 and [23]\d[.\d]* at command 50000\.", verdict.text)


def test_scales_at_a_port_are_resumed_at_it(tmp_path: Path) -> None:
    steps = ("--from", 0, "--to", 40000, "--step", 20000, "--hold", 1.5, "--rest", 0.8)
    with (
        bench_in(tmp_path) as bench,
        sending(bench, "scales", lambda motors: f"ST,GS,{grams(motors):+08.2f} g") as port,
    ):
        pilot = bench.start("log", "scales", "--port", port, "--baud", 19200, *steps, *STAIRCASE[-1:])
        bench.wait_until(lambda: bench.motors[0] == 40000 or pilot.process.poll() is not None, pilot)
        pilot.send(signal.SIGINT)
        assert pilot.end() == 0, pilot.err
        first = bench.run()
        again = bench.start("log", "scales", "--resume", first.folder, *STAIRCASE[-1:])
        assert again.end() == 0, again.err
        second = max(map(read_run, (bench.folder / "runs").iterdir()), key=lambda run: run.folder.name)

    assert second.header.requested["steps"] == [40000]
    for name in ("port", "baud"):
        assert (second.header.devices["scales"].model_extra or {})[name] == (
            first.header.devices["scales"].model_extra or {}
        )[name]
    assert second.header.verdict is not None
    assert second.header.verdict.usable
