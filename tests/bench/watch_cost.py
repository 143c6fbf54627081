"""What a viewer of `cfid watch` costs the recorder in one run: its processor time with and without a viewer, in turn.

A simulated load cell at 7 kHz is recorded; during every other part of the run, of BENCH_SECONDS each (10), a page is
open in headless Chromium. The bench also prints how many pictures per second the page drew, and the share of a core
that `cfid watch` itself took.
"""

import os
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from cfid.records.files import RIG_FILE
from cfid.records.rig_file import new_rig_text
from cfid.rig.sim_file import SIM_FILE
from tests.priority import ahead_of_others
from tests.rig_in_a_folder import wait_until
from tests.watch.browser import Page, browser_in

SECONDS = float(os.environ.get("BENCH_SECONDS", "10"))
PAIRS = 3
TICKS_PER_S = os.sysconf("SC_CLK_TCK")
CFID = (sys.executable, "-m", "cfid.cli.main")
SHOWN = "window.Bokeh?.documents[0]?.get_model_by_name('time')?.end > 1"
COUNT = """(() => { window.pictures = 0; const time = Bokeh.documents[0].get_model_by_name('time');
  time.properties.end.change.connect(() => requestAnimationFrame(() => { window.pictures += 1 })) })()"""


def used_s(process: "subprocess.Popen[str]") -> float:
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_PER_S


def shares(*processes: "subprocess.Popen[str]") -> list[float]:
    """Return the shares of a core in percent that processes use from now on."""
    begin_s, before = time.monotonic(), [used_s(process) for process in processes]
    time.sleep(SECONDS)
    spent_s = time.monotonic() - begin_s
    return [100 * (used_s(process) - was) / spent_s for process, was in zip(processes, before, strict=True)]


def started(folder: Path, *words: str) -> "subprocess.Popen[str]":
    environment = {**os.environ, "CFID_LOCKS": str(folder / "locks")}
    return subprocess.Popen([*CFID, *words], cwd=folder, env=environment, stderr=subprocess.PIPE, text=True)


def main() -> None:
    with tempfile.TemporaryDirectory() as name, ahead_of_others():
        folder = Path(name)
        (folder / RIG_FILE).write_text(new_rig_text())
        processes = [started(folder, "rig", "sim")]
        try:
            wait_until((folder / SIM_FILE).exists, SIM_FILE)
            recorder = started(folder, "log", "loadcell")
            processes.append(recorder)
            wait_until(lambda: list(folder.glob("runs/*/loadcell.csv")), "a recording")
            watcher = started(folder, "watch")
            processes.append(watcher)
            assert watcher.stderr is not None
            address = re.search(r"http://\S+", watcher.stderr.readline())
            assert address is not None
            measure(folder, recorder, watcher, address[0])
        finally:
            for process in reversed(processes):
                process.send_signal(signal.SIGTERM)
                process.communicate(timeout=60)


def measure(folder: Path, recorder: "subprocess.Popen[str]", watcher: "subprocess.Popen[str]", address: str) -> None:
    without, viewed, watching, pictures = [], [], [], []
    with browser_in(folder / "browser", behind=0) as browser:
        time.sleep(5)
        for _ in range(PAIRS):
            without += shares(recorder)
            page: Page = browser.open(address)
            page.wait_for(SHOWN)
            page.value(COUNT)
            begin_s = time.monotonic()
            recording, drawing = shares(recorder, watcher)
            pictures.append(page.value("window.pictures") / (time.monotonic() - begin_s))
            viewed.append(recording)
            watching.append(drawing)
            page.close()
            time.sleep(17)  # until the server has forgotten the viewer
    alone, seen = statistics.median(without), statistics.median(viewed)
    print(f"recorder at 7 kHz: {alone:.2f} % of a core without a viewer, {seen:.2f} % with one (medians of {PAIRS})")
    print(f"ratio {seen / alone:.3f}, difference {seen - alone:+.2f} % of a core (goal: below 1)")
    share, drawn = statistics.median(watching), statistics.median(pictures)
    print(f"cfid watch: {share:.1f} % of a core; {drawn:.1f} pictures a second")


if __name__ == "__main__":
    main()
