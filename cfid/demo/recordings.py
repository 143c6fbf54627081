"""Record the demo: the operator's own commands, on the simulated rig in virtual time."""

import contextlib
import io
import math
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Literal

import numpy as np

from cfid.cli.main import main
from cfid.errors import DeviceError
from cfid.records.campaign import Campaign
from cfid.rig.hardware import in_place
from cfid.sim.devices import SimulatedRig
from cfid.sim.propulsion import RotorTruth
from cfid.sim.truth import SimTruth
from cfid.sim.virtual import Virtual
from cfid.units import USUAL_GRAVITY_MPS2

_INTERRUPTED = 130  # exit code of Ctrl-C
_PAUSE_S = 20.0  # of an operator between two recordings
_LASTS_S = 3000.0  # more than all recordings and pauses
_HOLD_S, _REST_S = 2.5, 1.0
_LOOK_S = 0.1
_BLOCK_G, _FLICKER_G = 500.0, 0.1
_READ_STD = 0.05  # relative, of the wind speed between the operator's lowest and highest reading

Plan = Sequence[tuple[Sequence["Recording"], Sequence[str]]]  # recordings, and the fits that take them

_AXES = {"crazyflie": ("x", "y", "z", "xy", "xz", "yz"), "testbody": ("x", "z")}
_WEIGHTS_G = (20, 20, 30, 30, 40, 40, 50, 50)
_SECONDS_OF_A_DROP = {20: 16, 30: 9, 40: 8, 50: 8}  # the first weight falls 4.5 s after the rig was powered
_WINDS = ((0.0, 8.0, 3.2), (0.0, 12.0, 4.4), (48.4, 8.0, 2.9), (48.4, 12.0, 4.2), (77.9, 8.0, 2.8), (77.9, 12.0, 3.8))
STAIRS = f"--hold {_HOLD_S:g} --rest {_REST_S:g} --yes"
_OF_WIND = f"--commands 10000,20000,30000,40000,50000 {STAIRS} --rate-hz 1000"


@dataclass(frozen=True)
class Recording:
    """A command, what is mounted on the axis, the wind that really blows, and the readings that an operator types."""

    words: str
    mounted: dict[str, Any] = field(default_factory=dict)
    wind: tuple[float, float] | None = None  # speed in m/s, and angle in degrees
    reads: Literal["rpm", "grams"] | None = None


# Where the thesis has dozens of settings, the demo has a few. The load cell samples at 1 kHz, and at 7 kHz for steps
# whose speeds are estimated from vibration, since the blade pass exceeds 500 Hz.
SWINGS = (
    *(Recording(f"log encoder --axis {axis} --for 16", {"axis": axis}) for axis in _AXES["crazyflie"]),
    *(
        Recording(f"log encoder --body testbody --axis {axis} --for 16", {"axis": axis, "body": "testbody"})
        for axis in _AXES["testbody"]
    ),
)
DROPS = tuple(
    Recording(f"log encoder --weight {weight} --for {_SECONDS_OF_A_DROP[weight]}", {"weight_g": float(weight)})
    for weight in _WEIGHTS_G
)
MOTORS = (
    Recording(f"log thrust --from 0 --to 64000 --step 8000 --motor 1,3 --rate-hz 1000 {STAIRS}"),
    Recording("log thrust --from 20000 --to 60000 --step 20000 --motor 1 --hold 1.5 --rest 1.5 --rate-hz 7000 --yes"),
    Recording(f"log speed --from 8000 --to 64000 --step 8000 --motor 1,3 {STAIRS}", reads="rpm"),
    Recording("log sine --hz 0.25,1,2.5,6.25,12.5,8.75,4.25,1.5,0.5 --for 4 --amplitude 20000 --rate-hz 1000 --yes"),
    Recording("log ping --count 300"),
)


def winds(truth: SimTruth, *, seed: int) -> tuple[Recording, ...]:
    """Return the recordings in wind, whose speed lies anywhere between the operator's two readings, and without."""
    rng = np.random.default_rng([seed, len(_WINDS)])
    recordings = [Recording(f"log wind --wind 0 {_OF_WIND}", reads="rpm")]
    for angle_deg, fan_v, read_mps in _WINDS:
        low, high = (round(read_mps * (1 + sign * math.sqrt(3) * _READ_STD), 3) for sign in (-1, 1))
        speed_mps = float(rng.uniform(low, high)) / (1 + truth.wind.anemometer_gain)
        words = f"log wind --angle {angle_deg} --fan-voltage {fan_v} --wind {low},{high} {_OF_WIND}"
        recordings.append(Recording(words, wind=(speed_mps, angle_deg), reads="rpm"))
    return tuple(recordings)


