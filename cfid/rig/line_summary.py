"""Sentences at the end of a recording of lines, on a rate or clock other than stated, and on lines left out."""

from cfid.counted import counted

OFF = 0.1  # tolerance, as a fraction of the rate that rig.toml states
UNLIKE = 0.01  # fraction of this computer's time by which a device's clock may deviate
_TELLING_S = 2.0  # shortest recording that shows a clock's rate


def repeated(name: str, count: int) -> str:
    """Return the sentence on lines that a device sent twice."""
    return (
        f"{counted(count, 'line')} of the {name} repeat the one before, device_us too: its program has to send each "
        "sample once."
    )


def rate_apart(name: str, sent_hz: float, *, stated_hz: float) -> tuple[str, ...]:
    """Return a sentence on a rate other than that in rig.toml, by which losses in gaps are counted."""
    if abs(sent_hz - stated_hz) <= OFF * stated_hz:
        return ()
    return (
        f"the {name} sent {sent_hz:.4g} lines a second; rig.toml states {stated_hz:g}: set devices.{name}.rate_hz to "
        "what it sends.",
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
    """Return the sentence on a device's clock that disagreed with this computer's across a gap."""
    return (
        f"the {name}'s clock, device_us, went otherwise than this computer's in a gap: was the device restarted? See "
        "to its supply. A swing is timed by its clock before and after."
    )


def clock_apart(name: str, *, here_s: float, there_s: float) -> tuple[str, ...]:
    """Return a sentence on a device's clock, from which fits take times, that disagreed with this computer's."""
    if here_s < _TELLING_S or abs(there_s - here_s) <= UNLIKE * here_s:
        return ()
    return (
        f"the {name}'s clock, device_us, went {there_s:.4g} s in {here_s:.4g} s: it counts another unit, stands, or "
        f"was restarted. Correct it, or leave it out of devices.{name}.values: times are then those of arrival.",
    )
