"""A wrong yaw of the load cell shows in the direction of the torque at the sines' frequencies."""

import numpy as np
import pytest

from cfid.transfer.data import mount_findings, torque_moments

TRUE_YAW_DEG = -45.0
ARM_M = 0.046


def moments(used_yaw_deg: float, seed: int, *, motor: int = 1, thrust_n: float = 0.02) -> np.ndarray:
    """Return the torque moments of ten sines of a plant made for this test: a thrust at the end of a motor's arm."""
    rng, total = np.random.default_rng(seed), np.zeros((2, 2))
    azimuth = {1: -45.0, 2: -135.0, 3: 135.0, 4: 45.0}[motor]
    turn = np.radians(azimuth - TRUE_YAW_DEG)  # azimuth of the arm in the load cell's frame
    for frequency_hz in np.linspace(0.2, 10, 10):
        time_s = np.arange(0, 8, 1 / 500)
        phase = 2 * np.pi * frequency_hz * time_s + rng.uniform(0, 2 * np.pi)
        thrust = 0.1 + thrust_n * np.sin(phase) / np.hypot(1, 2 * np.pi * frequency_hz * 0.065)
        torque = np.outer(thrust, (ARM_M * np.sin(turn), -ARM_M * np.cos(turn), 0.006))
        torque += 1e-3 * rng.standard_normal(torque.shape) + rng.uniform(-1, 1, 3) * 1e-2
        total += torque_moments(time_s, torque, frequency_hz=frequency_hz, motor=motor, yaw_deg=used_yaw_deg)
    return total


@pytest.mark.parametrize("motor", [1, 2, 3, 4])
def test_sound_mounts_pass(motor: int) -> None:
    rejected = [mount_findings(moments(TRUE_YAW_DEG + 3, seed, motor=motor), yaw_deg=-42) for seed in range(15)]
    assert not any(rejected)


@pytest.mark.parametrize("used", [0.0, 45.0, -90.0])
def test_a_yaw_that_is_45_or_90_degrees_off_is_never_accepted(used: float) -> None:
    for seed in range(17):
        (found,) = mount_findings(moments(used, seed), yaw_deg=used)
        assert found.severity == "rejection"
        assert "tf.static_gain_n" in found.quantities
        if abs(used - TRUE_YAW_DEG) < 89:
            assert "yaw -4" in found.text or "yaw -5" in found.text


def test_noise_alone_has_no_direction() -> None:
    assert not any(mount_findings(moments(0.0, seed, thrust_n=0.0), yaw_deg=0.0) for seed in range(20))
