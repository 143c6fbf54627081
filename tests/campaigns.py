"""Files such as an operator has, and fixtures that run the program as an operator does."""

import fcntl
import os
import pickle
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np
import pytest

from cfid.console.campaign import make_campaign
from cfid.records.campaign import find_campaign
from cfid.records.rig_file import load_rig, new_rig_text
from cfid.sim.truth import INERTIA_KG_M2, USUAL_TRUTH
from cfid.wire.rls import STEPS_PER_TURN, decode_words
from tests.lab import Cfid, run_cfid
from tests.offline.runs import SimulatedRun
from tests.offline.swings import record_chapter_2
from tests.offline.write import write_runs
from tests.processes import started
from tests.transfer.sines_in_a_folder import Here

Once = Callable[[str, Callable[[Path], None]], Path]

LONGEST_S = 120.0
RECORDINGS_SEED = 5

_WITH_DEVICES = ("log", "motors", "rig", "next")  # need signals, loops and terminals of their own process


@pytest.fixture
def cfid(tmp_path: Path) -> Cfid:
    """Run `cfid` with arguments in an empty folder, and return its output and exit code."""

    def run(*arguments: object, folder: Path = tmp_path) -> subprocess.CompletedProcess[str]:
        words = [str(argument) for argument in arguments]
        return _in_a_process(words, folder) if words and words[0] in _WITH_DEVICES else run_cfid(words, folder)

    return run


def _in_a_process(words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    with TemporaryFile("w+", encoding="utf-8") as out, TemporaryFile("w+", encoding="utf-8") as err:
        code = started(words, cwd=folder, env=os.environ, stdout=out, stderr=err).wait(LONGEST_S)
        out.seek(0)
        err.seek(0)
        return subprocess.CompletedProcess(["cfid", *words], code, out.read(), err.read())


@pytest.fixture
def tf(tmp_path: Path) -> Here:
    """Run `cfid tf` within this process in an empty folder."""
    return Here(tmp_path)


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Once:
    """Make a folder once for all test processes: the first process that needs it makes it, and the others wait."""
    place = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        place = place.parent

    def made(name: str, make: Callable[[Path], None]) -> Path:
        folder, half = place / name, place / f"{name}.half"
        with (place / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not folder.exists():
                shutil.rmtree(half, ignore_errors=True)
                half.mkdir()
                make(half)
                half.rename(folder)
        return folder

    return made


@pytest.fixture(scope="session")
def rig_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The rig.toml of a new campaign under another name, so that tests can name the file but find no campaign."""
    path = tmp_path_factory.mktemp("rig") / "geometry.toml"
    path.write_text(new_rig_text())
    return path


@pytest.fixture(scope="session")
def recordings(once: Once, rig_file: Path) -> list[SimulatedRun]:
    """Swings of vehicle and test body, and dropped weights, simulated once for all tests that use them."""

    def simulate(folder: Path) -> None:
        runs, _ = record_chapter_2(load_rig(rig_file), USUAL_TRUTH, np.random.default_rng(RECORDINGS_SEED))
        (folder / "runs.pickle").write_bytes(pickle.dumps(runs))

    kept: list[SimulatedRun] = pickle.loads((once("recordings", simulate) / "runs.pickle").read_bytes())
    return kept


@pytest.fixture(scope="session")
def files(once: Once, rig_file: Path, recordings: list[SimulatedRun]) -> Path:
    """A folder with the rig's geometry.toml and one CSV of times and degrees for every recording."""

    def make(folder: Path) -> None:
        shutil.copy(rig_file, folder)
        for i, run in enumerate(recordings):
            write(folder / f"{name(run, i)}.csv", run)

    return once("files", make)


def name(run: SimulatedRun, number: int) -> str:
    if run.weight_g is not None:
        return f"drop_{run.weight_g:g}g_{number}"
    return f"{'tb_' if run.body == 'testbody' else ''}{run.axis}"


def write(path: Path, run: SimulatedRun) -> None:
    time_s, words = run.devices["encoder"].values[:2]
    degrees = 360 / STEPS_PER_TURN * decode_words(np.asarray(words, np.int64)).position
    rows = np.column_stack([time_s, degrees])
    np.savetxt(path, rows, fmt=("%.6f", "%.7f"), delimiter=",", header="t,phi_deg", comments="")


@pytest.fixture
def bodies(once: Once, recordings: list[SimulatedRun], tmp_path: Path) -> Path:
    """A separate campaign with swings of vehicle and test body, and dropped weights."""

    def make(folder: Path) -> None:
        make_campaign(folder, kind="simulated")
        campaign = find_campaign(folder, start=folder)
        assert campaign is not None
        write_runs(campaign, recordings)

    return Path(shutil.copytree(once("bodies", make), tmp_path / "bodies"))


@pytest.fixture(scope="session")
def truth() -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return INERTIA_KG_M2
