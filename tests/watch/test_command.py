"""`cfid watch` from the terminal: its address, its end, and its exit code if something is missing."""

import os
import signal
import subprocess
import sys
import urllib.request
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


def test_the_page_at_the_printed_address_is_served_before_any_run_and_ctrl_c_ends_it(campaign: Path) -> None:
    printed = campaign / "printed"
    with printed.open("wb") as file:
        running = started(["watch"], cwd=campaign, env=dict(os.environ), stdout=file, stderr=file)
    wait_until(lambda: printed.read_text().endswith("\n"), "the address")
    address = printed.read_text().split()[0]
    assert address.startswith("http://127.0.0.1:")
    with urllib.request.urlopen(address, timeout=60) as page:
        assert b"<title>cfid watch" in page.read()
    running.send_signal(signal.SIGINT)
    assert running.wait(60) == 0
    assert len(printed.read_text().splitlines()) == 1


def ended(campaign: Path, code: str, *words: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-c", f"{code}\nfrom cfid.cli.main import main; main({['watch', *words]})"]
    return subprocess.run(command, cwd=campaign, check=False, capture_output=True, text=True, timeout=120)


def test_without_bokeh_one_sentence_names_the_extra(campaign: Path) -> None:
    answer = ended(campaign, "import sys; sys.modules['bokeh'] = None")
    assert answer.returncode == 2
    assert 'pip install "cfid[watch]"' in answer.stderr
    assert len(answer.stderr.splitlines()) == 1
