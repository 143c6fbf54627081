"""The simulated thrust stand: its recordings contain what the truths state, and nothing else."""

import numpy as np
import pytest

from cfid.sim.loadcell import SATURATED, LoadCellTruth
from cfid.sim.propulsion import BatteryTruth, RotorTruth
from tests.offline.stand import StandRecord, Steps, simulate_stand, staircase_steps

SMOOTH = RotorTruth(unbalance=(0.0,) * 6, blade_pass=(0.0,) * 6)
SILENT = LoadCellTruth(noise_std=(0.0,) * 6)
SUPPLY = BatteryTruth()
ONE_STEP: Steps = [(1.0, (30000, 0, 30000, 0)), (3.0, (0, 0, 0, 0))]
THRUST_N = 2 * 1.8e-8 * (381.0 + 0.0408 * 30000) ** 2


def stand(
    *,
    rotors: RotorTruth = SMOOTH,
    loadcell: LoadCellTruth = SILENT,
    battery: BatteryTruth = SUPPLY,
    steps: Steps = ONE_STEP,
    spikes_per_s: float = 0.0,
    seed: int = 1,
) -> StandRecord:
    return simulate_stand(
        rotors=rotors,
        loadcell=loadcell,
        battery=battery,
        steps=steps,
        duration_s=4.0,
        rate_hz=1000,
        rng=np.random.default_rng(seed),
        spikes_per_s=spikes_per_s,
    )


def test_a_staircase_commands_some_motors_and_rests_before_between_and_after() -> None:
    steps, duration_s = staircase_steps([2000, 4000], motors=(1, 3), hold_s=3.0, rest_s=1.0)

    assert steps == [
        (1.0, (2000, 0, 2000, 0)),
        (4.0, (0, 0, 0, 0)),
        (5.0, (4000, 0, 4000, 0)),
        (8.0, (0, 0, 0, 0)),
    ]
    assert duration_s == 9.0


def test_without_a_pause_one_command_follows_the_other() -> None:
    steps, duration_s = staircase_steps([2000, 4000], motors=(2,), hold_s=3.0, rest_s=1.0, between_s=0.0)

    assert steps == [(1.0, (0, 2000, 0, 0)), (4.0, (0, 4000, 0, 0)), (7.0, (0, 0, 0, 0))]
    assert duration_s == 8.0


def test_a_smooth_stand_shows_bias_drift_and_the_thrust_of_both_rotors() -> None:
    record = stand()
    at_rest, running = record.time_s < 1, (record.time_s > 2) & (record.time_s < 3)
    unloaded = np.array(SILENT.bias) + np.outer(record.time_s, SILENT.drift_per_s)

    np.testing.assert_allclose(record.wrench[at_rest], unloaded[at_rest], atol=1e-6)
    np.testing.assert_allclose((record.wrench - unloaded)[running, 2], THRUST_N, rtol=1e-5)


def test_speed_and_volts_are_told_a_hundred_times_a_second() -> None:
    record = stand()
    volts_s, volts = record.vbat

    assert np.diff(volts_s) == pytest.approx(0.01)
    assert set(volts) == {3.7}
    assert record.speed_rad_per_s[295] == pytest.approx([381.0 + 0.0408 * 30000, 0] * 2)


def test_a_lithium_cell_sags_while_the_motors_run() -> None:
    record = stand(battery=BatteryTruth(kind="lipo"))

    assert record.volts[150:300].max() < record.volts[:100].min() - 0.05
    assert record.volts[299] < record.volts[150]


def test_the_commands_are_logged_with_the_rest_before_them() -> None:
    record = stand()

    assert record.command_time_s.tolist() == [0.0, 1.0, 3.0]
    assert record.commands.tolist() == [[0] * 4, [30000, 0, 30000, 0], [0] * 4]


def test_vibration_is_larger_than_the_thrust() -> None:
    record = stand(rotors=RotorTruth())
    running = record.wrench[2000:2900, 2] - 1.4

    assert np.ptp(running) / 2 > THRUST_N


def test_spikes_are_single_wild_samples_that_leave_the_others_as_they_were() -> None:
    clean, spiky = stand(), stand(spikes_per_s=5.0)
    others = np.setdiff1d(np.arange(4000), spiky.spikes)

    assert 8 <= len(spiky.spikes) <= 35
    assert not spiky.status.any()
    np.testing.assert_array_equal(clean.wrench[others], spiky.wrench[others])
    assert np.abs(spiky.wrench[spiky.spikes, 2]).max() > 20


def test_an_overloaded_cell_says_that_it_is_saturated() -> None:
    record = stand(loadcell=SILENT.model_copy(update={"ranges": (20.0, 20.0, 1.45, 1.0, 1.0, 1.0)}))

    assert not record.status[:900].any()
    assert set(record.status[2000:2900]) == {SATURATED}


def test_the_same_seed_gives_the_same_record_and_another_seed_does_not() -> None:
    noisy = LoadCellTruth()

    first, again, other = (stand(rotors=RotorTruth(), loadcell=noisy, seed=seed).wrench for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
