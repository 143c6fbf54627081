"""Every error an operator may meet, each with its exit code; anything else is a bug."""


class CfidError(Exception):
    """Root of all errors that are answered with a sentence instead of a traceback."""

    exit_code: int


class ConfigError(CfidError):
    """Wrong arguments, or a rig.toml that cannot be meant so: names the file and the key."""

    exit_code = 2


class DeviceError(CfidError):
    """A port, a protocol or a link failed: names the port, the counts and the next step."""

    exit_code = 3


class StopError(DeviceError):
    """Motors were told to stop and did not confirm it: said before everything else, whatever else went wrong."""


class DataError(CfidError):
    """A recording is missing, cut, or has a wrong column or unit: names the file and the line."""

    exit_code = 4


class FitError(CfidError):
    """No fit was found, or none that describes the data: gives the figures."""

    exit_code = 5


def check_positive(**arguments: float | None) -> None:
    """Check that the arguments which are given are numbers above zero.

    Raises ConfigError naming the first that is not.
    """
    for name, value in arguments.items():
        if value is not None and not 0 < value < float("inf"):
            raise ConfigError(f"{name} {value:g}: has to be above zero.")
