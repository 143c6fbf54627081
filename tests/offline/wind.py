"""Simulates chapter 4 of the thesis: all commands at a few wind settings, and the references without wind."""

from dataclasses import replace

import numpy as np

from cfid.sim.propulsion import WindTruth
from cfid.sim.stepping import Array
from cfid.sim.truth import SimTruth
from tests.offline.motors import record_staircase, shown_rpm
from tests.offline.runs import SimulatedDevice, SimulatedRun
from tests.offline.stand import STILL_AIR

COMMANDS = (10000, 20000, 30000, 40000, 50000)
WINDS = ((0.0, 8.0, 3.2), (0.0, 12.0, 4.4), (48.4, 8.0, 2.9), (48.4, 12.0, 4.2), (77.9, 8.0, 2.8), (77.9, 12.0, 3.8))
MOTORS = (1, 2, 3, 4)
READ_STD = 0.05  # relative, of the wind speed between the operator's lowest and highest reading

_HOLD_S, _REST_S = 2.5, 1.0


def record_chapter_4(truth: SimTruth, rng: np.random.Generator) -> list[SimulatedRun]:
    """Record a wind run for each setting (angle in degrees, fan voltage in V, speed in m/s), and one without wind."""
    still = _record(truth, STILL_AIR, {"fan_v": 0.0, "wind_min_mps": 0.0, "wind_max_mps": 0.0}, rng)
    return [still, *(wind_run(truth, *wind, rng) for wind in WINDS)]


def wind_run(
    truth: SimTruth, angle_deg: float, fan_v: float, read_mps: float, rng: np.random.Generator
) -> SimulatedRun:
    """Record at a wind speed that lies anywhere between the operator's two readings."""
    low, high = read_mps * (1 - np.sqrt(3) * READ_STD), read_mps * (1 + np.sqrt(3) * READ_STD)
    acts = {"speed_mps": float(rng.uniform(low, high)) / (1 + truth.wind.anemometer_gain), "angle_deg": angle_deg}
    requested = {
        "angle_deg": angle_deg,
        "fan_v": fan_v,
        "wind_min_mps": round(float(low), 3),
        "wind_max_mps": round(float(high), 3),
        "azimuth_deg": truth.wind.azimuth_deg,
    }
    return _record(truth, truth.wind.model_copy(update=acts), requested, rng)


def _record(truth: SimTruth, wind: WindTruth, requested: dict[str, float], rng: np.random.Generator) -> SimulatedRun:
    run = record_staircase(
        truth,
        rng,
        steps=COMMANDS,
        motors=MOTORS,
        hold_s=_HOLD_S,
        rest_s=_REST_S,
        wind=wind,
        kind="wind",
        requested=requested,
    )
    logged_s, _, volts = run.devices["crazyflie"].values
    return replace(run, devices={**run.devices, "readings": _readings(truth, rng, logged_s, volts)})


def _readings(truth: SimTruth, rng: np.random.Generator, logged_s: Array, volts: Array) -> SimulatedDevice:
    """Simulate an operator who types the tachometer's reading at each command, just before the command ends."""
    commands = np.array(COMMANDS, dtype=np.float64)
    typed_s = _REST_S + _HOLD_S - 0.2 + (_HOLD_S + _REST_S) * np.arange(len(commands))
    shown = shown_rpm(commands, truth, rng, volts=np.interp(typed_s, logged_s, volts))
    return SimulatedDevice(columns=("t", "command", "rpm"), values=(typed_s, np.array(COMMANDS), shown))
