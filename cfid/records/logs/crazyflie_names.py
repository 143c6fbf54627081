"""Find the units of variables that Crazyflie firmware logs, by their names or by their columns' headers."""

import re
from collections.abc import Iterable, Sequence

from cfid.errors import DataError
from cfid.records.logs.log import Channel, FlightLog, printable
from cfid.records.tables.text import is_finite
from cfid.units import FULL_COMMAND, USUAL_GRAVITY_MPS2

BY_NAMES = "columns with the firmware's names are in the firmware's units"  # an assumption about tables
# As the firmware documents its log variables. A name that is missing here has no certain unit.
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
# Units in brackets, as messages spell them, and their other spellings.
_WORDS = {
    "PWM (0 to 65535)": "1",
    **{unit: unit for unit in ("g", "m/s^2", "deg/s", "rad/s", "mrad/s", "deg", "rad", "rpm", "V", "mV")},
    **{unit: unit for unit in ("m", "mm", "m/s", "mm/s", "mm/s^2", "mbar", "gauss")},
}
_SPELT = {unit.lower(): unit for unit in _WORDS.values()} | {
    "pwm": "1",
    "m/s2": "m/s^2",
    "m/s²": "m/s^2",
    "dps": "deg/s",
    "°/s": "deg/s",
    "°": "deg",
}
_BRACKETED = re.compile(r"(?P<variable>\w+\.\w+?)[\s_]*[\[(](?P<unit>[^\[\]()]+)[\])]\s*")
_OF_CRAZYFLIE = re.compile(r"motor\.|pwm\.|pm\.|stabilizer\.|stateEstimateZ?\.|ctrltargetZ?\.|controller\.")
_PATTERNS = tuple((re.compile(pattern), unit) for pattern, unit in _UNITS)


def crazyflie_channel(name: str) -> Channel:
    """Return the channel of a variable of the firmware, such as `gyro.x`.

    A unit in brackets after the name, as in `gyro.x [rad/s]`, is the column's own. Where it is not the firmware's, it
    stays in the channel's name, so that readers of a file written from the channel know it.
    """
    found = _BRACKETED.fullmatch(name)
    variable, word = (found["variable"], found["unit"].strip()) if found else (name, "")
    unit = next((unit for pattern, unit in _PATTERNS if pattern.fullmatch(variable)), "")
    scale = FULL_COMMAND if variable.startswith("control.m") else 1.0
    if not (unit and word):
        return Channel(name, unit, scale)
    stated = _SPELT.get(word.lower(), word)
    return Channel(variable, unit, scale) if stated == unit else Channel(f"{variable} [{word}]", stated)


def stated_unit(channel: Channel) -> str:
    """Return a channel's unit as files state it, with a number before it where raw numbers count parts of the unit.

    `0.00048828125 g` is that of an accelerometer that counts 2048 to a g. For the firmware's own variables and for
    shares of the full command, the names show which parts are counted.
    """
    known = crazyflie_channel(channel.name)
    by_name = known.scale if known.own_unit == channel.own_unit else 1.0
    return channel.own_unit if channel.scale == by_name else f"{channel.scale!r} {channel.own_unit}"


def stated_channel(name: str, unit: str) -> Channel:
    """Return the channel with a name, and with a unit in the form that `stated_unit` returns."""
    scale, _, counted_in = unit.partition(" ")
    if counted_in and is_finite(scale):
        return Channel(name, counted_in, float(scale))
    known = crazyflie_channel(name)
    return Channel(name, unit, known.scale if known.own_unit == unit else 1.0)


def with_dot(names: Sequence[str]) -> list[str]:
    """Return columns' names with the firmware's dot where an underscore stands for it, as in `motor_m1`.

    Names that other vehicles' logs also have, such as `gyro_x`, count as the firmware's only where at least one of the
    columns has a name that the firmware alone has.
    """
    dotted = [name if crazyflie_channel(name).own_unit else name.replace("_", ".", 1) for name in names]
    meant = [is_variable(new) and new not in names for new in dotted]
    alone = any(is_ and _OF_CRAZYFLIE.match(new) for is_, new in zip(meant, dotted, strict=True))
    return [new if is_ and alone else name for is_, new, name in zip(meant, dotted, names, strict=True)]


def is_variable(name: str) -> bool:
    """Return whether a column has the name of a variable of the firmware, with or without a unit in brackets."""
    return bool(crazyflie_channel(name).own_unit)


def taken_for_granted(names: Sequence[str]) -> tuple[str, ...]:
    """Return the assumptions made when columns are read by the firmware's names."""
    read = with_dot(names)
    changed = [(old, new) for old, new in zip(names, read, strict=True) if old != new]
    unstated = [name for name in read if is_variable(name) and not name.endswith(("]", ")"))]
    return (
        *(f"column '{printable(old)}' is the firmware's {new}, and others like it are too" for old, new in changed[:1]),
        *((BY_NAMES,) if unstated else ()),
    )


def first_of(log: FlightLog, patterns: Sequence[str], motor: int = 0) -> str | None:
    """Return the first variable of `patterns` that a log has, with a motor's number for `{}`; None where it has none.

    Raises DataError for a variable in a unit that cfid does not read.
    """
    there = {channel.variable: channel for series in log.series for channel in series.channels}
    found = next((name for pattern in patterns if (name := pattern.format(motor)) in there), None)
    if found is not None:
        refuse_unread(log, there[found])
    return found


def refuse_unread(log: FlightLog, channel: Channel) -> None:
    """Raise DataError for a variable of the firmware in a unit that cfid does not read."""
    own = crazyflie_channel(channel.variable)
    if own.own_unit and channel.unit != own.unit:
        read = [word for word, unit in _WORDS.items() if Channel("", unit).unit == own.unit]
        raise DataError(
            f"{log.path}: column '{channel.name}' is in {channel.own_unit}, which is not read for {channel.variable}: "
            f"give it in {', '.join(read)}, and so in its header."
        )


def assumptions(channels: Iterable[Channel]) -> tuple[str, ...]:
    """Return the assumptions behind the units of channels."""
    weighed = any(channel.own_unit == "g" for channel in channels)
    return (f"1 g is {USUAL_GRAVITY_MPS2:g} m/s^2",) if weighed else ()
