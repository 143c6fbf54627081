"""Defines what the live line shows of each instrument, in widths that do not change from row to row."""

import math

import numpy as np

from cfid.rig.progress import Progress, Reading
from cfid.wire.rls import turns_of


def degrees(counts_per_turn: float | str) -> Reading:
    """Return the angle of an encoder's latest row from its first, when a pendulum hangs still, within half a turn.

    The encoder's own zero may lie anywhere.
    """

    def angle(encoder: Progress) -> float:
        latest, first = turns_of(np.array([encoder.latest[0], encoder.first[0]]), counts_per_turn).turns
        return float((360 * (latest - first) + 180) % 360 - 180)

    return Reading(angle, "{:z6.1f} deg")


def vertical_force(counts_per_n: float) -> Reading:
    """Return a load cell's vertical force, above its tare where there is one."""
    return Reading(lambda cell: 1e3 * _above_tare(cell, 2) / counts_per_n, "Fz {:z4.0f} mN")


def first_force(name: str) -> Reading:
    """Return the first force or torque of a load cell that sends lines, above its tare where there is one."""
    unit = "mN" if name.startswith("F") else "mNm"
    return Reading(lambda cell: 1e3 * _above_tare(cell, 0), f"{name} {{:z5.0f}} {unit}")


def displayed(unit: str) -> Reading:
    """Return the number that a hand-held instrument showed last."""
    return Reading(lambda instrument: instrument.latest[0], f"{{:6.0f}} {unit}")


def turning() -> Reading:
    """Return the rate of rotation in the latest row of the inertial log."""
    return Reading(lambda gyro: math.hypot(*gyro.latest[1:4]), "{:5.0f} deg/s")


def volts(place: int) -> Reading:
    """Return the battery's voltage, which has a given place in the vehicle's log."""
    return Reading(lambda vehicle: vehicle.latest[place], "{:.2f} V")


def _above_tare(cell: Progress, place: int) -> float:
    """Return the last block's mean less the tare: a mean, since a motor's vibration is larger than most loads."""
    return cell.mean[place] - (cell.tare[place] if cell.tare else 0.0)
