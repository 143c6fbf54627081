"""The page swing.md on two threads: its rig.toml determines a matrix, and its commands find the simulated matrix."""

import json
import os
import re
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from cfid.inertia.matrix import matrix_rows
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import Rig, load_rig
from cfid.rig.sim_file import SIM_FILE
from cfid.sim.truth import INERTIA_KG_M2
from tests.lab import ROOT
from tests.processes import Forked, started

PAGE = (ROOT / "docs" / "how-to" / "swing.md").read_text(encoding="utf-8")
MOUNTS = re.findall(r"^cfid log gyro --axis (\w+) --for 30$", PAGE, re.MULTILINE)
LONGEST_S = 120.0


def rig_of_the_page(folder: Path) -> Rig:
    (text,) = re.findall(r"^```toml\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    (folder / RIG_FILE).write_text(text, encoding="utf-8")
    return load_rig(folder / RIG_FILE)


def test_the_six_mounts_of_the_page_determine_a_matrix(tmp_path: Path) -> None:
    mounts = rig_of_the_page(tmp_path).mounts
    directions = np.array([mounts[name].direction for name in MOUNTS], dtype=float)

    assert sorted(MOUNTS) == sorted(mounts)
    assert np.linalg.matrix_rank(matrix_rows(directions)) == 6
    assert all(mount.threads is not None for mount in mounts.values())


@pytest.mark.slow
def test_the_commands_of_the_page_find_the_inertia_of_the_simulated_vehicle(tmp_path: Path, in_time: None) -> None:
    rig_of_the_page(tmp_path)
    for mount in MOUNTS:
        simulated = _started(tmp_path, "rig", "sim", "--axis", mount)
        _wait_for(tmp_path / SIM_FILE)
        logged = _started(tmp_path, "log", "gyro", "--axis", mount, "--for", 12)
        code = logged.wait(LONGEST_S)
        simulated.send_signal(signal.SIGINT)
        simulated.wait(LONGEST_S)
        assert code == 0, (tmp_path / "err").read_text()
    fitted = _started(tmp_path, "fit", "inertia", "--json", "--no-figures")
    assert fitted.wait(LONGEST_S) == 0, (tmp_path / "err").read_text()

    found = json.loads((tmp_path / "out").read_text())["parameters"]["inertia.matrix_kg_m2"]
    value, std = np.array(found["value"]), np.array(found["std"])
    assert np.abs((value - INERTIA_KG_M2) / std).max() < 4
    assert np.all(np.diag(std) < 0.02 * np.diag(value))


def _started(folder: Path, *words: object) -> "Forked | subprocess.Popen[bytes]":
    environment = {**os.environ, "CFID_LOCKS": str(folder / "locks"), "TMPDIR": str(folder), "NO_COLOR": "1"}
    with (folder / "out").open("wb") as out, (folder / "err").open("wb") as err:
        return started(words, cwd=folder, env=environment, stdout=out, stderr=err)


def _wait_for(path: Path) -> None:
    end_s = time.monotonic() + LONGEST_S
    while not path.exists():
        assert time.monotonic() < end_s, "no simulated rig"
        time.sleep(0.05)
