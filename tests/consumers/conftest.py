"""Tests with the programs that take exports; `bash .ci/consumers` installs the programs and runs these tests."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.consumers.plant import Row

Judge = Callable[[Row], None]
ROWS: list[Row] = []


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test of this folder, and allow warnings of other people's programs."""
    for item in items:
        if "consumers" in item.path.parts:
            item.add_marker(pytest.mark.consumers)
            item.add_marker(pytest.mark.filterwarnings("ignore"))


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in a separate folder for each test, since some programs write logs into the current folder."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def judge() -> Judge:
    """Return a function that keeps a row of evidence, and fails if predicted and found values differ."""

    def take(row: Row) -> None:
        ROWS.append(row)
        row.check()

    return take


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the evidence as a table."""
    if not ROWS:
        return
    terminalreporter.section("predicted, found")
    terminalreporter.write_line("| target | loaded by | hovering | roll, pitch, yaw, rad/s^2 | lag, ms | drag, 1/s |")
    terminalreporter.write_line("|---|---|---|---|---|---|")
    for row in sorted(ROWS, key=lambda r: r.target):
        lag = _pair(row.lag_s, 1000) if row.lag_s else "none"
        turning = "; ".join(map(_pair, row.turning)) or "none"
        drag = "; ".join(map(_pair, row.drag_1_s)) or "none"
        loader = f"{row.version}: {row.loaded}"
        cells = (row.target, loader, f"{_pair(row.hover)} {row.hover_unit}", turning, lag, drag)
        terminalreporter.write_line("| " + " | ".join(cells) + " |")


def _pair(pair: tuple[float, float], times: float = 1.0) -> str:
    return ", ".join(f"{value * times:.5g}" for value in pair)
