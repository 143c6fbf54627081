"""`cfid rig preflight` and its quick part: faults of the signals are named before anything is recorded."""

import json
import math
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from cfid.rig.sampling import Sampled

from cfid.console.preflight import of_encoder
from cfid.records.files import RUNS_FOLDER
from cfid.records.run import DeviceRecord
from cfid.rig.check import DeviceAnswer
from tests.flying_in_a_folder import Bench, bench_in
from tests.rig_in_a_folder import Lab, lab_in

pytestmark = pytest.mark.usefixtures("in_time")

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


def test_a_sound_rig_is_ready_with_every_line_within_its_limit(tmp_path: Path) -> None:
    with bench_in(tmp_path, **FULL) as bench:
        pilot = bench.start("rig", "preflight", "--for", 2, "--no-balance", "--json")
        code = pilot.end()
        never_turned = len(bench.history) == 1
    devices = json.loads(pilot.out)["devices"]
    asked = {name: [answer["asked"] for answer in answers] for name, answers in devices.items()}

    assert code == 0, pilot.out
    assert never_turned
    assert asked["loadcell"][-6:] == ["losses", "load", "noise", "drift", "mains", "other lines"]
    assert asked["crazyflie"][-2:] == ["radio losses", "battery lasts"]
    assert asked["disk"] == ["space"]
    assert all(answer["limit"] for answer in devices["loadcell"][-6:])
    assert not (tmp_path / RUNS_FOLDER).exists()


@pytest.mark.parametrize(("hz", "line"), [(50.0, "mains"), (137.0, "other lines")])
def test_a_line_is_named_with_its_limit_and_what_to_do(tmp_path: Path, hz: float, line: str) -> None:
    with bench_in(tmp_path, **FULL) as bench:
        bench.in_loop(lambda: shakes(bench, hz, 0.012))
        pilot = bench.start("rig", "preflight", "sine", "--for", 2, "--no-balance", "--json")
        code = pilot.end()
    answers = {answer["asked"]: answer for answer in json.loads(pilot.out)["devices"]["loadcell"]}

    assert code == 3
    assert answers[line]["state"] == "fault"
    assert float(answers[line]["answer"].partition(",")[0]) == pytest.approx(12, rel=0.2)
    assert answers[line]["limit"].startswith("5, 5, 15 mN")
    assert answers[line]["advice"]
    assert "not ready: loadcell" in pilot.err
    assert ("137 Hz" in answers["other lines"]["answer"]) == (line == "other lines")


def test_a_low_battery_is_a_warning_that_says_how_long_it_lasts(tmp_path: Path) -> None:
    with bench_in(tmp_path) as bench:
        pilot = bench.start("rig", "preflight", "--for", 1, "--no-balance")
        assert pilot.end() == 0
    line = next(line for line in pilot.out.splitlines() if "battery lasts" in line)

    assert "warning" in line
    assert "3.70 V" in line
    assert "(limit 7:12 min, on a cell of 240 mAh)" in line
    assert "-> charge it" in pilot.out


def test_propellers_are_judged_once_the_operator_agrees_and_the_bad_one_is_named_alone(tmp_path: Path) -> None:
    with bench_in(tmp_path, **FULL, rotors={"unbalance_by_motor": (1.0, 1.0, 4.0, 1.0)}) as bench:
        refused = bench.start("rig", "preflight", "--for", 1)
        assert refused.end() == 0
        assert len(bench.history) == 1
        content = (tmp_path / "rig.toml").read_text().replace("rate_hz = 700\n", "rate_hz = 7000\n")
        (tmp_path / "rig.toml").write_text(content)
        pilot = bench.start("rig", "preflight", "--for", 1, "--yes", "--json")
        assert pilot.end() == 3
        still = bench.motors
    answers = json.loads(pilot.out)["devices"]["rotors"]

    assert "balance         warning  not measured: nobody confirmed" in refused.out
    assert "everyone clear? [y/N] \n" in refused.err
    assert "one after the other, for 0:24 min (nothing is kept on the disk); battery 4." in refused.err
    assert [answer["asked"] for answer in answers] == [f"balance {motor}" for motor in (1, 2, 3, 4)]
    assert all("% of" in answer["answer"] and answer["limit"] for answer in answers)
    (bad,) = [answer for answer in answers if answer["state"] != "ok"]
    assert (bad["asked"], bad["state"]) == ("balance 3", "fault"), answers
    assert "replace this propeller" in bad["advice"]
    assert "motors stopped, confirmed in" in pilot.err
    assert not any(still)


