"""Rotor speed from simulated vibration is right at every command and in the right octave, or else rejected."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import FitError
from cfid.motors.vibration.estimation import RotorSpeed, rotor_speed
from cfid.motors.vibration.result import fit
from cfid.motors.vibration.spectrum import spectrum
from cfid.sim.loadcell import LoadCellTruth, SimulatedLoadCell
from cfid.sim.propulsion import RotorTruth, SimulatedRotors
from tests.motors.stand_in_a_folder import climbed, rejections, write_thesis_file

Array = npt.NDArray[np.float64]

HZ = 7000
OPPOSITE = (1, 0, 1, 0)
UNBALANCE, BLADE_PASS = RotorTruth().unbalance, RotorTruth().blade_pass
SPREAD = np.array([1, 0.5, 1, 0.01, 0.01, 0.005])  # relative size of the hum in the six channels


def window(
    commands: tuple[float, ...], *, seconds: float = 2.0, seed: int = 1, truth: RotorTruth | None = None
) -> tuple[Array, Array, Array]:
    """Return times, the load cell's readings in N and Nm, and the speeds of the four motors, long after the start."""
    rng = np.random.default_rng(seed)
    rotors, command = SimulatedRotors(truth or RotorTruth(), rng), np.array(commands)
    rotors.advance(np.array([0.0]), command)
    time_s = 5 + np.arange(round(seconds * HZ)) / HZ
    counts, _ = SimulatedLoadCell(LoadCellTruth(), rng).read(time_s, rotors.advance(time_s, command))
    return time_s, counts / LoadCellTruth().counts_per_unit, rotors.speed_rad_per_s


def lines(*, unbalance: float, blade_pass: float) -> RotorTruth:
    """Return rotors whose spectral lines are the usual ones times the given factors."""
    return RotorTruth(
        unbalance=tuple(unbalance * part for part in UNBALANCE),
        blade_pass=tuple(blade_pass * part for part in BLADE_PASS),
    )


def hum(time_s: Array, *, size_n: float = 0.03) -> Array:
    """Return hum at 50.013 Hz, twice and six times this frequency in all channels, with random phases."""
    phase = np.random.default_rng(7).uniform(0, 2 * math.pi, (3, 6))
    waves = [np.cos(2 * math.pi * 50.013 * m * time_s[:, None] + phase[k]) for k, m in enumerate((1, 2, 6))]
    return np.asarray(size_n * SPREAD * sum(waves))


def noise(count: int, seed: int = 3) -> Array:
    return np.array(LoadCellTruth().noise_std) * np.random.default_rng(seed).standard_normal((count, 6))


@pytest.mark.parametrize("command", [4000, 10000, 22000, 33333, 52000, 64000])
def test_the_speed_is_right_within_a_tenth_of_a_percent_at_every_command(command: int) -> None:
    time_s, wrench, truth = window(tuple(command * on for on in OPPOSITE), seed=command)
    found = rotor_speed(time_s=time_s, wrench=wrench)

    assert found.accepted, rejections(found)
    assert found.speed_rad_per_s == pytest.approx(truth[0], rel=1e-3)
    assert abs(found.speed_rad_per_s - truth[0]) < 3 * found.std_rad_per_s
    assert found.std_rad_per_s < 2e-4 * truth[0]


def test_lines_come_back_with_their_amplitudes_and_phases() -> None:
    time = np.arange(HZ) / HZ - 0.4
    amplitude, phase = np.array([[0.02, 0.01], [0.03, 0.05]]), np.array([[0.3, -2.0], [1.0, 3.0]])
    angle = 1500.0 * (time - (time[0] + time[-1]) / 2)
    wave = sum(amplitude[k] * np.cos((k + 1) * angle[:, None] + phase[k]) for k in range(2))
    (rotor,) = rotor_speed(time_s=time, wrench=wave + 1e-3 * noise(HZ)[:, [0, 0]]).rotors

    assert rotor.harmonics == (1, 2)
    np.testing.assert_allclose(rotor.amplitude, amplitude, rtol=1e-3)
    np.testing.assert_allclose(rotor.phase_rad, phase, atol=1e-3)


