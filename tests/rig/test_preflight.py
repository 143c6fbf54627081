"""`cfid rig preflight` and its quick part: faults of the signals are named before anything is recorded."""

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from cfid.console.preflight import of_encoder
from cfid.records.files import RIG_FILE, RUNS_FOLDER
from cfid.records.run import DeviceRecord
from cfid.rig.check import DeviceAnswer
from cfid.rig.recorder import Sampled
from tests.virtual_bench import Bench, Pilot, bench_in
from tests.virtual_lab import Lab, lab_in

Array = npt.NDArray[np.float64]

STAIRS = ("log", "thrust", "--from", 20000, "--to", 20000, "--hold", 1, "--rest", 0.5)
FULL: dict[str, Any] = {"battery": {"kind": "lipo"}}


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    with lab_in(tmp_path) as lab:
        yield lab


def shakes(bench: Bench, hz: float, amplitude_n: float) -> None:
    """Shake the stand from now on."""
    cell = bench.rig.loadcell.box.load_cell
    read = cell.read

    def shaken(time_s: Array, wrench: Array) -> Any:
        wave = amplitude_n * np.sin(2 * np.pi * hz * time_s)
        return read(time_s, wrench + np.outer(wave, [1, 0, 0, 0, 0, 0]))

    cell.read = shaken  # type: ignore[method-assign]


def fill_fz(bench: Bench, share: float) -> None:
    """Load Fz up to a share of its range."""
    cell = bench.rig.loadcell.box.load_cell
    cell._unloaded[2] = share * cell._ranges[2]


# The whole preflight


def answers(pilot: Pilot, device: str) -> dict[str, dict[str, str]]:
    """Return what was answered about a device, by what was asked."""
    return {answer["asked"]: answer for answer in json.loads(pilot.out)["devices"][device]}


def sample_at(bench: Bench, rate_hz: int) -> None:
    rig = bench.folder / RIG_FILE
    rig.write_text(rig.read_text().replace("rate_hz = 700\n", f"rate_hz = {rate_hz}\n"))


def test_a_sound_rig_is_ready_with_every_line_within_its_limit(tmp_path: Path) -> None:
    with bench_in(tmp_path, **FULL) as bench:
        pilot = bench.start("rig", "preflight", "--for", 2, "--no-balance", "--json")
        assert pilot.end() == 0, pilot.out
        assert len(bench.history) == 1
    cell = answers(pilot, "loadcell")
    assert list(cell)[-6:] == ["losses", "load", "noise", "drift", "mains", "other lines"]
    assert all(answer["limit"] for answer in list(cell.values())[-6:])
    assert list(answers(pilot, "crazyflie"))[-2:] == ["radio losses", "battery lasts"]
    assert list(answers(pilot, "disk")) == ["space"]
    assert not (tmp_path / RUNS_FOLDER).exists()


@pytest.mark.parametrize(("hz", "line"), [(50.0, "mains"), (137.0, "other lines")])
def test_a_line_is_named_with_its_limit_and_what_to_do(tmp_path: Path, hz: float, line: str) -> None:
    with bench_in(tmp_path, **FULL) as bench:
        shakes(bench, hz, 0.012)
        pilot = bench.start("rig", "preflight", "sine", "--for", 2, "--no-balance", "--json")
        assert pilot.end() == 3
    cell = answers(pilot, "loadcell")
    assert cell[line]["state"] == "fault"
    assert float(cell[line]["answer"].partition(",")[0]) == pytest.approx(12, rel=0.2)
    assert cell[line]["limit"].startswith("5, 5, 15 mN")
    assert cell[line]["advice"]
    assert ("137 Hz" in cell["other lines"]["answer"]) == (line == "other lines")


def test_a_low_battery_is_a_warning_that_says_how_long_it_lasts(tmp_path: Path) -> None:
    with bench_in(tmp_path) as bench:
        pilot = bench.start("rig", "preflight", "--for", 1, "--no-balance", "--json")
        assert pilot.end() == 0
    battery = answers(pilot, "crazyflie")["battery lasts"]
    assert battery["state"] == "warning"
    assert "3.70 V" in battery["answer"]
    assert battery["limit"] == "7:12 min, on a cell of 240 mAh"


def test_propellers_are_judged_once_the_operator_agrees_and_the_bad_one_is_named_alone(tmp_path: Path) -> None:
    with bench_in(tmp_path, **FULL, rotors={"unbalance_by_motor": (1.0, 1.0, 4.0, 1.0)}) as bench:
        refused = bench.start("rig", "preflight", "--for", 1, "--json")
        assert refused.end() == 0
        assert len(bench.history) == 1
        assert answers(refused, "rotors")["balance"]["state"] == "warning"
        sample_at(bench, 3500)
        pilot = bench.start("rig", "preflight", "--for", 1, "--yes", "--json")
        assert pilot.end() == 3
        assert not any(bench.motors)
    states = {asked: answer["state"] for asked, answer in answers(pilot, "rotors").items()}
    assert states == {"balance 1": "ok", "balance 2": "ok", "balance 3": "fault", "balance 4": "ok"}
    assert "motors stopped, confirmed in" in pilot.err


def test_after_a_look_at_the_balance_that_was_interrupted_the_vehicle_can_be_used(tmp_path: Path) -> None:
    with bench_in(tmp_path, **FULL) as bench:
        pilot = bench.start("rig", "preflight", "--for", 0.5, "--yes")
        pilot.wait_until_motors_run()
        pilot.request_end()
        assert pilot.end() == 130
        assert not any(bench.motors)
        turned = len(bench.history)
        again = bench.start(*STAIRS, "--yes")
        assert again.end() == 0, again.err
        assert any(any(motors) for _, motors in bench.history[turned:])
        assert not any(bench.motors)