@pytest.mark.parametrize(
    "numbers",
    [
        pytest.param((signal.SIGINT,), id="Ctrl-C", marks=pytest.mark.slow),
        pytest.param((signal.SIGINT, signal.SIGINT), id="Ctrl-C twice", marks=pytest.mark.slow),
        pytest.param((signal.SIGHUP,), id="the terminal hangs up"),
        pytest.param((signal.SIGTERM,), id="a plain kill", marks=pytest.mark.slow),
    ],
)
def test_however_the_look_at_the_balance_ends_the_motors_are_off_and_the_vehicle_can_be_used(
    tmp_path: Path, numbers: tuple[int, ...]
) -> None:
    with bench_in(tmp_path, **FULL) as bench:
        content = (tmp_path / "rig.toml").read_text().replace("rate_hz = 700\n", "rate_hz = 3500\n")
        (tmp_path / "rig.toml").write_text(content)
        pilot = bench.start("rig", "preflight", "--for", 0.5, "--yes")
        pilot.wait_until_motors_run()
        pilot.send(*numbers)
        assert pilot.end() != 0
        still, turned = bench.motors, len(bench.history)
        again = bench.start(*STAIRS, "--yes")
        code = again.end()

        assert not any(still)
        assert code == 0, again.err
        assert any(any(motors) for _, motors in bench.history[turned:])
        assert not any(bench.motors)


def test_a_pendulum_that_moves_is_not_ready_and_one_that_hangs_still_is(lab: Lab) -> None:
    moving = lab.cfid("rig", "preflight", "swing", "--for", 3)
    lab.e201._angle_at = lambda time_s: 0.5
    still = lab.cfid("rig", "preflight", "swing", "--for", 3, "--json")
    states = {answer["asked"]: answer["state"] for answer in json.loads(still.out)["devices"]["encoder"]}

    assert moving.code == 3
    assert "let the pendulum hang still" in moving.out
    assert "not ready: encoder" in moving.err
    assert "limit 0.5 degrees between extremes" in moving.out
    assert (states["noise"], states["drift"]) == ("ok", "ok")


# Before each recording with motors


def test_the_question_states_duration_space_and_battery(tmp_path: Path) -> None:
    with bench_in(tmp_path, **FULL) as bench:
        pilot = bench.start(*STAIRS)
        assert pilot.end() == 2
        assert len(bench.history) == 1
    assert "for 0:02 min (about 1 MB; " in pilot.err
    assert "battery 4." in pilot.err
    assert "min at this plan's currents. Is the vehicle fastened" in pilot.err


def test_a_battery_that_is_too_small_for_the_plan_is_said_before_the_question(tmp_path: Path) -> None:
    with bench_in(tmp_path) as bench:
        pilot = bench.start("log", "thrust")
        assert pilot.end() == 2
    said, _, question = pilot.err.partition("will turn at commands")

    assert "battery lasts: 3.70 V: about 13 %" in said
    assert "(limit 7:12 min, on a cell of 240 mAh): charge it, or record in parts" in said
    assert "Is the vehicle fastened" in question


def test_the_question_says_that_the_battery_was_not_read_where_nobody_looked(tmp_path: Path) -> None:
    with bench_in(tmp_path, **FULL) as bench:
        pilot = bench.start(*STAIRS, "--no-preflight")
        assert pilot.end() == 2
    assert "are free); battery not read. Is the vehicle fastened" in pilot.err


def angles_judged(time_s: Array, degrees: Array) -> dict[str, DeviceAnswer]:
    record = DeviceRecord(file="encoder.csv", columns=("t", "phi"), rate_hz=1000, counts_per_turn=360)
    return {answer.asked: answer for answer in of_encoder(record, Sampled({"t": time_s, "phi": degrees}))}


def test_a_pendulum_that_was_just_released_swings_by_a_plain_number_of_degrees() -> None:
    time_s = np.arange(3000) / 1000
    said = angles_judged(time_s, np.round(53 * np.sin(8 * time_s)))["at rest"].answer

    assert said == "it swings by 106 degrees"


def test_signals_too_short_to_judge_are_refused(lab: Lab) -> None:
    refused = lab.cfid("rig", "preflight", "swing", "--for", 0.1)

    assert refused.code == 2
    assert "--for 0.1: noise and drift need 0.5 s or more" in refused.err


def test_a_pendulum_that_swings_is_to_be_held_still_and_is_no_fault_of_the_rig(lab: Lab) -> None:
    lab.e201._angle_at = lambda time_s: math.radians(6) * math.sin(8 * time_s)
    swinging = lab.cfid("rig", "preflight", "swing", "--for", 3)

    assert swinging.code == 0, swinging.out
    assert "at rest         warning  it swings by 12 degrees (limit 0.5 degrees)" in swinging.out
    assert "-> hold it still and check again: noise and drift are judged at rest" in swinging.out
    assert "not ready" not in swinging.err


