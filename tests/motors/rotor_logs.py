"""Logs of rotors whose speeds follow commands with an exact lag, and the errors of a fit to such a log."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from cfid.motors.lag import fit
from cfid.motors.lag.data import rotor_log
from cfid.records.result import Result

Array = npt.NDArray[np.float64]

RISING_S, FALLING_S, NOISE = 0.05, 0.08, 1.5
TRUTH = (("rising", RISING_S), ("falling", FALLING_S))
RPM = 30 / np.pi


def following(change_s: Array, levels: Array, time_s: Array) -> Array:
    """Return the exact speeds (n,) at `time_s` (n,) that lag behind levels (m,), each held from its `change_s` (m,)."""
    every = [(at, level) for at, level in zip(change_s, levels, strict=True)]
    every = sorted([*every, *((at, None) for at in time_s)], key=lambda each: (each[0], each[1] is None))
    now, leads_to, last_s, found = float(levels[0]), float(levels[0]), float(change_s[0]), []
    for at, level in every:
        tau_s = RISING_S if leads_to > now else FALLING_S
        now, last_s = leads_to + (now - leads_to) * np.exp((last_s - at) / tau_s), at
        if level is None:
            found.append(now)
        else:
            leads_to = level
    return np.array(found)


def fit_of(folder: Path, columns: Mapping[str, Array] | pd.DataFrame) -> Result:
    """Write a log of named columns (n,) as a table, and fit it."""
    path = folder / "log.csv"
    pd.DataFrame(columns).to_csv(path, index=False)
    log = rotor_log(path)
    assert log is not None
    return fit(log)


def off(result: Result, *, widest: float = math.inf) -> list[float]:
    """Return the errors of both rates in standard uncertainties, which are at most a fraction `widest` of the rates."""
    found = [(result.quantities[f"dynamics.{way}"], tau_s) for way, tau_s in TRUTH]
    assert all(one.std[0] < widest / tau_s for one, tau_s in found)
    return [abs(one.value[0] - 1 / tau_s) / one.std[0] for one, tau_s in found]
