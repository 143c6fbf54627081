"""The page of findings lists every code that a result may have, and no other."""

import ast
import re
from collections.abc import Iterator, Mapping
from functools import cache

import pytest

from cfid.findings import CODES, SEVERITIES
from tests.lab import ROOT

PAGE = ROOT / "docs" / "reference" / "findings.md"


# Findings that reject one row of several: the result keeps the other rows, so for the result they are warnings.
OF_A_ROW = {
    *("vibration-aliased", "vibration-lines-on-hum", "vibration-no-rotor", "vibration-octave-ambiguous"),
    "vibration-speed-drifts",
}


def codes_in(source: str) -> Iterator[tuple[str, str]]:
    """Yield the code and the severity of every finding that a module makes."""
    tree = ast.parse(source)
    imports = (node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module == "cfid.findings")
    makers = {name.asname or name.name: name.name for node in imports for name in node.names}
    makers = {local: name for local, name in makers.items() if name in SEVERITIES}
    called = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in makers:
            code = node.args[0]
            assert isinstance(code, ast.Constant), f"line {node.lineno}: a code is written out where it is found"
            called.add(node.func)
            yield str(code.value), makers[node.func.id]
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node.id in makers:
            assert node in called, f"line {node.lineno}: a finding is made where its severity is named"


@cache
def found() -> Mapping[str, frozenset[str]]:
    """Return the severities of every code."""
    severities: dict[str, set[str]] = {code: {severity} for code, (severity, _) in CODES.items()}
    for path in (ROOT / "cfid").rglob("*.py"):
        for code, severity in codes_in(path.read_text(encoding="utf-8")):
            severities.setdefault(code, set()).add("warning" if code in OF_A_ROW else severity)
    return {code: frozenset(those) for code, those in severities.items()}


def listed() -> list[tuple[str, str]]:
    """Return the code and the severity in each row of the page."""
    return re.findall(r"^\| `([\w-]+)` \| ([^|]+) \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)


def test_every_finding_has_its_row() -> None:
    assert found().keys() - {code for code, _ in listed()} == set()


def test_every_row_is_of_a_finding_that_there_is_and_says_how_severe_it_is() -> None:
    codes = [code for code, _ in listed()]

    assert set(codes) - found().keys() == set()
    assert len(codes) == len(set(codes))
    for code, severity in listed():
        assert set(re.findall("|".join(SEVERITIES), severity)) == found()[code], code


def test_codes_are_read_from_calls_of_findings_alone() -> None:
    assert list(codes_in('from cfid.findings import note as heard\nheard("a", "b")\n')) == [("a", "note")]
    assert list(codes_in('from cfid.console.messages import note\nnote("a")\n')) == []
    assert len(found()) > 20


def test_a_code_that_cannot_be_read_is_refused() -> None:
    made = "from cfid.findings import note\n"
    for hidden in ("for code in 'ab': note(code, '')\n", "for make in [note]: make('a', '')\n"):
        with pytest.raises(AssertionError, match="line 2"):
            list(codes_in(made + hidden))


def test_codes_are_words_joined_by_hyphens() -> None:
    for code in found():
        assert re.fullmatch(r"[a-z]+(-[a-z0-9]+)*", code), code
