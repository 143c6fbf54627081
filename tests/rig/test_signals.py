"""`cfid rig check --signals` and the look before motors turn: faults of signals are named before a recording."""

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from cfid.console.signals import judged
from cfid.estimate.battery_endurance import Held
from cfid.records.files import RIG_FILE, RUNS_FOLDER
from cfid.records.rig_file import CheckLimits
from cfid.records.run import DeviceRecord
from cfid.rig.check import DeviceAnswer
from cfid.rig.recorder import Sampled
from tests.virtual_bench import Bench, Pilot, bench_in
from tests.virtual_lab import Lab, lab_in

Array = npt.NDArray[np.float64]

STAIRS = ("log", "thrust", "--from", 20000, "--to", 20000, "--hold", 1, "--rest", 0.5)
FULL: dict[str, Any] = {"battery": {"kind": "lipo"}}


def answers(pilot: Pilot, device: str) -> dict[str, dict[str, str]]:
    """Return what was answered about a device, by what was asked."""
    return {answer["asked"]: answer for answer in json.loads(pilot.out)["devices"][device]}


def shake(bench: Bench, hz: float, amplitude_n: float) -> None:
    """Shake the stand from now on."""
    cell = bench.rig.loadcell.box.load_cell
    read = cell.read

    def shaken(time_s: Array, wrench: Array) -> Any:
        wave = amplitude_n * np.sin(2 * np.pi * hz * time_s)
        return read(time_s, wrench + np.outer(wave, [1, 0, 0, 0, 0, 0]))

    cell.read = shaken  # type: ignore[method-assign]


def limit(bench: Bench, text: str) -> None:
    """State limits in rig.toml."""
    rig = bench.folder / RIG_FILE
    rig.write_text(f"{rig.read_text()}\n[check]\n{text}\n")


# The whole check


def test_a_sound_rig_is_within_every_limit_and_no_motor_turns(tmp_path: Path) -> None:
    with bench_in(tmp_path, **FULL) as bench:
        pilot = bench.start("rig", "check", "--signals", "--for", 2, "--json")
        pilot.end()
        assert len(bench.history) == 1
    cell, vehicle = (list(answers(pilot, name).values()) for name in ("loadcell", "crazyflie"))
    assert [answer["asked"] for answer in cell[-5:]] == ["rate", "losses", "load", "noise", "drift"]
    assert [answer["asked"] for answer in vehicle[-2:]] == ["losses", "charge"]
    assert {answer["state"] for answer in cell[-5:] + vehicle[-2:]} == {"ok"}
    assert all(answer["limit"] for answer in cell[-5:] + vehicle[-2:])
    assert not (tmp_path / RUNS_FOLDER).exists()


def test_noise_is_a_fault_with_its_axis_size_limit_and_remedy(tmp_path: Path) -> None:
    with bench_in(tmp_path, **FULL) as bench:
        shake(bench, 137.0, 0.04)
        pilot = bench.start("rig", "check", "--signals", "--for", 2, "--json")
        assert pilot.end() == 3
    noise = answers(pilot, "loadcell")["noise"]
    axis, size_mn, unit, *_ = noise["answer"].split()
    assert (noise["state"], axis, unit, noise["limit"]) == ("fault", "Fx", "mN,", "0.10%")
    assert float(size_mn) == pytest.approx(40 / math.sqrt(2), rel=0.1)
    assert noise["advice"]


def test_rig_toml_sets_the_limits(tmp_path: Path) -> None:
    with bench_in(tmp_path, **FULL) as bench:
        shake(bench, 137.0, 0.04)
        limit(bench, "noise = 0.003\nbattery_v = 4.3")
        pilot = bench.start("rig", "check", "--signals", "--for", 2, "--json")
        pilot.end()
    assert answers(pilot, "loadcell")["noise"]["state"] == "ok"
    assert answers(pilot, "crazyflie")["charge"]["state"] == "warning"


def test_a_limit_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    with bench_in(tmp_path, **FULL) as bench:
        limit(bench, "noise_n = 0.1")
        pilot = bench.start("rig", "check", "--signals")
        assert pilot.end() == 2
        assert "check.noise_n" in pilot.err


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    with lab_in(tmp_path) as lab:
        yield lab


@pytest.mark.parametrize(
    ("angle_at", "beyond"),
    [
        (lambda time_s: 0.5, {}),
        (lambda time_s: 0.5 * time_s, {"noise": "warning", "drift": "fault"}),
        (lambda time_s: math.radians(6) * math.sin(8 * time_s), {"noise": "warning"}),
    ],
    ids=["still", "turning", "swinging"],
)
def test_a_pendulum_has_to_hang_still(lab: Lab, angle_at: Callable[[float], float], beyond: dict[str, str]) -> None:
    lab.e201._angle_at = angle_at
    ended = lab.cfid("rig", "check", "--signals", "--for", 3, "--json")
    encoder = {answer["asked"]: answer for answer in json.loads(ended.out)["devices"]["encoder"]}

    assert {asked: answer["state"] for asked, answer in encoder.items() if answer["state"] != "ok"} == beyond
    assert {"rate", "losses"} <= encoder.keys()


