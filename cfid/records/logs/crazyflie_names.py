"""Units of the variables that Crazyflie firmware logs, by their names."""

import re
from collections.abc import Iterable

from cfid.records.logs.log import Channel
from cfid.units import FULL_COMMAND, USUAL_GRAVITY_MPS2

# As the firmware documents its log variables. A name that is not here has no unit that is certain.
_UNITS = (
    (r"acc\.[xyz]|stateEstimate\.a[xyz]", "g"),
    (r"gyro\.[xyz]|controller\.(?:roll|pitch|yaw)Rate", "deg/s"),
    (r"(?:stateEstimate|stabilizer|controller|ctrltarget)\.(?:roll|pitch|yaw)", "deg"),
    (r"(?:stateEstimate|ctrltarget|locSrv)\.[xyz]|kalman\.state[XYZ]|baro\.asl", "m"),
    (r"(?:stateEstimate|ctrltarget)\.v[xyz]", "m/s"),
    (r"ctrltarget\.a[xyz]", "m/s^2"),
    (r"(?:stateEstimateZ|ctrltargetZ)\.[xyz]|range\.(?:front|back|left|right|up|zrange)", "mm"),
    (r"(?:stateEstimateZ|ctrltargetZ)\.v[xyz]", "mm/s"),
    (r"(?:stateEstimateZ|ctrltargetZ)\.a[xyz]", "mm/s^2"),
    (r"stateEstimateZ\.rate(?:Roll|Pitch|Yaw)", "mrad/s"),
    (r"(?:stateEstimate|locSrv)\.q[xyzw]|kalman\.q[0-3]", "1"),
    (r"rpm\.m[1-4]|motor\.m[1-4]_rpm", "rpm"),
    (r"motor\.m[1-4](?:req)?|pwm\.m[1-4](?:_pwm)?|stabilizer\.thrust|controller\.cmd_\w+", "1"),
    (r"control\.m[1-4]", "1"),  # of other autopilots: 1 is the full command
    (r"pm\.vbat", "V"),
    (r"pm\.vbatMV", "mV"),
    (r"baro\.pressure", "mbar"),
    (r"mag\.[xyz]", "gauss"),
)
_PATTERNS = tuple((re.compile(pattern), unit) for pattern, unit in _UNITS)


def crazyflie_channel(name: str) -> Channel:
    """Return the channel of a variable of the firmware, such as `gyro.x`."""
    unit = next((unit for pattern, unit in _PATTERNS if pattern.fullmatch(name)), "")
    return Channel(name, unit, FULL_COMMAND) if name.startswith("control.m") else Channel(name, unit)


def assumptions(channels: Iterable[Channel]) -> tuple[str, ...]:
    """Return what the units of channels take for granted."""
    weighed = any(channel.own_unit == "g" for channel in channels)
    return (f"1 g is {USUAL_GRAVITY_MPS2:g} m/s^2",) if weighed else ()