@pytest.mark.parametrize("truth", [lines(unbalance=0, blade_pass=1), lines(unbalance=1, blade_pass=0)])
def test_one_line_alone_may_be_rotor_or_blade_pass_and_only_an_expectation_decides(truth: RotorTruth) -> None:
    time_s, wrench, speeds = window((30000, 0, 0, 0), truth=truth)
    alone = rotor_speed(time_s=time_s, wrench=wrench)
    guided = rotor_speed(time_s=time_s, wrench=wrench, expected_rad_per_s=(1300, 2000))

    assert "state what speed is expected" in " ".join(rejections(alone))
    assert guided.accepted
    assert guided.speed_rad_per_s == pytest.approx(speeds[0], rel=1e-4)


def test_three_blades_are_told_by_their_number() -> None:
    time = np.arange(2 * HZ) / HZ
    wave = 0.01 * np.cos(900.0 * time)[:, None] + 0.03 * np.cos(2700.0 * time + 1)[:, None]
    found = rotor_speed(time_s=time, wrench=wave * SPREAD + noise(len(time)), blades=3)

    assert found.accepted
    assert found.speed_rad_per_s == pytest.approx(900.0, rel=1e-4)
    assert found.rotors[0].harmonics == (1, 3)


def speeds(found: RotorSpeed) -> Array:
    return np.array([rotor.speed_rad_per_s for rotor in found.rotors])


@pytest.mark.parametrize("apart", [0.5, 3.0, 60.0])
def test_two_motors_half_a_resolution_apart_and_more_are_told_apart(apart: float) -> None:
    command = 2 * math.pi * apart / (2.0 * RotorTruth().rad_per_s_per_command)
    time_s, wrench, truth = window((30000, 0, 30000 + command, 0))
    found = rotor_speed(time_s=time_s, wrench=wrench, rotors=2)

    assert found.resolved
    deviation = np.array([rotor.std_rad_per_s for rotor in found.rotors])
    np.testing.assert_array_less(np.abs(speeds(found) - truth[[0, 2]]), 3 * deviation)
    assert np.max(deviation) < 0.1
    assert found.speed_rad_per_s == pytest.approx(truth[[0, 2]].mean(), abs=3 * found.std_rad_per_s)


def test_two_motors_at_one_speed_are_not_resolved_and_their_mean_allows_for_it() -> None:
    time_s, wrench, truth = window((30000, 0, 30000, 0))
    found = rotor_speed(time_s=time_s, wrench=wrench, rotors=2)
    single = rotor_speed(time_s=time_s, wrench=wrench)

    assert not found.resolved
    assert found.speed_rad_per_s == pytest.approx(truth[0], rel=1e-4)
    assert single.std_rad_per_s < 0.05 * found.std_rad_per_s < 1e-3 * truth[0]


def test_a_second_rotor_is_not_imagined() -> None:
    for seed in range(3):
        time_s, wrench, _ = window((12000, 0, 0, 0), seconds=1, seed=seed)
        assert len(rotor_speed(time_s=time_s, wrench=wrench, rotors=2).rotors) == 1


@pytest.mark.parametrize("command", [6000, 30000])  # 99.6 and 255.5 Hz
def test_hum_is_left_out_when_told_or_shown(command: int) -> None:
    time_s, wrench, truth = window((command, 0, 0, 0))
    rest_s = np.arange(HZ) / HZ - 1.7
    misled = rotor_speed(time_s=time_s, wrench=wrench + hum(time_s))
    told = rotor_speed(time_s=time_s, wrench=wrench + hum(time_s), mains_hz=50)
    shown = rotor_speed(time_s=time_s, wrench=wrench + hum(time_s), rest_wrench=hum(rest_s) + noise(HZ))

    assert misled.speed_rad_per_s != pytest.approx(truth[0], rel=1e-2)
    for found in (told, shown):
        assert found.accepted, rejections(found)
        assert found.speed_rad_per_s == pytest.approx(truth[0], abs=3 * found.std_rad_per_s)


def test_hum_that_a_record_has_at_rest_is_no_rotor_in_its_windows(tmp_path: Path) -> None:
    """Hum of 314 rad/s was the speed of each window."""
    record = climbed([6000, 30000], motors=(1,), rate_hz=4000.0, rest_s=2.0)
    record = replace(record, wrench=record.wrench + hum(record.time_s))
    result = fit(write_thesis_file(tmp_path / "stand.csv", record))
    truth = RotorTruth()

    for row, command in zip(result.quantities["rotor.windows"].value, (6000, 30000), strict=True):
        expected = truth.idle_rad_per_s + truth.rad_per_s_per_command * command
        assert row["accepted"]
        assert row["speed_rad_s"] == pytest.approx(expected, rel=1e-3)


