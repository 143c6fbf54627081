"""Each system call of a recording, fit, report or export fails once: nothing is lost, no message is false."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.lab import ROOT
from tests.records.failing_calls import JOBS, KINDS

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="preloads a library, forks")


@pytest.fixture
def library(tmp_path: Path) -> Path:
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler to make the calls that fail")
    path = tmp_path / "failing_calls.so"
    source = Path(__file__).with_name("failing_calls.c")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", path, source, "-ldl"], check=True)
    return path


def attempts(library: Path, folder: Path, *kinds: str) -> Any:
    ended = subprocess.run(
        [sys.executable, "-m", "tests.records.failing_calls", folder, *kinds],
        env={**os.environ, "LD_PRELOAD": str(library)}, cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return json.loads(ended.stdout.splitlines()[-1])


@pytest.mark.parametrize("kinds", [("ENOSPC",), pytest.param(tuple(KINDS), marks=pytest.mark.slow)])
def test_a_call_that_fails_leaves_the_campaign_readable_and_a_true_message(
    library: Path, tmp_path: Path, kinds: tuple[str, ...]
) -> None:
    found = attempts(library, tmp_path, *kinds)
    tries = found["tries"]
    print(f"{sum(tries.values())} calls failed, {len(found['wrong'])} faults: {tries}")

    assert set(tries) == {job.__name__ for job in JOBS}
    assert sum(tries.values()) >= 60 * len(kinds)
    assert found["wrong"] == []
