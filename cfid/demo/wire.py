"""Record the demo in real time: serve a simulated rig on real wires, and run the operator's log commands on it."""

import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cfid.console.messages import headline
from cfid.console.processes import cfid_command
from cfid.errors import DeviceError
from cfid.records.campaign import Campaign
from cfid.rig.sim_file import SIM_FILE

# The list is short, since each command takes as long as on a real rig: about two minutes in total.
LOGS = (
    "log encoder --axis x --for 14",
    "log thrust --from 16000 --to 64000 --step 16000 --hold 3 --rest 1.5 --rate-hz 1000 --yes",
    "log sine --periods 2,8,30 --samples 2000 --yes",
    "log ping --count 100 --interval 0.05",
)

_STARTS_WITHIN_S = 30.0
_LOOKS_EVERY_S = 0.1


def record_over_wires(campaign: Campaign, *, truth: Path | None, seed: int) -> None:
    """Serve a rig and record the LOGS from it. Raises DeviceError, which names the command that failed."""
    with _served(campaign.folder, truth=truth, seed=seed):
        for words in LOGS:
            headline(f"\n$ cfid {words}")
            if subprocess.run(cfid_command(*words.split()), cwd=campaign.folder, check=False).returncode:
                raise DeviceError(f"cfid {words} failed; {campaign.folder} keeps what was recorded.")


@contextmanager
def _served(folder: Path, *, truth: Path | None, seed: int) -> Iterator[None]:
    known = [] if truth is None else ["--truth", str(truth.resolve())]
    words = cfid_command("rig", "sim", "--axis", "x", "--seed", str(seed), *known)
    with subprocess.Popen(words, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as rig:
        try:
            _wait_for(folder / SIM_FILE, rig)
            yield
        finally:
            rig.terminate()


def _wait_for(file: Path, rig: subprocess.Popen[str]) -> None:
    end_s = time.monotonic() + _STARTS_WITHIN_S
    while not file.exists():
        if rig.poll() is not None or time.monotonic() > end_s:
            rig.terminate()
            raise DeviceError(f"the simulated rig did not start: {rig.communicate()[1].strip()}")
        time.sleep(_LOOKS_EVERY_S)