def test_a_rotor_on_a_multiple_of_the_mains_is_doubted_unless_rest_shows_what_is_hum() -> None:
    command = (2 * math.pi * 450.1 - 381) / 0.0408
    time_s, wrench, truth = window((command, 0, 0, 0))
    told = rotor_speed(time_s=time_s, wrench=wrench + hum(time_s), mains_hz=50)
    rest = hum(np.arange(HZ) / HZ) + noise(HZ)
    shown = rotor_speed(time_s=time_s, wrench=wrench + hum(time_s), rest_wrench=rest)

    assert "were removed" in " ".join(rejections(told))
    assert shown.accepted
    assert shown.speed_rad_per_s == pytest.approx(truth[0], abs=3 * shown.std_rad_per_s)


def test_noise_alone_is_no_rotor() -> None:
    for seed in range(8):
        found = rotor_speed(time_s=np.arange(HZ) / HZ, wrench=noise(HZ, seed))
        assert "no rotor shows in the vibration" in " ".join(rejections(found))


def rotating(angle: Array, *, size_n: float = 0.03) -> Array:
    return size_n * SPREAD * (np.cos(angle + 0.4) + 0.6 * np.cos(2 * angle - 1))[:, None] + noise(len(angle))


def test_a_speed_that_wanders_is_averaged_with_a_deviation_to_match() -> None:
    rng = np.random.default_rng(2)
    speed = 1800 + 20 * np.interp(np.arange(3 * HZ), np.arange(0, 4 * HZ, HZ // 8), rng.standard_normal(32))
    found = rotor_speed(time_s=np.arange(3 * HZ) / HZ, wrench=rotating(np.cumsum(speed) / HZ))

    assert found.accepted
    assert 5 < found.wander_rad_per_s < 40
    assert found.speed_rad_per_s == pytest.approx(speed.mean(), abs=3 * found.std_rad_per_s)
    assert found.std_rad_per_s < 0.01 * 1800


def test_a_speed_that_is_still_changing_is_doubted() -> None:
    time = np.arange(HZ) / HZ - 0.5
    found = rotor_speed(time_s=time, wrench=rotating(1500 * time + 150 * time**2 / 2))

    assert not found.accepted
    assert found.speed_rad_per_s == pytest.approx(1500, rel=1e-2)


def test_too_short_a_window_and_too_slow_a_sampling_are_refused() -> None:
    with pytest.raises(FitError, match="63 samples"):
        rotor_speed(time_s=np.arange(63) / HZ, wrench=noise(63))
    with pytest.raises(FitError, match="no speed from 200"):
        rotor_speed(time_s=np.arange(500) / 50, wrench=noise(500))


def test_the_spectrum_shows_a_line_with_its_amplitude_above_the_noise() -> None:
    time = np.arange(3 * HZ) / HZ
    wave = np.array([0.02, 0, 0.05, 0, 0, 0]) * np.cos(2 * math.pi * 255.5 * time)[:, None]
    seen = spectrum(signal=wave + noise(len(time)), interval_s=1 / HZ)
    at = int(np.argmax(seen.amplitude[:, 0]))

    assert seen.frequency_hz[at] == pytest.approx(255.5, abs=0.2)
    assert seen.amplitude[at, [0, 2]] == pytest.approx([0.02, 0.05], rel=0.02)
    expected = np.array(LoadCellTruth().noise_std) * 2 * math.sqrt(1.5 / HZ)
    np.testing.assert_allclose(np.median(seen.floor, axis=0), expected, rtol=0.1)


def test_blade_pass_that_sampling_folds_is_no_second_rotor() -> None:
    time_s, wrench, truth = window((40000, 0, 40000, 0))  # 320 Hz, blade pass 640 Hz: 360 Hz at 1000 samples a second
    seventh = slice(None, None, 7)
    folded = rotor_speed(time_s=time_s[seventh], wrench=wrench[seventh], rotors=2)
    slower = rotor_speed(time_s=time_s[seventh], wrench=wrench[seventh], expected_rad_per_s=(300.0, 1500.0))

    assert rotor_speed(time_s=time_s, wrench=wrench).speed_rad_per_s == pytest.approx(truth[0], rel=1e-3)
    assert not folded.accepted
    assert "blade pass of a rotor above 1571 rad/s folds back and passes for another rotor" in rejections(folded)[-1]
    assert not any("folds back" in doubt for doubt in rejections(slower))
