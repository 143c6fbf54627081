"""Warns, during a staircase on the load cell, about steps that do not settle or show no thrust."""

from collections.abc import Sequence
from typing import Any

import numpy as np

_FZ = 3  # among the columns of a load cell's rows, `t` the first
_WRONG_STEPS = 2  # consecutive ones, after which the operator is warned
_LEAST_COMMAND = 8000  # a smaller one gives too little thrust to be sure
_FEWEST_BLOCKS = 12
_UNFELT = "no thrust is felt"
_DRIFT = 0.05  # of a step's height, as the fit allows in a window
_SURE = 4.0  # standard uncertainties


class Steps:
    """Checks each step when it ends: whether its last two quarters agree, and its height above the pause before it.

    Keeps the mean of each block of rows of the current step, and warns only once.
    """

    def __init__(self, counts_per_n: float) -> None:
        """Take the load cell's scale in counts per N."""
        self._scale = 1e3 / counts_per_n
        self._command = 0
        self._means: list[float] = []
        self._tare: list[float] = []
        self._wrong: list[str] = []
        self._done = False

    def __call__(self, device: str, columns: Sequence[Any]) -> str:
        """Take new rows of the commands or the load cell; return what is wrong, "" for nothing."""
        if self._done:
            return ""
        if device == "loadcell":
            self._means.append(self._scale * float(np.mean(columns[_FZ])))
        if device != "commands":
            return ""
        command = max(int(column[-1]) for column in columns[1:])
        if command == self._command:
            return ""
        self._end_step()
        self._command, self._means = command, []
        if len(self._wrong) < _WRONG_STEPS:
            return ""
        self._done = True
        unfelt = all(text.startswith(_UNFELT) for text in self._wrong)
        advice = (
            "Look at motors, load cell and mount." if unfelt else "Hold longer (`hold`), or look at motors and mount."
        )
        return f"{' '.join(self._wrong)} {advice}"

    def _end_step(self) -> None:
        late = np.array(self._means[len(self._means) // 2 :])
        if not self._command:
            self._tare = late.tolist() or self._tare
        if self._command < _LEAST_COMMAND or len(late) < _FEWEST_BLOCKS or len(self._tare) < 2:
            return
        halves = np.array_split(late, 2)
        change, height = float(halves[1].mean() - halves[0].mean()), float(abs(late.mean() - np.mean(self._tare)))
        std = float(np.std(np.diff(late)) * np.sqrt(2 / len(late)))  # of a difference of means, from neighbours
        std = max(std, float(np.std(self._tare)) / np.sqrt(len(self._tare)))
        if height < _SURE * std:
            self._wrong.append(f"{_UNFELT} at command {self._command}: {height:.2g} mN, noise {std:.2g} mN.")
        elif abs(change) > _DRIFT * height + _SURE * std:
            self._wrong.append(
                f"command {self._command} does not settle: between the last quarters of its hold Fz changes by "
                f"{abs(change):.2g} of {height:.3g} mN (limit {100 * _DRIFT:g} %)."
            )
        else:
            self._wrong = []
