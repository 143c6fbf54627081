"""`cfid watch` from the terminal: its address, its end, and its message if something is missing."""

import os
import re
import signal
import socket
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


def test_it_waits_for_the_first_run_and_ctrl_c_ends_it_with_0(campaign: Path) -> None:
    said = campaign / "said"
    with said.open("wb") as file:
        running = started(["watch"], cwd=campaign, env=dict(os.environ), stdout=file, stderr=file)
    wait_until(lambda: "Ctrl-C" in said.read_text() or running.poll() is not None, "the address")
    address = re.match(r"http://127\.0\.0\.1:\d+/", said.read_text())
    assert address is not None, said.read_text()
    facts = urllib.request.Request(f"{address[0]}facts", headers={"Sec-Fetch-Site": "same-origin"})
    with urllib.request.urlopen(facts, timeout=30) as answer:
        assert b"No run yet" in answer.read()
    running.send_signal(signal.SIGINT)
    assert running.wait(60) == 0
    assert len(said.read_text().splitlines()) == 1


def test_a_browser_that_takes_the_terminal_is_served(campaign: Path) -> None:
    program, seen = campaign / "browser", campaign / "seen"
    fetch = (
        f"import sys, urllib.request as r; open({str(seen)!r}, 'wb').write(r.urlopen(sys.argv[1], timeout=60).read())"
    )
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -c "{fetch}" "$1"\n')
    program.chmod(0o755)
    with (campaign / "said").open("wb") as file:
        browser = {**os.environ, "BROWSER": f"{program} %s"}
        running = started(["watch", "--open"], cwd=campaign, env=browser, stdout=file, stderr=file)
    wait_until(lambda: seen.exists() and seen.read_bytes() != b"", "the page in the browser")
    assert b"<title>cfid watch" in seen.read_bytes()
    running.send_signal(signal.SIGINT)
    assert running.wait(60) == 0


def test_a_port_in_use_is_named(campaign: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        ended = subprocess.run(
            [sys.executable, "-m", "cfid.cli.main", "watch", "--port", str(port)],
            cwd=campaign,
            check=False,
            capture_output=True,
            text=True,
            timeout=120,
        )
    assert ended.returncode == 2
    assert (
        ended.stderr == f"cfid: --port {port}: cannot be taken: Address already in use. Leave it out for a free one.\n"
    )


def test_without_bokeh_one_sentence_names_the_extra(campaign: Path) -> None:
    code = "import sys; sys.modules['bokeh'] = None\nfrom cfid.cli.main import main; main(['watch'])"
    words = [sys.executable, "-c", code]
    ended = subprocess.run(words, cwd=campaign, check=False, capture_output=True, text=True, timeout=120)
    assert ended.returncode == 2
    assert ended.stderr == 'cfid: cfid watch needs the library bokeh: install it with pip install "cfid[watch]".\n'
