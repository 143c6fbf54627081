"""Every row in the wire tables equals the code, and every constant of the wire modules has its row."""

import importlib
import re
import struct
from collections.abc import Iterator, Mapping
from enum import EnumMeta
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from cfid.wire import rdt_status
from cfid.wire.layout import Layout
from tests.lab import ROOT

TEXT = (ROOT / "docs" / "reference" / "wires.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| `(\w+)\.([^`]+)` \| `([^`]+)` \|", TEXT, re.MULTILINE)
MODULES = ("app", "crtp", "e201", "lines", "netft", "rdt", "rls", "scales", "supervisor", "ut372")


def module(name: str) -> ModuleType:
    return importlib.import_module(f"cfid.wire.{name}")


@pytest.mark.parametrize(("where", "name", "value"), ROWS, ids=lambda text: str(text)[:40])
def test_a_row_says_what_the_code_has(where: str, name: str, value: str) -> None:
    assert eval(name, dict(vars(module(where)))) == eval(value, {"bytes": bytes})


@pytest.mark.parametrize("name", MODULES)
def test_every_constant_of_a_wire_has_its_row(name: str) -> None:
    there = {row for where, row, _ in ROWS if where == name}

    assert set(_constants(module(name))) <= there


def _constants(where: ModuleType) -> Iterator[str]:
    """Yield the public constants that a module itself defines, its layouts, and the members of its enumerations."""
    source = Path(str(where.__file__)).read_text(encoding="utf-8")
    assigned = re.findall(r"^([A-Z][\w, ]*?)(?:: .*)? = ", source, re.MULTILINE)
    own = {name for names in assigned for name in names.split(", ")}
    own |= set(re.findall(r"^class (\w+)\(", source, re.MULTILINE))
    for name, value in vars(where).items():
        if isinstance(value, struct.Struct | Layout):
            yield f"{name}.format"
            yield from [f"{name}.mark"] if getattr(value, "mark", ()) else []
        elif name in own:
            yield from _rows(name, value)


def _rows(name: str, value: Any) -> Iterator[str]:
    if isinstance(value, EnumMeta):
        yield from (f"{name}.{member}" for member in value.__members__)
    elif isinstance(value, Mapping):
        yield from (f'{name}["{key}"]' for key in value)
    elif isinstance(value, int | float | str | bytes):
        yield name


def test_the_table_of_status_bits_is_that_of_the_code() -> None:
    rows = re.findall(r"^\| (\d+) \| ([^|]*) \| ?([^|]*)\|$", TEXT, re.MULTILINE)
    for column, family, names in ((1, "netft", rdt_status._NETFT), (2, "axia", rdt_status._AXIA)):
        found = {int(row[0]): row[column].strip() for row in rows if row[column].strip()}
        warnings = {bit for bit, text in found.items() if text.startswith("~ ")}

        assert {bit: text.removeprefix("~ ") for bit, text in found.items()} == dict(names)
        assert warnings == rdt_status._WARNINGS[family]  # type: ignore[index]
