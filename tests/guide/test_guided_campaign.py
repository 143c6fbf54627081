"""An operator who follows `cfid next` and types what it asks for ends with a complete campaign and its report."""

import json
import math
import os
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.rig.sim_file import SIM_FILE
from cfid.sim.propulsion import RotorTruth, WindTruth
from cfid.sim.truth import INERTIA_KG_M2
from tests.kept import sections_at
from tests.processes import started

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("in_time")]

LONGEST_S = 900.0
MARKERS = 2  # as in rig.toml
WINDS = ((0.0, 8, 3.1), (48.4, 8, 2.9), (77.9, 8, 3.6), (0.0, 10, 4.0), (48.4, 10, 3.7), (77.9, 6, 2.8))
FITS = {
    "inertia": {"inertia", "friction"},
    "full": {"inertia", "friction", "thrust", "torque", "speed", "latency", "tf", "drag"},
}


class Operator:
    """An operator at the simulated rig who follows `cfid next`."""

    def __init__(self, folder: Path, kind: str) -> None:
        self.folder = folder / "campaign"
        self.kind = kind
        self._winds = iter(WINDS)
        self.said(folder, "new", "campaign")

    def said(self, folder: Path, *words: str, typed: Sequence[object] = ()) -> str:
        """Run a command, which has to succeed, and return what it printed."""
        out, err = folder / ".out", folder / ".err"
        with out.open("wb") as output, err.open("wb") as errors:
            command = started(
                words,
                cwd=folder,
                env=os.environ,
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=errors,
            )
            command.communicate("".join(f"{line}\n" for line in typed).encode(), timeout=LONGEST_S)
        assert command.returncode == 0, (words, out.read_text(), err.read_text())
        return out.read_text()

    def status(self) -> dict[str, Any]:
        content: dict[str, Any] = json.loads(self.said(self.folder, "status", "--kind", self.kind, "--json"))
        return content

    def take_a_step(self) -> list[str]:
        """Do the next step and return its command."""
        words: list[str] = self.status()["next"]["command"]
        wind = next(self._winds) if "{wind}" in words else None
        answers = [] if wind is None else [wind[0], wind[1], f"{wind[2] - 0.1},{wind[2] + 0.1}"]
        with self._rig_for(words, wind):
            self.said(self.folder, "next", "--kind", self.kind, typed=[*answers, "y", *typed_for(words)])
        return words

    @contextmanager
    def _rig_for(self, words: list[str], wind: tuple[float, int, float] | None) -> Iterator[None]:
        if words[0] != "log":
            yield
            return
        truth = self.folder / ".truth.toml"
        truth.write_text("" if wind is None else f"[wind]\nangle_deg = {wind[0]}\nspeed_mps = {wind[2]}\n")
        place = [
            word for name in ("--axis", "--weight") if name in words for word in (name, words[words.index(name) + 1])
        ]
        command = ("rig", "sim", "--truth", truth, *place)
        with (self.folder / ".sim").open("wb") as said:
            rig = started(command, cwd=self.folder, env=os.environ, stdout=said, stderr=said)
        try:
            while not (self.folder / SIM_FILE).exists():
                assert rig.poll() is None, (self.folder / ".sim").read_text()
            yield
        finally:
            rig.send_signal(2)
            rig.wait(LONGEST_S)


def typed_for(words: list[str]) -> list[str]:
    """Return the answers to a command that runs motors: yes, and what a tachometer shows at each command."""
    if words[:2] == ["log", "speed"]:
        return ["y", *map(shown_rpm, range(0, 65536, 2000))]
    if "{wind}" in words:
        return ["y", *map(shown_rpm, (10000, 20000, 30000, 37300, 40000, 50000))]
    return ["y"]


def shown_rpm(command: int) -> str:
    """Return what a tachometer shows at a command; the reading is empty for a rotor that stands."""
    speed = RotorTruth().steady_rad_per_s(np.array(command), volts=3.7)
    return f"{MARKERS * 60 / math.tau * speed:.0f}" if command else ""


@pytest.mark.parametrize("kind", ["inertia", "full"])
def test_who_does_what_next_says_has_every_parameter_and_a_report_in_the_end(tmp_path: Path, kind: str) -> None:
    operator = Operator(tmp_path, kind)
    steps = [operator.take_a_step()]
    while steps[-1][0] != "report":
        assert len(steps) < 60, steps
        steps.append(operator.take_a_step())
        print(" ".join(steps[-1]))

    assert (operator.folder / "report.html").is_file()
    states = {task["fit"]: task["state"] for task in operator.status()["tasks"]}
    assert states == dict.fromkeys(FITS[kind], "accepted")
    found = {
        key: parameter
        for section in sections_at(operator.folder).values()
        for key, parameter in section.parameters.items()
    }
    matrix = found["inertia.matrix_kg_m2"]
    off = np.abs(np.array(matrix.value) - INERTIA_KG_M2) / np.array(matrix.std)
    assert off.max() < 4
    if kind == "full":
        drag = found["drag.simple_kg_per_rad"]
        assert np.all(np.abs(np.array(drag.value) - WindTruth().kg_per_rad) < 4 * np.array(drag.std))
        assert found["tf.time_constant_s"].value == pytest.approx(RotorTruth().time_constant_s, rel=0.03)
