"""Libraries that only some formats need, installed on request."""

from importlib import import_module
from types import ModuleType

from cfid.errors import ConfigError


def optional_library(module: str, *, extra: str, what: str) -> ModuleType:
    """Import a library of an extra. Raises a ConfigError that names the extra where the library is not installed."""
    try:
        return import_module(module)
    except ImportError:
        library = module.partition(".")[0]
        raise ConfigError(f'{what} needs the library {library}: install it with pip install "cfid[{extra}]".') from None
