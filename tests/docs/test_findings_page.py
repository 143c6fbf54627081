"""The page of findings has every code that a result may carry, and no other."""

import ast
import re
from collections.abc import Iterator
from functools import cache

from cfid.findings import SEVERITIES
from tests.places import ROOT

PAGE = ROOT / "docs" / "reference" / "findings.md"


def codes_in(source: str) -> Iterator[str]:
    """Yield the code of every finding that a module makes."""
    tree = ast.parse(source)
    imports = (node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module == "cfid.findings")
    makers = {name.asname or name.name for node in imports for name in node.names if name.name in SEVERITIES}
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in makers:
            code = node.args[0]
            assert isinstance(code, ast.Constant), f"line {node.lineno}: a code is written out where it is found"
            yield str(code.value)


@cache
def found() -> frozenset[str]:
    sources = (path.read_text(encoding="utf-8") for path in (ROOT / "cfid").rglob("*.py"))
    return frozenset(code for source in sources if "cfid.findings" in source for code in codes_in(source))


def listed() -> list[tuple[str, str]]:
    """Return code and severity of each row; what rejects one step or window may be a warning of the result."""
    return re.findall(r"^\| `([\w-]+)` \| ([^|]+) \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)


def test_every_finding_has_its_row() -> None:
    assert found() - {code for code, _ in listed()} == set()


def test_every_row_is_of_a_finding_that_there_is_and_says_how_severe_it_is() -> None:
    codes = [code for code, _ in listed()]

    assert set(codes) - found() == set()
    assert len(codes) == len(set(codes))
    for code, severity in listed():
        assert re.search("|".join(SEVERITIES), severity), code


def test_codes_are_read_from_calls_of_findings_alone() -> None:
    assert list(codes_in('from cfid.findings import note as heard\nheard("a", "b")\n')) == ["a"]
    assert list(codes_in('from cfid.console.messages import note\nnote("a")\n')) == []
    assert len(found()) > 20


def test_codes_are_words_joined_by_hyphens() -> None:
    for code in found():
        assert re.fullmatch(r"[a-z]+(-[a-z0-9]+)*", code), code
