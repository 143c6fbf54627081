"""Check that the torque of sines lies where their motor's arm is: a wrong yaw of the load cell shows here."""

import math

import numpy as np
import numpy.typing as npt

from cfid.findings import Finding, rejection
from cfid.large import parts
from cfid.recordings.wrench import turn_about_z
from cfid.units import MOTOR_AZIMUTH_DEG

Array = npt.NDArray[np.float64]

_FARTHEST_DEG = 20.0  # from the arm, more than cross-talk and a mount aligned by eye; a gain is then 6 % too small
_CLEAR = 9.0  # the least ratio of the powers along and across the torque's direction, for the direction to be clear
_RESTING = (
    "tf.static_gain_n", "tf.numerator", "tf.series.*.static_gain_n", "tf.series.*.numerator", "tf.frequency_response",
)  # fmt: skip


def torque_moments(time_s: Array, torque_nm: Array, *, frequency_hz: float, motor: int, yaw_deg: float) -> Array:
    """Return the second moments (2, 2) of torque (n, 3) at a frequency, across the motor's arm and along it.

    The component across the arm is that of thrust. `yaw_deg` turns the cell's vectors into the vehicle's frame.
    """
    angle, count = math.radians(MOTOR_AZIMUTH_DEG[motor]), len(time_s)
    axes = np.array([[math.sin(angle), -math.cos(angle)], [math.cos(angle), math.sin(angle)]])
    total, mean, waves = np.zeros(2, complex), np.zeros(2), 0j
    for part in parts(count):
        both = axes @ turn_about_z(torque_nm[part], yaw_deg=yaw_deg)[:, :2].T
        hann = 0.5 - 0.5 * np.cos(2 * math.pi * np.arange(part.start, part.stop) / (count - 1))
        wave = hann * np.exp(-2j * math.pi * frequency_hz * (time_s[part] - time_s[0])) / count
        total, mean, waves = total + both @ wave, mean + both.sum(axis=1) / count, waves + wave.sum()
    at = total - mean * waves
    return np.asarray(np.outer(at, at.conj()).real)


def mount_findings(moments: Array, *, yaw_deg: float) -> tuple[Finding, ...]:
    """Reject gains where the torque, with moments (2, 2) summed over all sines, does not match the motor's arm."""
    across, along = np.linalg.eigvalsh(moments)
    off_deg = math.degrees(0.5 * math.atan2(2 * moments[0, 1], moments[0, 0] - moments[1, 1]))
    if along < _CLEAR * across or abs(off_deg) <= _FARTHEST_DEG:
        return ()
    lost = 100 * (1 - math.cos(math.radians(off_deg)))
    text = (
        f"the torque of the sines lies {abs(off_deg):.0f} degrees off that of the motor's arm (limit "
        f"{_FARTHEST_DEG:g}), and the gain would be {lost:.0f} % too small: is the load cell's yaw "
        f"{yaw_deg - off_deg:.0f} degrees, not {yaw_deg:g}, or did another motor run?"
    )
    return (rejection("sine-torque-off-arm", text, *_RESTING),)
