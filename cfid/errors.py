"""All expected errors, each with its exit code; any other exception is a bug."""


class CfidError(Exception):
    """Base of all errors that end in a sentence instead of a traceback."""

    exit_code: int


class ConfigError(CfidError):
    """Wrong arguments, or an invalid rig.toml: names the file and the key."""

    exit_code = 2


class DeviceError(CfidError):
    """A port, a protocol or a link failed: names the port, the counts and the next step."""

    exit_code = 3


class StopError(DeviceError):
    """Motors did not confirm a stop: reported before any other error."""


class DataError(CfidError):
    """A recording is missing, cut, or has a wrong column or unit: names the file and the line."""

    exit_code = 4


class FitError(CfidError):
    """No fit was found, or it was rejected: gives the figures."""

    exit_code = 5


class RejectedError(FitError):
    """A fit was found, and rejected: the campaign keeps why."""


def check_positive(**arguments: float | None) -> None:
    """Check that the arguments which are given are numbers above zero.

    Raises ConfigError naming the first that is not.
    """
    for name, value in arguments.items():
        if value is not None and not 0 < value < float("inf"):
            raise ConfigError(f"{name} {value:g}: has to be above zero.")
