"""All expected errors, each with its exit code; any other exception is a bug."""


class CfidError(Exception):
    """The base of all errors that cfid reports as a sentence instead of a traceback.

    `code` names the fault for programs and tests, "" where nothing asks for it.
    """

    exit_code: int

    def __init__(self, *arguments: object, code: str = "") -> None:
        """Keep the sentence, and the fault's code."""
        super().__init__(*arguments)
        self.code = code


class ConfigError(CfidError):
    """Wrong arguments, or an invalid rig.toml; the message names the file and the key."""

    exit_code = 2


class DeviceError(CfidError):
    """A port, a protocol or a link failed; the message names the port, the counts and the next step."""

    exit_code = 3


class StopError(DeviceError):
    """The motors did not confirm a stop; this is reported before any other error."""


class DataError(CfidError):
    """A recording is missing or cut, or has a wrong column or unit; the message names the file and the line."""

    exit_code = 4


class FitError(CfidError):
    """No fit was found, or it was rejected; the message gives the figures."""

    exit_code = 5


class RejectedError(FitError):
    """A fit was found and rejected, or is poorer than the stored one; the campaign keeps the reason or the fit."""


def check_positive(**arguments: float | None) -> None:
    """Check that all arguments that are not None are finite numbers above zero.

    Raises ConfigError, which names the first argument that is not.
    """
    for name, value in arguments.items():
        if value is not None and not 0 < value < float("inf"):
            raise ConfigError(f"{name} {value:g}: has to be above zero.")
