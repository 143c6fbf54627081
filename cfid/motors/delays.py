"""How rotors' delays are stated: a delay may be consistent with zero, or negative because of time stamps."""

from cfid.findings import Finding, note
from cfid.units import COVERAGE_95


def delay_text(delay_s: float, std_s: float) -> str:
    """Return a delay with its standard uncertainty, and whether it is consistent with zero."""
    zero = "consistent with zero: " if abs(delay_s) <= COVERAGE_95 * std_s else ""
    return f"delay {zero}{1e3 * delay_s:.1f} +- {1e3 * std_s:.2g} ms"


def negative_delay(delay_s: float, std_s: float, *quantities: str) -> tuple[Finding, ...]:
    """Return a note where rotors respond before the time stamp of their command by more than noise explains."""
    if not delay_s < -COVERAGE_95 * std_s:
        return ()
    text = (
        f"the speed changes {-1e3 * delay_s:.1f} +- {1e3 * std_s:.2g} ms before its command as stamped: the stamps of "
        "commands or speeds are off by that much. It belongs to the link or the log, not to the motor."
    )
    return (note("rotor-delay-negative", text, *quantities),)


def command_between_rows(row_s: float) -> str:
    """Return the sentence about a command that a row shows up to `row_s` late."""
    return (
        f"the command is known every {1e3 * row_s:.3g} ms and changed up to that long before a row shows it: the delay "
        f"counts from the middle, and its standard uncertainty contains {1e3 * row_s / 12**0.5:.2g} ms for that."
    )
