"""Every row of the table of faults has its test, and every fault that can be simulated has its row."""

import re
from collections import defaultdict

import pytest
from pydantic import BaseModel

from cfid.sim.faults import CrazyflieFaults, EncoderFaults, LoadCellFaults
from tests.lab import ROOT

TEXT = (ROOT / "docs" / "reference" / "faults.md").read_text()
ROWS = [[cell.strip() for cell in line.strip("|").split("|")] for line in TEXT.splitlines() if line.startswith("|")]
FAULTS = [row for row in ROWS if row[0] != "fault" and set(row[0]) != {"-"}]
TEST = re.compile(r"^def (test_\w+)\(.*\n(?:(?:[ )].*)?\n)*", re.MULTILINE)  # up to the next line outside the test
EXIT_CODES = {"", "0", "1", "2", "3", "4", "130"}


def test_every_row_has_five_columns_and_a_known_exit_code() -> None:
    assert len(FAULTS) > 50
    for row in FAULTS:
        assert len(row) == 5, row
        assert row[3] in EXIT_CODES, row


def test_every_row_has_a_test_that_is_there() -> None:
    sources = "".join(path.read_text() for path in (ROOT / "tests").rglob("test_*.py"))
    there = set(re.findall(r"^def (test_\w+)\(", sources, re.MULTILINE))
    for row in FAULTS:
        named = re.findall(r"`(test_\w+)`", row[4])
        assert named, row
        assert set(named) <= there, row


def test_every_row_that_says_so_has_a_test_that_checks_the_rig() -> None:
    asks = re.compile(r'"check"|check_(?:encoder|loadcell|lines)\(|checked\(')
    checks = {name for name, body in _tests().items() if asks.search(body)}
    starred = [row for row in FAULTS if row[0].endswith("*")]
    assert len(starred) > 20
    for row in starred:
        assert checks & set(re.findall(r"`(test_\w+)`", row[4])), row


def _tests() -> dict[str, str]:
    """Return the source of every test by its name; the sources of tests with the same name are joined."""
    found: dict[str, str] = defaultdict(str)
    for path in (ROOT / "tests").rglob("test_*.py"):
        for test in TEST.finditer(path.read_text()):
            found[test[1]] += test[0]
    return found


@pytest.mark.parametrize(
    ("device", "kind"),
    [("encoder", EncoderFaults), ("loadcell", LoadCellFaults), ("crazyflie", CrazyflieFaults)],
)
def test_every_fault_that_can_be_simulated_is_in_the_table(device: str, kind: type[BaseModel]) -> None:
    named = set(re.findall(rf"`{device}\.(\w+)`", "".join(row[0] for row in FAULTS)))
    assert named == set(kind.model_fields)
