"""Judge the steps of devices that send text lines, such as scales and microcontrollers, for the planned measurement."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.estimate.battery_endurance import Held
from cfid.records.rig_file import EncoderLines, LineDevice, LineValue, LoadCellLines
from cfid.records.run import DeviceRecord
from cfid.rig.check import DeviceAnswer, State
from cfid.rig.recorder import Sampled
from cfid.units import FULL_COMMAND, MOTORS, USUAL_GRAVITY_MPS2

Array = npt.NDArray[np.float64]

_CARRIES = 2.0  # thrust of all motors at full command over the weight: a vehicle with less hardly flies
_OF_THRUST = 0.04  # of the plan's largest thrust: the error of a reading is then at most 2 % of it
_OF_SWING_DEG = 0.5  # for a swing that is released at 10 degrees or more
_RESOLVED = 0.5  # of a step: with more noise than this, means resolve values between two steps
_MOST_DECIMALS = 9


def sends_lines(record: DeviceRecord) -> bool:
    """Return whether a device sends text lines by itself."""
    return "lines" in (record.model_extra or {})


def force_steps(record: DeviceRecord, sampled: Sampled, plan: Sequence[Held], *, mass_kg: float) -> list[DeviceAnswer]:
    """Judge the steps of each force by the thrust that a plan demands at this vehicle mass; torques have no limit."""
    setting = LoadCellLines.model_validate(_stated(record))
    thrust_n = _CARRIES * mass_kg * USUAL_GRAVITY_MPS2
    largest = max(part.motors / len(MOTORS) * part.command / FULL_COMMAND for part in plan)
    return [
        _steps(
            setting,
            value,
            sampled.columns[value.name],
            shown=1e3,
            unit=f"m{setting.column_unit(value)}",
            limit=1e3 * _OF_THRUST * thrust_n * largest if value.name.startswith("F") else math.inf,
            advice="take scales or a cell with finer steps, or let more motors turn (--motor)",
        )
        for value in setting.measured
    ]


def angle_steps(record: DeviceRecord, sampled: Sampled, *, swings: bool) -> DeviceAnswer:
    """Judge the steps of an angle by the limit for a swing; the scatter of an angle that `swings` is not noise."""
    setting = EncoderLines.model_validate(_stated(record))
    (value,) = setting.measured
    turn = setting.turn(record.counts_per_turn or math.nan)
    return _steps(
        setting,
        value,
        sampled.columns[value.name],
        shown=360 / float(turn),
        unit="degrees",
        limit=_OF_SWING_DEG,
        advice="let the device send decimals; without a pattern, see that none is lost behind a comma",
        moves=swings,
    )


def _stated(record: DeviceRecord) -> dict[str, Any]:
    """Return what rig.toml stated about a device."""
    return {"kind": "lines", "rate_hz": record.rate_hz, **(record.model_extra or {})["lines"]}


def _steps(
    setting: LineDevice,
    value: LineValue,
    column: Array,
    *,
    shown: float,
    unit: str,
    limit: float,
    advice: str,
    moves: bool = False,
) -> DeviceAnswer:
    """Judge the steps of a column (n,), which are at least the last decimal that the device sends.

    `shown` converts the column to `unit`. Steps above the limit pass if noise exceeds them, since means then resolve
    values between the steps; this does not hold for a quantity that `moves`.
    """
    factor = abs(setting.factor(value))
    numbers = column / factor
    decimal = _last_decimal(numbers)
    between = np.diff(np.unique(np.round(numbers / decimal)))
    changes = len(between) > 0
    step = shown * factor * decimal * (float(between.min()) if changes else 1.0)
    noise = shown * float(np.std(column))
    if moves:
        answer = f"{step:.2g} {unit}"
    elif changes:
        answer = f"{step:.2g} {unit}, scatter {noise:.2g}"
    else:
        what = "whole numbers" if decimal == 1 else "multiples"
        answer = f"no change in {len(column)} samples, {what} of {step:.2g} {unit}"
        advice = f"touch it while it is looked at; if it then changes by so much: {advice}"
    within = step <= limit or (changes and not moves and noise > _RESOLVED * step)
    state: State = "ok" if within else ("fault" if changes else "warning")
    most = "" if math.isinf(limit) else f"{limit:.2g} {unit}"
    return DeviceAnswer(f"steps of {value.name}", state, answer, "" if within else advice, most)


def _last_decimal(numbers: Array) -> float:
    """Return the place value of the last decimal that any of the numbers (n,) has, 1 where all are whole."""
    size = max(1.0, float(np.abs(numbers).max()))
    for decimals in range(_MOST_DECIMALS):
        if np.all(np.abs(numbers - np.round(numbers, decimals)) < 1e-9 * size):
            return float(10.0**-decimals)
    return float(10.0**-_MOST_DECIMALS)
