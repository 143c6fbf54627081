"""An operator who follows `cfid next` and types what it asks for ends with a complete campaign and its report."""

import json
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.cli.main import main
from cfid.records.rig_file import load_rig
from cfid.sim.devices import SimulatedRig
from cfid.sim.propulsion import RotorTruth, WindTruth
from cfid.sim.truth import INERTIA_KG_M2, SimTruth
from cfid.sim.virtual import Virtual
from tests.lab import run_cfid, sections_at
from tests.virtual_command import Command, Keyboard, PausingClock

pytestmark = pytest.mark.slow

PATIENCE_S = 1800.0  # of this computer's time, for one step: seven minutes of a load cell at 7 kHz
MARKERS = 2  # as in rig.toml
WINDS = ((0.0, 8, 3.1), (48.4, 8, 2.9), (77.9, 8, 3.6), (0.0, 10, 4.0), (48.4, 10, 3.7), (77.9, 6, 2.8))
FITS = {
    "inertia": {"inertia", "friction"},
    "full": {"inertia", "friction", "thrust", "torque", "speed", "latency", "tf", "drag"},
}


class Operator:
    """An operator at a simulated rig who follows `cfid next`."""

    def __init__(self, folder: Path, kind: str) -> None:
        self.folder, self.kind = folder / "campaign", kind
        self._winds = iter(WINDS)
        self._now_s = 1_763_712_345.0
        assert run_cfid(["new", "campaign", "--kind", "simulated"], folder).returncode == 0

    def status(self) -> dict[str, Any]:
        ended = run_cfid(["status", "--kind", self.kind, "--json"], self.folder)
        content: dict[str, Any] = json.loads(ended.stdout)
        return content

    def take_a_step(self) -> list[str]:
        """Do the next step and return its command."""
        words: list[str] = self.status()["next"]["command"]
        wind = next(self._winds) if "{wind}" in words else None
        answers = [] if wind is None else [wind[0], wind[1], f"{wind[2] - 0.1},{wind[2] + 0.1}"]
        hardware = self._rig_for(words, wind)
        keyboard = Keyboard()
        keyboard.type("".join(f"{line}\n" for line in (*answers, "y", *typed_for(words))))
        keyboard.hang_up()
        words_of_next = ("next", "--kind", self.kind)
        command = Command(hardware, self.folder, words_of_next, stdin=keyboard.stdin, patience_s=PATIENCE_S)
        assert command.run_to_end() == 0, (words, command.out, command.err)
        keyboard.close()
        self._now_s = hardware.unix_s() + 60
        return words

    def _rig_for(self, words: Sequence[str], wind: tuple[float, int, float] | None) -> Virtual:
        truth = {} if wind is None else {"wind": {"angle_deg": wind[0], "speed_mps": wind[2]}}
        place = {option: words[words.index(option) + 1] for option in ("--axis", "--weight") if option in words[:-1]}
        rig = load_rig(self.folder / "rig.toml")
        return Virtual(
            lambda seconds: SimulatedRig(
                rig,
                seconds=seconds,
                seed=1,
                truth=SimTruth.model_validate(truth),
                axis=place.get("--axis"),
                weight_g=float(place["--weight"].partition(":")[0]) if "--weight" in place else None,
            ),
            unix_s=self._now_s,
            time=PausingClock(),
        )


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
def test_who_does_what_next_says_has_every_parameter_and_a_report_in_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setattr(os, "execv", lambda _, command: main(command[command.index("cfid.cli.main") + 1 :]))
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
    assert np.abs((np.array(matrix.value) - INERTIA_KG_M2) / np.array(matrix.std)).max() < 4
    if kind == "full":
        drag = found["drag.simple_kg_per_rad"]
        assert np.all(np.abs(np.array(drag.value) - WindTruth().kg_per_rad) < 4 * np.array(drag.std))
        assert found["tf.time_constant_s"].value == pytest.approx(RotorTruth().time_constant_s, rel=0.03)
