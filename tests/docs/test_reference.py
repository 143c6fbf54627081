"""The reference matches the program: commands, keys of rig.toml, keys of parameters."""

import importlib.util
import re
from collections.abc import Iterator
from types import ModuleType
from typing import Any, get_args

from pydantic import BaseModel

from cfid.errors import CfidError
from cfid.quantities.registry import QUANTITIES
from cfid.records.rig_file import LineDevice, Mount, Rig
from tests.lab import ROOT

REFERENCE = ROOT / "docs" / "reference"


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_of_commands_is_what_the_program_says() -> None:
    written = script("make_commands").commands_page()

    assert (REFERENCE / "commands.md").read_text(encoding="utf-8") == written, "run `python docs/make_commands.py`"


def test_every_key_of_rig_toml_is_told_with_its_default() -> None:
    text = (REFERENCE / "rig-toml.md").read_text(encoding="utf-8")
    found = dict(re.findall(r"^\| `([a-z][^`]*)` \| (.*?) \|", text, re.MULTILINE))

    assert found == dict(_keys(Rig, ""))


def _keys(model: type[BaseModel], before: str) -> Iterator[tuple[str, str]]:
    for name, field in model.model_fields.items():
        for below, place in _tables(field.annotation):
            if below is Mount and before:
                yield f"{before}{name}.NAME", "as `mounts.NAME`"
            elif issubclass(below, LineDevice):
                yield from _keys(below, "lines.")
            else:
                yield from _keys(below, f"{before}{name}{place}.")
        if not list(_tables(field.annotation)):
            yield f"{before}{name}", "required" if field.is_required() else _as_toml(field.default)


def _tables(kind: Any) -> Iterator[tuple[type[BaseModel], str]]:
    """Yield the tables below a key, each with the text that follows the key's name, such as `.NAME` or `[]`."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        yield kind, ""
        return
    origin = getattr(kind, "__origin__", None)
    place = ".NAME" if origin is dict else "[]" if origin is tuple else ""
    for part in get_args(kind):
        for below, deeper in _tables(part):
            yield below, place + deeper


def _as_toml(default: Any) -> str:
    if default is None:
        return "none"
    if isinstance(default, str):
        return f'`"{default}"`'
    return f"`{list(default)}`" if isinstance(default, tuple) else f"`{default}`"


def test_every_exit_code_is_told() -> None:
    text = (REFERENCE / "exit-codes.md").read_text(encoding="utf-8")
    codes = {kind.exit_code for kind in CfidError.__subclasses__()}

    assert set(map(int, re.findall(r"^\| (\d+) \|", text, re.MULTILINE))) == codes | {0, 1, 130}


def test_the_tables_of_parameters_are_the_registrys() -> None:
    text = (REFERENCE / "parameters.md").read_text(encoding="utf-8")

    assert text == script("make_quantities").parameters_page(text), "run `python docs/make_quantities.py`"
    assert all(f"\n| `{quantity.key}` |" in text for quantity in QUANTITIES)