def test_a_device_that_falls_silent_is_a_fault(lab: Lab) -> None:
    lab.loadcell_suffers(silent_after_s=1.5)
    ended = lab.cfid("rig", "check", "--signals", "--for", 5, "--json")
    cell = {answer["asked"]: answer["state"] for answer in json.loads(ended.out)["devices"]["loadcell"]}

    assert ended.code == 3
    assert cell["signals"] == "fault"


# What is judged


def facts(device: str, columns: dict[str, Array], *, lost: int | None = 0, **record: Any) -> dict[str, DeviceAnswer]:
    """Return the answers about a device with the usual limits."""
    stated = DeviceRecord(file=f"{device}.csv", columns=tuple(columns), **record)
    (own,) = judged({device: stated}, {device: Sampled(columns, lost)}, CheckLimits(), supply=False).values()
    return {answer.asked: answer for answer in own}


@pytest.mark.parametrize("rate_hz", [1.0, 5.0, 10.0, 80.0])
def test_slow_scales_that_keep_their_stated_rate_are_ready(rate_hz: float) -> None:
    time_s = np.arange(round(10 * rate_hz)) / rate_hz
    found = facts("loadcell", {"t": time_s, "Fz": np.resize([0.1, 0.101, 0.102], len(time_s))}, rate_hz=rate_hz)

    assert [found[asked].state for asked in ("rate", "losses", "noise", "drift")] == ["ok"] * 4


@pytest.mark.parametrize(
    ("rate_hz", "lost", "fault"), [(12.0, 0, "rate"), (10.0, 20, "losses"), (10.0, None, "losses")]
)
def test_a_low_rate_and_losses_are_faults(rate_hz: float, lost: int | None, fault: str) -> None:
    found = facts("loadcell", {"t": np.arange(100) / 10, "Fz": np.zeros(100)}, rate_hz=rate_hz, lost=lost)

    assert {asked for asked, answer in found.items() if answer.state == "fault"} == {fault}


def test_a_silent_device_is_a_fault() -> None:
    assert facts("loadcell", {"t": np.zeros(0)}, rate_hz=10)["rate"].state == "fault"


def angles(degrees: Array) -> dict[str, DeviceAnswer]:
    return facts("encoder", {"t": np.arange(len(degrees)) / 1000, "phi": degrees}, rate_hz=1000, counts_per_turn=360)


def test_a_drift_that_noise_explains_is_no_fault_and_a_clear_one_is() -> None:
    rng = np.random.default_rng(1)
    hidden = [angles(rng.normal(0, 3, 2000))["drift"].state for _ in range(50)]
    clear = angles(rng.normal(0, 0.05, 2000) + np.linspace(0, 0.4, 2000))["drift"]

    assert hidden.count("fault") <= 2
    assert clear.state == "fault"
    assert float(clear.answer.split()[0]) == pytest.approx(0.4, rel=0.1)


@pytest.mark.parametrize(("volts", "state"), [(4.1, "ok"), (3.75, "warning"), (5.0, "ok")])
def test_a_battery_has_to_last_for_the_plan(volts: float, state: str) -> None:
    columns = {"t": np.arange(100) / 100, "pm.vbat": np.full(100, volts)}
    stated = DeviceRecord(file="crazyflie.csv", columns=tuple(columns))
    plan = [Held(30000, 4, 300.0)]
    sampled = {"crazyflie": Sampled(columns)}
    (own,) = judged({"crazyflie": stated}, sampled, CheckLimits(), plan=plan, supply=False).values()
    (on_supply,) = judged({"crazyflie": stated}, sampled, CheckLimits(), plan=plan, supply=True).values()

    assert own[-1].state == state
    assert on_supply[-1].state == "ok"


# Before each recording with motors


@pytest.mark.parametrize(
    ("battery", "charge_it"),
    [({"kind": "lipo"}, False), ({"kind": "lipo", "charge": 0.1}, True), ({"kind": "supply", "volts": 3.7}, False)],
    ids=["full", "low", "supply"],
)
def test_a_battery_too_small_for_the_plan_is_noted_before_the_question(
    tmp_path: Path, battery: dict[str, Any], charge_it: bool
) -> None:
    with bench_in(tmp_path, battery=battery) as bench:
        pilot = bench.start("log", "thrust", "--from", 20000, "--to", 20000, "--hold", 250)
        assert pilot.end() == 2
        assert len(bench.history) == 1
    before, _, question = pilot.err.partition("will turn at commands")
    assert ("charge it" in before) == charge_it
    assert "4:11 min" in question


def test_a_cell_near_its_range_is_not_recorded_unless_nobody_looks(tmp_path: Path) -> None:
    with bench_in(tmp_path, **FULL) as bench:
        cell = bench.rig.loadcell.box.load_cell
        cell._unloaded[2] = 0.9 * cell._ranges[2]
        refused = bench.start(*STAIRS, "--yes")
        assert refused.end() == 3
        assert "Fz" in refused.err
        assert len(bench.history) == 1
        assert bench.start(*STAIRS, "--yes", "--no-preflight").end() == 0


def test_what_only_disturbs_is_noted_and_the_recording_goes_on(tmp_path: Path) -> None:
    with bench_in(tmp_path, **FULL) as bench:
        shake(bench, 137.0, 0.06)
        pilot = bench.start(*STAIRS, "--yes")
        assert pilot.end() == 0, pilot.err
        assert "loadcell, noise" in pilot.err
        assert bench.run().header.state == "complete"
