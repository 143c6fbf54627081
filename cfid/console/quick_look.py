"""Look at one second of the real signals before each recording with motors: the quick part of a preflight."""

import math
from collections.abc import Callable, Sequence

from cfid.console.live import LiveLine
from cfid.console.messages import note
from cfid.console.preflight import FEWEST_LINES, LASTS, TARE_S, judged
from cfid.console.preflight_lines import sends_lines
from cfid.errors import DeviceError
from cfid.estimate.battery_endurance import Held
from cfid.rig.check import DeviceAnswer
from cfid.rig.hardware import Hardware
from cfid.rig.instrument import Instrument
from cfid.rig.run import sample

NOT_READ = "; battery not read"  # shown where --no-preflight skips the look
_QUICK_S = 1.0
_WORTHLESS = {"load", "rate", "losses"}  # faults that make a recording useless


def quick(
    devices: Callable[[], Sequence[Instrument]],
    plan: Sequence[Held],
    hardware: Hardware,
    *,
    mass_kg: float,
    calm: bool = True,
) -> str:
    """Sample load cell and vehicle for one second, note each exceeded limit, and return the battery's state.

    `devices` returns them, anew for each look. A device that sends lines slowly is sampled for longer. Raises
    DeviceError where a device failed, or where two looks
    agree that a recording would be worthless; one look is not enough, since a busy computer may have missed samples.
    """
    every, wrong, worthless = _look(devices(), plan, hardware, mass_kg=mass_kg, calm=calm)
    if worthless:
        every, wrong, worthless = _look(devices(), plan, hardware, mass_kg=mass_kg, calm=calm)
    lines = [f"{name}, {one.asked}: {one.answer} (limit {one.limit}): {one.advice}." for name, one in wrong]
    if worthless:
        raise DeviceError(f"not recorded: {' '.join(lines)} `cfid rig preflight` shows more; --no-preflight records.")
    for line in lines:
        note(line)
    return next((f"; battery {one.answer}" for _, one in every if one.asked == LASTS), "")


Answers = list[tuple[str, DeviceAnswer]]  # by device


def _look(
    devices: Sequence[Instrument], plan: Sequence[Held], hardware: Hardware, *, mass_kg: float, calm: bool
) -> tuple[Answers, Answers, bool]:
    """Return all answers, the answers beyond a limit, and whether these make a recording worthless."""
    rates_hz = [device.record.rate_hz or math.inf for device in devices if sends_lines(device.record)]
    for_s = max([_QUICK_S, *((FEWEST_LINES + 1) / rate_hz for rate_hz in rates_hz)])
    live = LiveLine()
    live.task("looking at the signals")
    try:
        sampled = sample(devices, hardware, for_s=for_s, tare_s=TARE_S, show=live.show)
    finally:
        live.end()
    records = {device.name: device.record for device in devices}
    answers = judged(records, sampled, plan, mass_kg=mass_kg, calm=calm)
    every = [(name, one) for name, own in answers.items() for one in own]
    wrong = [
        (name, one) for name, one in every if one.state == "fault" or (one.asked == LASTS and one.advice and one.limit)
    ]
    return every, wrong, any(one.asked in _WORTHLESS and name == "loadcell" for name, one in wrong)
