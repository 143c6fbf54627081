"""`cfid watch` from the terminal: its address, its end, and its exit code if something is missing."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cfid.records.files import RIG_FILE
from cfid.records.rig_file import new_rig_text
from tests.processes import started
from tests.rig_in_a_folder import wait_until

pytestmark = pytest.mark.usefixtures("in_time")


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    return tmp_path


def test_a_browser_that_takes_the_terminal_is_served_before_any_run_and_ctrl_c_ends_it(campaign: Path) -> None:
    program, seen, said = campaign / "browser", campaign / "seen", campaign / "said"
    fetch = (
        f"import sys, urllib.request as r; open({str(seen)!r}, 'wb').write(r.urlopen(sys.argv[1], timeout=60).read())"
    )
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -c "{fetch}" "$1"\n')
    program.chmod(0o755)
    with said.open("wb") as file:
        browser = {**os.environ, "BROWSER": f"{program} %s"}
        running = started(["watch"], cwd=campaign, env=browser, stdout=file, stderr=file)
    wait_until(lambda: seen.exists() and seen.read_bytes() != b"", "the page in the browser")
    assert b"<title>cfid watch" in seen.read_bytes()
    running.send_signal(signal.SIGINT)
    assert running.wait(60) == 0
    assert len(said.read_text().splitlines()) == 1


def ended(campaign: Path, code: str, *words: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-c", f"{code}\nfrom cfid.cli.main import main; main({['watch', *words]})"]
    return subprocess.run(command, cwd=campaign, check=False, capture_output=True, text=True, timeout=120)


def test_without_bokeh_one_sentence_names_the_extra(campaign: Path) -> None:
    answer = ended(campaign, "import sys; sys.modules['bokeh'] = None")
    assert answer.returncode == 2
    assert 'pip install "cfid[watch]"' in answer.stderr
    assert len(answer.stderr.splitlines()) == 1