def turning(lab: Lab, angle_at: Callable[[float], float]) -> tuple[int, dict[str, dict[str, str]]]:
    """Return the exit code for an encoder that turns so, and what was answered about it."""
    lab.e201._angle_at = angle_at
    ended = lab.cfid("rig", "preflight", "swing", "--for", 3, "--json")
    return ended.code, {answer["asked"]: answer for answer in json.loads(ended.out)["devices"]["encoder"]}


def test_a_pendulum_has_to_hang_still(lab: Lab) -> None:
    code, moving = turning(lab, lambda time_s: 0.5 * time_s)
    assert code == 3
    assert "fault" in {answer["state"] for answer in moving.values()}
    code, still = turning(lab, lambda time_s: 0.5)
    assert {still[asked]["state"] for asked in ("noise", "drift")} == {"ok"}
    code, swinging = turning(lab, lambda time_s: math.radians(6) * math.sin(8 * time_s))
    assert code == 0
    assert (swinging["at rest"]["state"], swinging["at rest"]["limit"]) == ("warning", "0.5 degrees")
    assert "12 degrees" in swinging["at rest"]["answer"]


def test_signals_too_short_to_judge_are_refused(lab: Lab) -> None:
    assert lab.cfid("rig", "preflight", "swing", "--for", 0.1).code == 2


def angles_judged(time_s: Array, degrees: Array) -> dict[str, DeviceAnswer]:
    record = DeviceRecord(file="encoder.csv", columns=("t", "phi"), rate_hz=1000, counts_per_turn=360)
    return {answer.asked: answer for answer in of_encoder(record, Sampled({"t": time_s, "phi": degrees}))}


@pytest.mark.parametrize("about", [lambda t: 0 * t, lambda t: 5 * t, lambda t: 8 * np.exp(-t)])
def test_noise_and_a_drift_are_faults_and_no_swing(about: Callable[[Array], Array]) -> None:
    time_s = np.arange(5000) / 1000
    found = angles_judged(time_s, about(time_s) + np.random.default_rng(2).normal(0, 0.3, len(time_s)))
    assert found["noise"].state == "fault"
    assert "at rest" not in found


def test_a_drift_beyond_its_limit_that_noise_hides_is_not_called_ok() -> None:
    time_s = np.arange(2000) / 1000
    found = angles_judged(time_s, np.random.default_rng(1).normal(0, 3, 2000) + 0.2 * time_s)
    assert (found["noise"].state, found["drift"].state) == ("fault", "warning")


# Before each recording with motors


@pytest.mark.parametrize(("battery", "is_enough"), [(FULL, True), ({}, False)])
def test_a_battery_that_is_too_small_for_the_plan_is_said_before_the_question(
    tmp_path: Path, battery: dict[str, Any], is_enough: bool
) -> None:
    with bench_in(tmp_path, **battery) as bench:
        pilot = bench.start("log", "thrust", *(STAIRS[2:] if is_enough else ()))
        assert pilot.end() == 2
        assert len(bench.history) == 1
    said, _, asked = pilot.err.partition("will turn at commands")
    assert ("charge it" in said) != is_enough
    assert ("0:02 min" if is_enough else "7:12 min") in asked


def test_a_cell_near_its_range_is_not_recorded_unless_nobody_looks(tmp_path: Path) -> None:
    with bench_in(tmp_path, **FULL) as bench:
        fill_fz(bench, 0.9)
        refused = bench.start(*STAIRS, "--yes")
        assert refused.end() == 3
        assert "90 % of Fz's range" in refused.err
        assert len(bench.history) == 1
        assert bench.start(*STAIRS, "--yes", "--no-preflight").end() == 0


def test_what_only_disturbs_is_noted_and_the_recording_goes_on(tmp_path: Path) -> None:
    with bench_in(tmp_path, **FULL) as bench:
        shakes(bench, 137.0, 0.03)
        pilot = bench.start(*STAIRS, "--yes")
        assert pilot.end() == 0, pilot.err
        assert "other lines" in pilot.err
        assert bench.run().header.state == "complete"


# Many rigs


def faults_of(folder: Path, **truth: Any) -> set[str]:
    """Return the lines of a preflight at 7 kHz that are faults, including the balance."""
    folder.mkdir()
    with bench_in(folder, **truth) as bench:
        sample_at(bench, 7000)
        pilot = bench.start("rig", "preflight", "--for", 2, "--yes", "--json")
        pilot.end()
    devices = json.loads(pilot.out)["devices"]
    return {one["asked"] for answers in devices.values() for one in answers if one["state"] == "fault"}


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.0, 3.5, 6.0])
@pytest.mark.parametrize("seed", range(10))
def test_of_many_rigs_a_sound_one_has_no_fault_and_a_bad_propeller_is_named_alone(
    tmp_path: Path, seed: int, factor: float
) -> None:
    """Batteries are from half full, biases to a tenth of range; a propeller's line is 0.85 times its thrust, times
    the factor drawn here, 0.8 to 1.15 for a sound one, and 0.8 to 1.2 drawn by the simulation.
    """
    rng = np.random.default_rng(seed)
    unbalance, bad = rng.uniform(0.8, 1.15, 4), int(rng.integers(4))
    unbalance[bad] *= factor
    found = faults_of(
        tmp_path / "rig",
        battery={"kind": "lipo", "charge": rng.uniform(0.5, 1.0)},
        loadcell={"bias": tuple(rng.uniform(-0.1, 0.1, 6) * (20, 20, 60, 1, 1, 1))},
        rotors={"unbalance_by_motor": tuple(unbalance)},
    )
    assert found == (set() if factor == 1.0 else {f"balance {bad + 1}"})