def experiments(truth: SimTruth, *, seed: int) -> Plan:
    """Return the recordings of each experiment, and its fits; names of kinds stand for those of the runs."""
    thrust, quick, speed, sine, ping = MOTORS
    return (
        (SWINGS[:6], ("fit inertia",)),
        ((thrust, quick), ("fit speed --vibration {thrust[1]}", "fit dynamics {thrust[1]}", "fit torque {thrust[0]}")),
        ((sine,), ("tf identify",)),
        (winds(truth, seed=seed), ("fit drag",)),
        ((speed,), ("fit speed {speed[0]}", "fit thrust {thrust[0]} {speed[0]}")),
        (DROPS, ("fit friction",)),
        (SWINGS[6:], ("fit testbody",)),
        ((ping,), ("tf latency {ping[0]}",)),
    )


class Laboratory:
    """Where the demo's recordings are made, one after the other; the last ends before now."""

    def __init__(self, campaign: Campaign, truth: SimTruth, *, seed: int) -> None:
        """Take the campaign to record into, and the truth of its rig."""
        self._campaign, self._truth, self._seed = campaign, truth, seed
        self._unix_s: float = math.floor(datetime.now(UTC).timestamp() - _LASTS_S)  # whole: the same times of every run
        self.made = 0

    def make(self, recording: Recording) -> None:
        """Make a recording. Raises DeviceError, which names the command that failed."""
        self.made += 1
        hardware = Virtual(lambda seconds: self._rig(recording, seconds), unix_s=self._unix_s)
        said = io.StringIO()
        with (
            in_place(hardware),
            contextlib.redirect_stdout(said),
            contextlib.redirect_stderr(said),
            _operator(hardware, self._truth.rotors, np.random.default_rng([self._seed, self.made]), recording),
        ):
            try:
                main([*recording.words.split(), "--campaign", str(self._campaign.folder)])
            except SystemExit as ended:
                if ended.code == _INTERRUPTED:
                    raise KeyboardInterrupt from None
                if ended.code:
                    raise DeviceError(f"cfid {recording.words} failed: {said.getvalue().strip()}") from None
        self._unix_s = hardware.unix_s() + _PAUSE_S

    def _rig(self, recording: Recording, seconds: Any) -> SimulatedRig:
        rig = self._campaign.rig
        truth = self._truth
        if recording.wind is not None:
            speed_mps, angle_deg = recording.wind
            wind = truth.wind.model_copy(update={"speed_mps": speed_mps, "angle_deg": angle_deg})
            truth = truth.model_copy(update={"wind": wind})
        return SimulatedRig(
            rig if recording.mounted else rig.model_copy(update={"mounts": {}}),
            seconds=seconds,
            seed=self._seed,
            power_on=self.made,
            truth=truth,
            **recording.mounted,
        )


@contextlib.contextmanager
def _operator(hardware: Virtual, rotors: RotorTruth, rng: np.random.Generator, recording: Recording) -> Iterator[None]:
    """Let an operator type what an instrument shows at each command, just before the command ends.

    Scales are read at command 0, too.
    """
    shown, digits = (_shown_g, 1) if recording.reads == "grams" else (_shown_rpm, 0)
    held_s = {True: _HOLD_S, False: _REST_S + _HOLD_S if recording.reads == "grams" else math.inf}
    read, written = os.pipe()
    turns, since_s = False, 0.0

    def look() -> None:
        nonlocal turns, since_s
        command = max(hardware.rig.crazyflie.motors)
        if turns != (command > 0):
            turns, since_s = command > 0, hardware.seconds()
        elif hardware.seconds() - since_s > held_s[turns] - 2 * _LOOK_S:
            since_s = math.inf
            volts = hardware.rig.crazyflie.vehicle.volts
            os.write(written, f"{shown(command, volts, rotors, rng):.{digits}f}\n".encode())
        hardware.at(_LOOK_S, look)

    before = sys.stdin
    try:
        with os.fdopen(read, encoding="utf-8") as stdin:
            if recording.reads:
                look()
                sys.stdin = stdin
            yield
    finally:
        sys.stdin = before
        os.close(written)


def _shown_rpm(command: int, volts: float, rotors: RotorTruth, rng: np.random.Generator) -> float:
    """Return what a tachometer shows that counts every marker of a rotor."""
    speed = float(rotors.steady_rad_per_s(np.array([command], np.float64), volts=volts)[0])
    gain = (1 + rotors.tachometer_gain) * (1 + rotors.tachometer_std * float(rng.standard_normal()))
    return rotors.markers * speed * 60 / math.tau * gain


def _shown_g(command: int, volts: float, rotors: RotorTruth, rng: np.random.Generator) -> float:
    """Return what scales of 0.1 g show, on which the vehicle stands with a block, while all its rotors turn."""
    speed = rotors.steady_rad_per_s(np.array([command], np.float64), volts=volts)[0] if command else 0.0
    lifted_n = 4 * rotors.thrust_ns2_per_rad2 * float(speed) ** 2
    return _BLOCK_G - 1000 * lifted_n / USUAL_GRAVITY_MPS2 + _FLICKER_G * float(rng.standard_normal())
