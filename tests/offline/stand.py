"""Simulates a thrust stand: from commands over time to the records of a load cell and a voltmeter.

The rotors, the battery and the load cell are those of the simulated rig, computed for seconds at once instead of in
step with a clock.
"""

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.sim.loadcell import LoadCellTruth, SimulatedLoadCell
from cfid.sim.propulsion import STILL, BatteryTruth, Four, Propulsion, RotorTruth, WindTruth
from cfid.sim.stepping import Array

Steps = Sequence[tuple[float, Four]]  # when, and the commands from then on

STILL_AIR = WindTruth()

_TICK_S = 0.01
_TICKS_AT_ONCE = 100


@dataclass(frozen=True, kw_only=True, eq=False)
class StandRecord:
    """A record at `time_s` (n,): `wrench` (n, 6) in N and Nm with its bias, and status words (n,).

    `spikes` are the indices of wild samples. `commands` (m, 4) hold from `command_time_s` (m,) on. The supply's `volts`
    (t,) and the true `speed_rad_per_s` (t, 4) are those at `tick_s` (t,).
    """

    time_s: Array
    wrench: Array
    status: npt.NDArray[np.uint32]
    spikes: npt.NDArray[np.intp]
    command_time_s: Array
    commands: Array
    tick_s: Array
    volts: Array
    speed_rad_per_s: Array

    @property
    def vbat(self) -> tuple[Array, Array]:
        """Times (t,) and volts (t,), 100 of them a second."""
        return self.tick_s, self.volts


def simulate_stand(
    *,
    rotors: RotorTruth,
    loadcell: LoadCellTruth,
    battery: BatteryTruth,
    steps: Steps,
    duration_s: float,
    rate_hz: float,
    rng: np.random.Generator,
    spikes_per_s: float = 0.0,
    wind: WindTruth = STILL_AIR,
) -> StandRecord:
    """Record from time zero, with all rotors at standstill, through steps at increasing times, with or without wind.

    A spike is one sample with any values within the load cell's ranges and a healthy status.
    """
    for_rotors, for_cell, for_spikes = rng.spawn(3)
    propulsion = Propulsion(
        rotors,
        battery,
        rng=for_rotors,
        begin_s=0.0,
        drag_ns_per_rad=wind.drag_ns_per_rad,
        yaw_deg=wind.yaw_deg if wind.speed_mps else loadcell.yaw_deg,
    )
    on_body = np.append(wind.body_n, np.zeros(3))
    cell = SimulatedLoadCell(loadcell, for_cell)
    time_s = np.arange(math.floor(duration_s * rate_hz)) / rate_hz
    tick_s = np.arange(math.ceil(duration_s / _TICK_S) + 1, dtype=np.float64) * _TICK_S
    ahead, followed, felt = deque(steps), [], []
    begin = 0
    for ticks in np.split(tick_s, range(_TICKS_AT_ONCE, len(tick_s), _TICKS_AT_ONCE)):
        followed += [_follow(propulsion, ahead, float(tick)) for tick in ticks]
        end = int(np.searchsorted(time_s, ticks[-1], side="right"))
        if end > begin:
            felt.append(cell.read(time_s[begin:end], propulsion.wrench_at(time_s[begin:end]) + on_body))
        begin = end
    wrench = np.vstack([counts for counts, _ in felt]) / loadcell.counts_per_unit
    spikes = np.flatnonzero(for_spikes.random(len(time_s)) < spikes_per_s / rate_hz)
    wrench[spikes] = for_spikes.uniform(-1, 1, (len(spikes), 6)) * loadcell.ranges
    return StandRecord(
        time_s=time_s,
        wrench=wrench,
        status=np.hstack([status for _, status in felt]),
        spikes=spikes,
        command_time_s=np.array([0.0, *(at for at, _ in steps)]),
        commands=np.array([STILL, *(commands for _, commands in steps)], np.float64),
        tick_s=tick_s,
        volts=np.array([volts for volts, _ in followed]),
        speed_rad_per_s=np.array([speed for _, speed in followed]),
    )


def staircase_steps(
    commands: Iterable[int], *, motors: Sequence[int], hold_s: float, rest_s: float, between_s: float | None = None
) -> tuple[list[tuple[float, Four]], float]:
    """Return the steps of a staircase on some of the motors 1 to 4, and how long it takes.

    The motors are off for `rest_s` before and after it, and for `between_s`, by default as long, between commands.
    """
    pause_s = rest_s if between_s is None else between_s
    steps: list[tuple[float, Four]] = []
    end_s = rest_s
    for command in commands:
        if steps and pause_s:
            steps.append((end_s, STILL))
            end_s += pause_s
        first, second, third, fourth = (command if motor in motors else 0 for motor in (1, 2, 3, 4))
        steps.append((end_s, (first, second, third, fourth)))
        end_s += hold_s
    steps.append((end_s, STILL))
    return steps, end_s + rest_s


def _follow(propulsion: Propulsion, ahead: deque[tuple[float, Four]], time_s: float) -> tuple[float, Array]:
    """Apply the commands due by a time, and return voltage and speeds (4,) at that time."""
    while ahead and ahead[0][0] <= time_s:
        begin_s, commands = ahead.popleft()
        propulsion.command(commands, begin_s)
    propulsion.advance(time_s)
    return propulsion.battery.volts, propulsion.speed_rad_per_s(time_s)
