"""What the live line shows of each instrument, of widths that do not change from row to row."""

import math

import numpy as np

from cfid.rig.recorder import Progress
from cfid.wire.rls import RLS_13BIT_IN_22, STEPS_PER_TURN, decode_words


def degrees(counts_per_turn: float | str, encoder: Progress) -> str:
    """Return the angle within a turn of an encoder's latest row."""
    counts = encoder.latest[0]
    if counts_per_turn == RLS_13BIT_IN_22:
        counts, counts_per_turn = float(decode_words(np.array([int(counts)])).position[0]), float(STEPS_PER_TURN)
    return f"{360 * counts / float(counts_per_turn) % 360:5.1f} deg"


def vertical_force(counts_per_n: float, cell: Progress) -> str:
    """Return a load cell's vertical force, above its tare where there is one."""
    return f"Fz {1e3 * _above_tare(cell, 2) / counts_per_n:4.0f} mN"


def first_force(name: str, cell: Progress) -> str:
    """Return the first force or torque of a load cell that sends lines, above its tare where there is one."""
    return f"{name} {1e3 * _above_tare(cell, 0):5.0f} {'mN' if name.startswith('F') else 'mNm'}"


def turning(gyro: Progress) -> str:
    """Return the rate of rotation in the latest row of the inertial log."""
    return f"{math.hypot(*gyro.latest[1:4]):5.0f} deg/s"


def volts(place: int, vehicle: Progress) -> str:
    """Return the battery's voltage, which stands at a place of the vehicle's log."""
    return f"{vehicle.latest[place]:.2f} V"


def _above_tare(cell: Progress, place: int) -> float:
    """Return the mean of the last block, as a motor's vibration is larger than most loads."""
    return cell.mean[place] - (cell.tare[place] if cell.tare else 0.0)
