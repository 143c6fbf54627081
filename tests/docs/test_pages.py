"""Pages state what the program computes; their links, commands and files exist; the site builds."""

import re
import runpy
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import BaseModel

from cfid.errors import CfidError
from cfid.quantities.registry import QUANTITIES
from cfid.records.rig_file import LineDevice, Mount, Rig
from cfid.sim.faults import CrazyflieFaults, EncoderFaults, LoadCellFaults
from tests.lab import ROOT, Cfid

DOCS = ROOT / "docs"
PAGES = sorted([ROOT / "README.md", *DOCS.rglob("*.md")])


def page(name: str) -> str:
    return (DOCS / name).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def made() -> dict[str, Any]:
    """The functions that write what the program says itself."""
    return runpy.run_path(str(DOCS / "make_reference.py"))


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_link_leads_somewhere(path: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", path.read_text(encoding="utf-8")):
        assert target.startswith("https://") or (path.parent / target).exists(), target


def test_the_site_builds_strictly_and_loads_nothing_from_elsewhere(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet"]
    command += ["--config-file", str(DOCS / "site/mkdocs.yml"), "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)

    assert done.returncode == 0, done.stderr
    assert (tmp_path / "site/reference/commands.html").exists()
    for built in (tmp_path / "site").rglob("*.html"):
        assert not re.findall(r"<(?:script|link|img)[^>]*(?:src|href)=.https?:", built.read_text(encoding="utf-8"))


def test_every_file_that_the_evidence_names_is_there() -> None:
    named = set(re.findall(r"tests/[\w/]+(?:\.py)?", page("reference/evidence.md")))

    assert len(named) > 40
    assert [path for path in sorted(named) if not (ROOT / path).exists()] == []


def test_every_key_of_rig_toml_is_listed_with_its_default() -> None:
    listed = dict(re.findall(r"^\| `([a-z][^`]*)` \| (.*?) \|", page("reference/rig-toml.md"), re.MULTILINE))

    assert listed == dict(_keys(Rig, ""))


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
    if isinstance(default, bool):
        return f"`{str(default).lower()}`"
    return f"`{list(default)}`" if isinstance(default, tuple) else f"`{default}`"


def test_every_exit_code_and_every_simulated_fault_is_listed() -> None:
    text = page("reference/faults.md")
    kinds: dict[str, type[BaseModel]] = {
        "encoder": EncoderFaults,
        "loadcell": LoadCellFaults,
        "crazyflie": CrazyflieFaults,
    }

    codes = {kind.exit_code for kind in CfidError.__subclasses__()}
    assert set(map(int, re.findall(r"^\| (\d+) \|", text, re.MULTILINE))) == codes | {0, 1, 130}
    for device, kind in kinds.items():
        assert set(re.findall(rf"`{device}\.(\w+)`", text)) == set(kind.model_fields)


def test_generated_tables_have_every_key_and_every_finding(made: dict[str, Any]) -> None:
    assert made["keys"]().count("\n| `") == len(QUANTITIES)
    findings = made["findings"]()
    rows = re.findall(r"^\| `([a-z]+(?:-[a-z0-9]+)*)` \| ([^|]+) \| \S", findings, re.MULTILINE)
    assert len(rows) > 150
    assert len(rows) == len(dict(rows)) == findings.count("\n| `")


def test_the_fall_of_table_2_3_is_as_the_page_states() -> None:
    figures = runpy.run_path(str(DOCS / "make_figures.py"))
    for peaks, printed in figures["TABLE_2_3"].items():
        cosine, ours = figures["inertias"](figures["RELEASE_DEG"], peaks)
        assert f"| {peaks} | {1e5 * cosine:.4f} | {1e5 * printed:.4f} | {1e5 * ours:.4f} |" in page(
            "explanation/swing.md"
        )


def test_every_label_of_literature_in_the_code_is_listed() -> None:
    listed = set(re.findall(r"^\| (\[\w+\]) \|", page("explanation/uncertainty.md"), re.MULTILINE))
    code = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "cfid").rglob("*.py"))

    assert listed == set(re.findall(r"(?:^|[ (])(\[(?:[A-Z]{2,4}|[A-Z][a-z]{2}|vN)\])", code, re.MULTILINE))


def test_the_page_of_the_thesis_shows_what_its_command_prints(cfid: Cfid, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("NO_COLOR", "1")
    text = page("how-to/repeat-the-thesis.md")
    command = re.search(r"^    (cfid fit inertia x=[\d.].*)$", text, re.MULTILINE)
    shown = re.search(r"^    inertia\.matrix_kg_m2.*(?:\n    .+)*", text, re.MULTILINE)
    assert command is not None
    assert shown is not None

    ended = cfid(*command[1].split()[1:], "--no-figures")
    assert ended.returncode == 0, ended.stderr
    printed = [_plain(line) for line in ended.stdout.splitlines()]
    for line in shown[0].splitlines():
        assert any(other.startswith(_plain(line)) for other in printed), line


def _plain(line: str) -> str:
    return " ".join(line.split())
