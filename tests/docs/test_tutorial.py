"""The tutorial runs from its first line to its last, and prints the numbers that its page shows."""

import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.quantities.plausible import implausible
from cfid.quantities.registry import find, unit_of
from tests.lab import ROOT, sections_at, values_at
from tests.priority import ahead_of_others
from tests.processes import cfid_in_a_shell

PAGE = ROOT / "docs" / "tutorial" / "first-campaign.md"
BLOCK = re.compile(r"^```(sh|text)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]\d+)?")
NOTEBOOK = ROOT / "docs" / "how-to" / "python.md"
MARK = "--- end of a block ---"


def steps(page: str) -> Iterator[tuple[str, list[str]]]:
    """Yield each shell block with the lines of its output that the page shows."""
    blocks: list[tuple[str, list[str]]] = []
    for kind, text in BLOCK.findall(page):
        if kind == "sh":
            blocks.append((text, []))
        else:
            blocks[-1][1].extend(text.splitlines())
    return iter(blocks)


def alike(text: str, folder: Path) -> str:
    """Return a text without what differs between runs: dates in names, the folder, and spaces at ends of lines."""
    text = re.sub(r"\d{4}-\d\d-\d\d_\d{6}", "DATE", text.replace(str(folder), "..."))
    return "\n".join(line.rstrip() for line in text.splitlines())


def agrees(shown: str, printed: str) -> bool:
    """Return whether a printed line agrees with a line of the page; `   ...` at its end stands for any text.

    Whole numbers and words are the same. Other numbers may differ by two of their last digit, or by one in two
    thousand, and a value in a table by a fifth of its standard uncertainty. Files store times as Unix time, to a
    quarter of a microsecond, so a recording with the same seed is rounded differently at another hour. A window
    that ends a sample later for this reason moves the thrust by up to a tenth of its standard uncertainty.
    """
    if shown.endswith("   ..."):
        shown = shown.removesuffix("...").rstrip()
        printed = printed[: len(shown)]
    if NUMBER.sub("#", shown) != NUMBER.sub("#", printed):
        return False
    numbers = NUMBER.findall(shown)
    broken = [place for place, number in enumerate(numbers) if "." in number]
    rooms = [0.0] * len(numbers)
    if shown.startswith("│") and len(broken) > 1:
        value, std = broken[-2:]
        rooms[value] = abs(float(numbers[std])) / 5
    return all(map(_near, numbers, NUMBER.findall(printed), rooms))


def _near(shown: str, printed: str, room: float) -> bool:
    if "." not in shown:
        return shown == printed
    mantissa, _, exponent = shown.partition("e")
    digit = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
    if room:
        return abs(float(shown) - float(printed)) <= max(2.01 * digit, room)
    return abs(float(shown) - float(printed)) <= max(2.01 * digit, 5e-4 * abs(float(shown)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder in which the page is run."""
    return tmp_path_factory.mktemp("tutorial")


@pytest.fixture(scope="module")
def outputs(folder: Path) -> list[tuple[str, list[str], str]]:
    """Run the page in one shell, as a reader would; return each block, its expected output, and its real output."""
    page = list(steps(PAGE.read_text(encoding="utf-8")))
    script = "set -e\n" + f"\necho '{MARK}'\n".join(block for block, _ in page)
    environment = {
        **os.environ,
        "CFID_LOCKS": str(folder / "locks"),
        "COLUMNS": "80",
        "NO_COLOR": "1",
    }
    # A file rather than a pipe: no process that stays in the background can keep this waiting.
    with (folder / "said.txt").open("w+", encoding="utf-8") as found, cfid_in_a_shell() as programs, ahead_of_others():
        code = subprocess.run(
            ["bash", "-c", script],
            check=False,
            cwd=folder,
            env={**environment, "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"},
            stdout=found,
            stderr=subprocess.STDOUT,
            timeout=900,
        ).returncode
        found.seek(0)
        text = found.read()
    assert code == 0, text[-3000:]
    printed = alike(text, folder).split(f"{MARK}\n")
    return [(block, lines, output) for (block, lines), output in zip(page, printed, strict=True)]


def test_every_line_that_the_tutorial_shows_is_printed_in_its_order(outputs: list[tuple[str, list[str], str]]) -> None:
    for block, lines, output in outputs:
        rest = iter(output.splitlines())
        for line in (alike(line, Path("/nowhere")) for line in lines if line != "..."):
            assert any(agrees(line, each) for each in rest), f"{block}\ndoes not print\n{line}\nbut\n{output}"


@pytest.mark.usefixtures("outputs")
def test_all_that_the_tutorials_fits_find_is_as_the_registry_has_it(folder: Path) -> None:
    campaigns = {path.parent for path in folder.rglob("rig.toml")}
    found = [(value.key, value.parameter) for each in campaigns for value in values_at(each)]

    assert len(found) > 40
    for key, parameter in found:
        assert find(key) is not None, key
        assert parameter.unit == unit_of(key), key
        assert implausible(key, parameter.value) == ""


@pytest.mark.usefixtures("outputs")
def test_the_page_for_notebooks_runs_on_the_tutorials_campaign(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = next(path.parent for path in sorted(folder.rglob("rig.toml")) if list(path.parent.glob("runs/*_sine_*")))
    monkeypatch.chdir(campaign.parent)
    blocks = re.findall(r"^```python\n(.*?)^```$", NOTEBOOK.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    names: dict[str, Any] = {}
    for block in blocks:
        exec(block.replace('"cfid-demo"', f'"{campaign.name}"'), names)

    kept = sections_at(campaign)["inertia"].parameters["inertia.matrix_kg_m2"]
    assert len(blocks) > 5
    assert names["result"].accepted
    assert np.all(np.array(kept.value) == names["matrix"].value)
    assert (campaign.parent / "swing.csv").exists()


def test_numbers_are_compared_to_their_last_digits() -> None:
    assert agrees("x 1.64e-05 to 3", "x 1.62e-05 to 3")
    assert not agrees("x 1.64e-05 to 3", "x 1.61e-05 to 3")
    assert not agrees("x 1.6420e-05 to 3", "x 1.6420e-05 to 4")
    assert agrees("│ x │ 1.6420e-05 │ 3.0e-08 │", "│ x │ 1.6425e-05 │ 3.0e-08 │")
    assert not agrees("│ x │ 1.6420e-05 │ 3.0e-08 │", "│ x │ 1.6427e-05 │ 3.0e-08 │")
    assert agrees("a   ...", "a b 1")
    assert not agrees("a 1", "a 1 2")


def test_the_tutorial_shows_what_it_runs() -> None:
    page = list(steps(PAGE.read_text(encoding="utf-8")))

    assert len(page) > 8
    assert sum(bool(lines) for _, lines in page) > 6