@pytest.mark.parametrize("about", [lambda t: 0 * t, lambda t: 5 * t, lambda t: 8 * np.exp(-t)])
def test_noise_and_a_drift_are_faults_and_no_swing(about: Callable[[Array], Array]) -> None:
    time_s = np.arange(5000) / 1000
    noise = np.random.default_rng(2).normal(0, 0.3, len(time_s))
    answers = angles_judged(time_s, about(time_s) + noise)

    assert answers["noise"].state == "fault"
    assert "at rest" not in answers


def test_a_drift_beyond_its_limit_that_noise_hides_is_not_called_ok() -> None:
    time_s = np.arange(2000) / 1000
    answers = angles_judged(time_s, np.random.default_rng(1).normal(0, 3, 2000) + 0.2 * time_s)

    assert answers["noise"].state == "fault"
    assert answers["drift"].state == "warning"
    assert "not judged: noise hides it" in answers["drift"].answer
    assert answers["drift"].advice.startswith("mend the noise first")


def test_a_cell_near_its_range_is_not_recorded_unless_nobody_looks(tmp_path: Path) -> None:
    with bench_in(tmp_path, **FULL) as bench:
        bench.in_loop(lambda: fill_fz(bench, 0.9))
        refused = bench.start(*STAIRS, "--yes")
        assert refused.end() == 3
        assert len(bench.history) == 1
        blind = bench.start(*STAIRS, "--yes", "--no-preflight")
        assert blind.end() == 0, blind.err
    assert "90 % of Fz's range (limit 80 %)" in refused.err


def test_what_only_disturbs_is_noted_and_the_recording_goes_on(tmp_path: Path) -> None:
    with bench_in(tmp_path, **FULL) as bench:
        bench.in_loop(lambda: shakes(bench, 137.0, 0.03))
        pilot = bench.start(*STAIRS, "--yes")
        assert pilot.end() == 0, pilot.err
        run = bench.run()
    assert "note: loadcell, other lines: " in pilot.err
    assert "tighten the stand" in pilot.err
    assert run.header.state == "complete"


# Many rigs


def preflight_of(folder: Path, **truth: Any) -> dict[str, str]:
    """Return the state of each line at 7 kHz, including the balance."""
    folder.mkdir()
    with bench_in(folder, **truth) as bench:
        content = (folder / "rig.toml").read_text().replace("rate_hz = 700\n", "rate_hz = 7000\n")
        (folder / "rig.toml").write_text(content)
        pilot = bench.start("rig", "preflight", "--for", 2, "--yes", "--json")
        pilot.end()
    devices = json.loads(pilot.out)["devices"]
    return {answer["asked"]: answer["state"] for answers in devices.values() for answer in answers}


def drawn_rig(rng: np.random.Generator) -> dict[str, Any]:
    """Draw a sound rig: battery from half full, biases to a tenth of range, propellers below 1.2 times their thrust.

    A propeller's line is 0.85 times its thrust, times the factor drawn here and 0.8 to 1.2 drawn by the simulation.
    """
    bias = rng.uniform(-0.1, 0.1, 6) * (20, 20, 60, 1, 1, 1)
    return {
        "battery": {"kind": "lipo", "charge": rng.uniform(0.5, 1.0)},
        "loadcell": {"bias": tuple(bias)},
        "rotors": {"unbalance_by_motor": tuple(rng.uniform(0.8, 1.15, 4))},
    }


@pytest.mark.slow
def test_of_twenty_sound_rigs_none_is_called_faulty(tmp_path: Path) -> None:
    found = [preflight_of(tmp_path / str(seed), **drawn_rig(np.random.default_rng(seed))) for seed in range(20)]
    states = [state for rig in found for state in rig.values()]
    print(f"sound rigs: {len(found)}, lines {len(states)}, warnings {states.count('warning')}")

    assert [line for rig in found for line, state in rig.items() if state == "fault"] == []


@pytest.mark.slow
def test_of_twenty_bad_propellers_each_is_named_and_no_other(tmp_path: Path) -> None:
    named = []
    for seed in range(20):
        rng = np.random.default_rng(100 + seed)
        truth, bad = drawn_rig(rng), int(rng.integers(4))
        unbalance = list(truth["rotors"]["unbalance_by_motor"])
        unbalance[bad] *= rng.uniform(3.5, 6.0)
        states = preflight_of(tmp_path / str(seed), **truth | {"rotors": {"unbalance_by_motor": tuple(unbalance)}})
        faults = {line for line, state in states.items() if state == "fault"}
        named.append(faults == {f"balance {bad + 1}"})
        print(f"bad propeller {bad + 1} of {np.round(unbalance, 2)}: {faults}")

    assert all(named)
