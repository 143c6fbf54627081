"""Chapter 4 of the thesis on the simulated rig: all commands in a few winds, and the references without."""

from dataclasses import replace

import numpy as np

from cfid.sim.demo_motors import record_stairs, shown_rpm
from cfid.sim.demo_runs import SimulatedDevice, SimulatedRun
from cfid.sim.stand import STILL_AIR
from cfid.sim.truth_file import SimTruth
from cfid.sim.wind import WindTruth

COMMANDS = (10000, 20000, 30000, 40000, 50000)
WINDS = ((0.0, 8.0, 3.2), (0.0, 12.0, 4.4), (48.4, 8.0, 2.9), (48.4, 12.0, 4.2), (77.9, 8.0, 2.8), (77.9, 12.0, 3.8))
MOTORS = (1, 2, 3, 4)
READ_STD = 0.05  # of the wind, as an operator reads its lowest and its highest speed

_HOLD_S, _REST_S = 2.5, 1.0


def record_chapter_4(truth: SimTruth, rng: np.random.Generator) -> list[SimulatedRun]:
    """Record a run for each wind, from (angle in degrees, generator's volts, m/s), and one without."""
    still = _record(truth, STILL_AIR, {"fan_v": 0.0, "wind_min_mps": 0.0, "wind_max_mps": 0.0}, rng)
    return [still, *(_in_wind(truth, *wind, rng) for wind in WINDS)]


def _in_wind(
    truth: SimTruth, angle_deg: float, fan_v: float, read_mps: float, rng: np.random.Generator
) -> SimulatedRun:
    """Let a wind blow that is somewhere between the two that the operator read."""
    low, high = read_mps * (1 - np.sqrt(3) * READ_STD), read_mps * (1 + np.sqrt(3) * READ_STD)
    acts = {"speed_mps": float(rng.uniform(low, high)), "angle_deg": angle_deg}
    asked = {
        "angle_deg": angle_deg,
        "fan_v": fan_v,
        "wind_min_mps": round(float(low), 3),
        "wind_max_mps": round(float(high), 3),
        "azimuth_deg": truth.wind.azimuth_deg,
    }
    return _record(truth, truth.wind.model_copy(update=acts), asked, rng)


def _record(truth: SimTruth, wind: WindTruth, asked: dict[str, float], rng: np.random.Generator) -> SimulatedRun:
    climbed = record_stairs(
        truth, rng, steps=COMMANDS, motors=MOTORS, hold_s=_HOLD_S, rest_s=_REST_S, wind=wind, kind="wind", asked=asked
    )
    return replace(climbed, devices={**climbed.devices, "readings": _readings(truth, rng)})


def _readings(truth: SimTruth, rng: np.random.Generator) -> SimulatedDevice:
    """Let an operator type what the tachometer shows at each command, just before it ends."""
    commands = np.array(COMMANDS, dtype=np.float64)
    typed_s = _REST_S + _HOLD_S - 0.2 + (_HOLD_S + _REST_S) * np.arange(len(commands))
    return SimulatedDevice(
        columns=("t", "command", "rpm"), values=(typed_s, np.array(COMMANDS), shown_rpm(commands, truth, rng))
    )
