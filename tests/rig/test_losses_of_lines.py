"""`cfid log` counts the lines that a device sent and that never came, at any loss, by its clock or the stated rate."""

import json
import os
import re
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cfid.records.files import RIG_FILE
from cfid.records.rig_file import new_rig_text
from tests.rig_in_a_folder import Lab, Said, lab_in

RATE_HZ = 200
_FORCE = "{ name = 'Fz', unit = 'mN' }"
EDGES = 0.1 * RATE_HZ  # lines that a busy computer may delay at either end


@contextmanager
def device(sent: Callable[[int], bytes], *, rate_hz: float) -> Iterator[str]:
    """Send line after line to a port on a grid of time; yield the port."""
    end, host = os.openpty()
    tty.setraw(host)
    ended = threading.Event()

    def send() -> None:
        begun_s, count = time.monotonic(), 0
        while not ended.wait(0.002):
            while count <= (time.monotonic() - begun_s) * rate_hz:
                os.write(end, sent(count))
                count += 1

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield os.ttyname(host)
    finally:
        ended.set()
        thread.join()
        os.close(end)
        os.close(host)


def logged(lab: Lab, port: str, *, clocked: bool) -> tuple[Said, dict[str, Any], int]:
    """Log a load cell whose force in mN numbers its lines.

    Returns what the command printed, its summary of the device, and how many lines are missing between the rows.
    """
    values = f"{{ name = 'device_us' }}, {_FORCE}" if clocked else _FORCE
    cell = f"[devices.loadcell]\nkind = 'lines'\nport = '{port}'\nrate_hz = {RATE_HZ}\nvalues = [{values}]\n"
    content = re.sub(r"(?ms)^\[devices\.\w+\].*?(?=^\[)", "", new_rig_text())
    (lab.folder / RIG_FILE).write_text(f"{content}\n{cell}")
    said = lab.cfid("log", "loadcell", "--for", 5, "--json")
    assert said.code == 0, said.err
    summary = json.loads(said.out)["devices"]["loadcell"]
    numbers = np.rint(1e3 * pd.read_csv(summary["file"])["Fz"].to_numpy()).astype(int)
    return said, summary, int(numbers[-1] - numbers[0] + 1 - len(numbers))


@pytest.mark.parametrize("clocked", [True, False], ids=["by its clock", "by the stated rate"])
@pytest.mark.parametrize("loss", [0.1, 0.2, 0.3, 0.4])
def test_the_counted_loss_is_the_true_one(tmp_path: Path, loss: float, clocked: bool) -> None:
    """The clock, and the samples, run 3 % faster than stated where the device sends one: the count is exact even so."""
    rng = np.random.default_rng(round(100 * loss))
    rate_hz = RATE_HZ * (1.03 if clocked else 1.0)
    come = rng.random(10_000) >= loss

    def line(number: int) -> bytes:
        stamp = b"%d," % round(1e6 * number / rate_hz) if clocked else b""
        return b"%s%d\n" % (stamp, number) if come[number] else b""

    with lab_in(tmp_path) as lab, device(line, rate_hz=rate_hz) as port:
        said, summary, missing = logged(lab, port, clocked=clocked)
        listed = json.loads(lab.cfid("runs", "--json").out)["runs"][0]

    assert missing == pytest.approx(loss * 5 * RATE_HZ, rel=0.25)
    assert summary["lost"] == pytest.approx(missing, abs=0 if clocked else EDGES)
    assert lab.run().header.devices["loadcell"].lost == listed["lost"] == summary["lost"]
    assert "rate_hz" not in said.err


def test_losses_are_unknown_where_more_lines_come_than_rig_toml_states(tmp_path: Path) -> None:
    with lab_in(tmp_path) as lab, device(lambda n: b"%d\n" % n, rate_hz=1.2 * RATE_HZ) as port:
        said, summary, _ = logged(lab, port, clocked=False)
        listed = json.loads(lab.cfid("runs", "--json").out)["runs"][0]
        shown = lab.cfid("show", "last", "--json")

    assert summary["lost"] is None
    assert 'lost = "unknown"' in (lab.run().folder / "run.toml").read_text()
    assert listed["lost"] == "?"
    assert "rate_hz" in said.err
    assert shown.code == 0
