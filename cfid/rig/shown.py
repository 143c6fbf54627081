"""What the live line shows of each instrument, of widths that do not change from row to row."""

import math

import numpy as np

from cfid.rig.progress import Progress, Reading
from cfid.wire.rls import RLS_13BIT_IN_22, STEPS_PER_TURN, decode_words


def degrees(counts_per_turn: float | str) -> Reading:
    """Return the angle within a turn of an encoder's latest row."""

    def angle(encoder: Progress) -> float:
        counts, turn = encoder.latest[0], counts_per_turn
        if turn == RLS_13BIT_IN_22:
            counts, turn = float(decode_words(np.array([int(counts)])).position[0]), float(STEPS_PER_TURN)
        return 360 * counts / float(turn) % 360

    return Reading(angle, "{:5.1f} deg")


def vertical_force(counts_per_n: float) -> Reading:
    """Return a load cell's vertical force, above its tare where there is one."""
    return Reading(lambda cell: 1e3 * _above_tare(cell, 2) / counts_per_n, "Fz {:4.0f} mN")


def first_force(name: str) -> Reading:
    """Return the first force or torque of a load cell that sends lines, above its tare where there is one."""
    unit = "mN" if name.startswith("F") else "mNm"
    return Reading(lambda cell: 1e3 * _above_tare(cell, 0), f"{name} {{:5.0f}} {unit}")


def turning() -> Reading:
    """Return the rate of rotation in the latest row of the inertial log."""
    return Reading(lambda gyro: math.hypot(*gyro.latest[1:4]), "{:5.0f} deg/s")


def volts(place: int) -> Reading:
    """Return the battery's voltage, which stands at a place of the vehicle's log."""
    return Reading(lambda vehicle: vehicle.latest[place], "{:.2f} V")


def _above_tare(cell: Progress, place: int) -> float:
    """Return the mean of the last block, as a motor's vibration is larger than most loads."""
    return cell.mean[place] - (cell.tare[place] if cell.tare else 0.0)
