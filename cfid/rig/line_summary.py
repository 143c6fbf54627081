"""Sentences at the end of a recording of lines, on a rate or clock other than stated, and on lines left out."""

from cfid.counted import counted
from cfid.rig.line_clock import UNLIKE

_TELLING_S = 2.0  # shortest recording that shows a clock's rate


def repeated(name: str, count: int) -> str:
    """Return the sentence on lines that a device sent twice."""
    return (
        f"{counted(count, 'line')} of the {name} repeat the one before, device_us too: its program has to send each "
        "sample once."
    )


def too_many(name: str, sent_hz: float, *, stated_hz: float) -> str:
    """Return the sentence on more lines than rig.toml states, which shows that its rate is wrong."""
    return (
        f"the {name} sent {sent_hz:.4g} lines a second, more than the {stated_hz:g} that rig.toml states, so its "
        f"losses are unknown: set devices.{name}.rate_hz to the rate that the device's program sets."
    )


def false_clock(name: str, count: int) -> tuple[str, ...]:
    """Return a sentence on lines that are left out because the device's clock jumps in them."""
    if not count:
        return ()
    return (
        f"{counted(count, 'line')} of the {name} left out, lost: device_us jumps there and back, as where two lines "
        "run into one. Let the device end lines with a checksum, shorten the cable.",
    )


def restarted(name: str) -> str:
    """Return the sentence on a device's clock that started anew."""
    return (
        f"the {name}'s clock, device_us, started anew: was the device restarted? See to its supply. A swing is timed "
        "by its clock before and after."
    )


def clock_apart(name: str, *, here_s: float, there_s: float) -> tuple[str, ...]:
    """Return a sentence on a device's clock, from which fits take times, that disagreed with this computer's."""
    if here_s < _TELLING_S or abs(there_s - here_s) <= UNLIKE * here_s:
        return ()
    return (
        f"the {name}'s clock, device_us, went {there_s:.4g} s in {here_s:.4g} s: it counts another unit, stands, or "
        f"was restarted. Correct it, or leave it out of devices.{name}.values: times are then those of arrival.",
    )
