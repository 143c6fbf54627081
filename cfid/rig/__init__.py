"""Real devices: opens ports, records what they send into runs, and reports what is wrong with them.

Raises DeviceError on import where the system lacks the modules that open ports, locks and keyboards.
"""

from importlib import import_module

from cfid.errors import DeviceError


def _is_missing(module: str) -> bool:
    try:
        import_module(module)
    except ImportError:
        return True
    return False


if _missing := [module for module in ("fcntl", "pwd", "termios", "tty") if _is_missing(module)]:
    raise DeviceError(
        f"this system's Python has no {', '.join(_missing)}: cfid reaches devices, real and simulated, on Linux alone. "
        "Record there and copy the campaign: fits, show, report and export work here."
    )
