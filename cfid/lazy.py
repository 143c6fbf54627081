"""Import names when they are first used, so that `import cfid` and the start of a recording take no time."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def attached(package: str, places: Mapping[str, str]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return a package's `__getattr__` and `__dir__`; `places` maps each name to its module, a module itself to ""."""

    def get(name: str) -> Any:
        if name not in places:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        module = import_module(f"{package}.{places[name] or name}")
        return getattr(module, name) if places[name] else module

    return get, lambda: sorted(places)


def later(module: str, name: str) -> Callable[..., Any]:
    """Return a function whose module is imported at its first call."""

    def call(*arguments: Any, **named: Any) -> Any:
        return getattr(import_module(module), name)(*arguments, **named)

    return call
