"""The documentation states what the code computes, and its links lead to existing files."""

import importlib.util
import re
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

from tests.lab import ROOT

PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])


def figures_script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_figures", ROOT / "docs" / "make_figures.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_fall_of_table_2_3_is_as_the_page_says() -> None:
    script, page = figures_script(), (ROOT / "docs" / "explanation" / "swing.md").read_text()
    for peaks, printed in script.TABLE_2_3.items():
        cosine, ours = script.inertias(script.RELEASE_DEG, peaks)
        assert f"| {peaks} | {1e5 * cosine:.4f} | {1e5 * printed:.4f} | {1e5 * ours:.4f} |" in page


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
        assert (page.parent / target).exists(), target


def test_every_label_in_the_code_is_in_the_literature_list() -> None:
    listed = set(re.findall(r"^\| (\[\w+\]) \|", (ROOT / "docs/explanation/literature.md").read_text(), re.MULTILINE))
    docstrings = "".join(path.read_text() for path in (ROOT / "cfid").rglob("*.py"))
    used = set(re.findall(r"(?:^|[ (])(\[(?:[A-Z]{2,4}|[A-Z][a-z]{2}|vN)\])", docstrings, re.MULTILINE))

    assert used == listed


def test_the_picture_of_the_rooms_has_those_that_the_import_contract_has() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    layers = [re.findall(r"\w+", layer) for layer in contracts[0]["layers"]]
    text = (ROOT / "docs" / "explanation" / "architecture.md").read_text()
    picture = re.search(r"^    demo .*?^    errors .*?$", text, re.MULTILINE | re.DOTALL)
    assert picture is not None

    drawn = [re.findall(r"\w+", re.split(r"  +(?=\S)", line.strip())[0]) for line in picture[0].splitlines()]
    assert [room for line in drawn for room in line] == [room for layer in layers for room in layer]
