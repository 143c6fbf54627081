"""The page of findings has every code that a result may carry, and no other."""

import ast
import re
from collections.abc import Iterator
from functools import cache

import pytest

from tests.places import ROOT

PAGE = ROOT / "docs" / "reference" / "findings.md"
MAKERS = {"note", "warning", "rejection"}


def codes_in(source: str) -> Iterator[tuple[str, str]]:
    """Yield severity and code of every finding that a module makes."""
    tree = ast.parse(source)
    imports = (node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module == "cfid.findings")
    made_by = {name.asname or name.name: name.name for node in imports for name in node.names if name.name in MAKERS}
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in made_by:
            code = node.args[0]
            assert isinstance(code, ast.Constant), f"line {node.lineno}: a code is written out where it is found"
            yield made_by[node.func.id], str(code.value)


@cache
def found() -> frozenset[tuple[str, str]]:
    sources = (path.read_text(encoding="utf-8") for path in (ROOT / "cfid").rglob("*.py"))
    return frozenset(each for source in sources if "cfid.findings" in source for each in codes_in(source))


def listed() -> list[tuple[str, str]]:
    """Return severity and code of each row, once for each severity with which its code comes."""
    rows = re.findall(r"^\| `([\w-]+)` \| ([^|]+) \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    return [(severity, code) for code, cell in rows for severity in re.findall(r"note|warning|rejection", cell)]


@pytest.mark.xfail(strict=True, reason="rows are being written; take this mark away with the last one")
def test_every_finding_has_its_row() -> None:
    assert found() - set(listed()) == set()


def test_every_row_is_of_a_finding_that_there_is() -> None:
    assert set(listed()) - found() == set()
    assert len(listed()) == len(set(listed()))


def test_codes_are_read_from_calls_of_findings_alone() -> None:
    assert list(codes_in('from cfid.findings import note as said\nsaid("a", "b")\n')) == [("note", "a")]
    assert list(codes_in('from cfid.console.messages import note\nnote("a")\n')) == []
    assert len(found()) > 20


def test_codes_are_words_joined_by_hyphens() -> None:
    for _, code in found():
        assert re.fullmatch(r"[a-z]+(-[a-z0-9]+)*", code), code
