"""Files as an operator would have them, and the program run as an operator runs it."""

import contextlib
import io
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.cli.main import main
from cfid.console.campaign import make_campaign
from cfid.demo.recordings import write_runs
from cfid.records.campaign import find_campaign, load_rig, new_rig_text
from cfid.sim.demo_runs import SimulatedRun
from cfid.sim.demo_swings import record_chapter_2
from cfid.sim.truth_file import INERTIA_KG_M2, USUAL_TRUTH
from tests.transfer.sines_in_a_folder import Here

Cfid = Callable[..., subprocess.CompletedProcess[str]]

RECORDINGS_SEED = 5

_WITH_DEVICES = ("log", "motors", "rig")  # signals, loops and terminals are a process' own


@pytest.fixture
def cfid(tmp_path: Path) -> Cfid:
    """Run `cfid` with arguments in an empty folder, and return its output and exit code."""

    def run(*arguments: object, folder: Path = tmp_path) -> subprocess.CompletedProcess[str]:
        words = [str(argument) for argument in arguments]
        return _in_a_process(words, folder) if words and words[0] in _WITH_DEVICES else in_this_process(words, folder)

    return run


def sentences(content: Mapping[str, Any]) -> list[str]:
    """Return the sentences of a result's findings, as --json has it."""
    return [finding["text"] for finding in content["findings"]]


def _in_a_process(words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-W", "error", "-m", "cfid.cli.main", *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=120)


def in_this_process(words: Sequence[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a command without starting Python anew, which takes longer than most commands do."""
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True) for _ in range(2))
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.raises(SystemExit) as ended,
    ):
        main(words)
    said = [stream.buffer.getvalue().decode() for stream in (out, err)]
    return subprocess.CompletedProcess(["cfid", *words], int(ended.value.code or 0), *said)


@pytest.fixture
def tf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Here:
    """Run `cfid tf` within this process in an empty folder."""
    return Here(tmp_path, monkeypatch, capsys)


@pytest.fixture(scope="session")
def rig_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The rig.toml of a new campaign, under another name: a file to name, not a campaign to find."""
    path = tmp_path_factory.mktemp("rig") / "geometry.toml"
    path.write_text(new_rig_text())
    return path


@pytest.fixture(scope="session")
def recordings(rig_file: Path) -> list[SimulatedRun]:
    """Swings of vehicle and test body, and dropped weights: simulated once for all that takes them as files or runs."""
    return record_chapter_2(load_rig(rig_file), USUAL_TRUTH, np.random.default_rng(RECORDINGS_SEED))[0]


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory, rig_file: Path, recordings: list[SimulatedRun]) -> Path:
    """A folder with the rig's geometry.toml and one CSV of times and counts for every recording."""
    folder = tmp_path_factory.mktemp("files")
    shutil.copy(rig_file, folder)
    for i, run in enumerate(recordings):
        write(folder / f"{name(run, i)}.csv", run)
    return folder


def name(run: SimulatedRun, number: int) -> str:
    if run.weight_g is not None:
        return f"drop_{run.weight_g:g}g_{number}"
    return f"{'tb_' if run.body == 'testbody' else ''}{run.axis}"


def write(path: Path, run: SimulatedRun) -> None:
    rows = np.column_stack(run.devices["encoder"].values)
    np.savetxt(path, rows, fmt=("%.6f", "%d"), delimiter=",", header="t,phi", comments="")


@pytest.fixture(scope="session")
def _bodies(tmp_path_factory: pytest.TempPathFactory, recordings: list[SimulatedRun]) -> Path:
    folder = tmp_path_factory.mktemp("bodies") / "campaign"
    make_campaign(folder)
    campaign = find_campaign(folder, start=folder)
    assert campaign is not None
    write_runs(campaign, recordings)
    return folder


@pytest.fixture
def bodies(_bodies: Path, tmp_path: Path) -> Path:
    """A campaign of its own with swings of vehicle and test body, and dropped weights."""
    return Path(shutil.copytree(_bodies, tmp_path / "bodies"))


@pytest.fixture(scope="session")
def truth() -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return INERTIA_KG_M2
