"""Preflight of devices that send lines: their steps are judged by what is measured, their rate by the stated rate."""

import json
import re
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from cfid.console.preflight import judged
from cfid.estimate.battery_endurance import Held
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import EncoderLines, LineValue, LoadCellLines, new_rig_text
from cfid.rig.check import DeviceAnswer
from cfid.rig.ready_lines import record_of
from cfid.rig.sampling import Sampled
from tests.rig_in_a_folder import lab_in, rig_sim

Array = npt.NDArray[np.float64]

MASS_KG = 0.028
ONE, TWO = (Held(64000, motors, 10.0) for motors in (1, 2))  # 0.134 and 0.268 N of vehicles that lift twice their mass


def forces_judged(
    raw: Array, *, rate_hz: float, value: LineValue, plan: Held = TWO, lost: int = 0
) -> dict[str, DeviceAnswer]:
    """Return the answers about the raw numbers of a load cell (n,), one per period."""
    cell = LoadCellLines(kind="lines", port="/dev/null", rate_hz=rate_hz, values=(value,))
    columns = {"t": np.arange(len(raw)) / rate_hz, value.name: cell.factor(value) * raw} if len(raw) else {}
    found = judged(
        {"loadcell": record_of("loadcell", cell)}, {"loadcell": Sampled(columns, lost)}, [plan], mass_kg=MASS_KG
    )
    return {answer.asked: answer for answer in found["loadcell"]}


def grams(scale: float = 1.0) -> LineValue:
    return LineValue(name="Fz", unit="g", scale=scale)


@pytest.mark.parametrize("rate_hz", [1.0, 5.0, 10.0])
def test_slow_scales_that_keep_their_stated_rate_are_ready(rate_hz: float) -> None:
    readings = 12.3 + 0.1 * (np.arange(round(10 * rate_hz)) % 3 == 0)
    found = forces_judged(readings, rate_hz=rate_hz, value=grams())

    assert [found[line].state for line in ("rate", "losses", "steps of Fz")] == ["ok"] * 3


def test_scales_that_send_less_than_they_state_or_nothing_are_faults() -> None:
    assert forces_judged(np.arange(20) / 10, rate_hz=10, value=grams(), lost=20)["losses"].state == "fault"
    nothing = forces_judged(np.zeros(0), rate_hz=10, value=grams())["rate"]
    assert (nothing.state, nothing.answer) == ("fault", "0 samples")
    unmatched = forces_judged(np.zeros(0), rate_hz=10, value=grams(), lost=20)["rate"]
    assert (nothing.advice.split()[0], unmatched.advice.split(" with")[0]) == (
        "check",
        "compare baud, pattern and values of devices.loadcell in rig.toml",
    )


@pytest.mark.parametrize(
    ("step", "plan", "state"),
    [(0.1, ONE, "ok"), (1.0, TWO, "ok"), (1.0, ONE, "fault"), (5.0, TWO, "fault"), (20.0, TWO, "fault")],
)
def test_steps_are_judged_by_the_thrust_that_the_plan_gives(step: float, plan: Held, state: str) -> None:
    raw = np.round(1 + (np.arange(80) % 10 == 0)) * step
    found = forces_judged(raw, rate_hz=8, value=grams(), plan=plan)["steps of Fz"]

    assert found.state == state
    if state == "fault":
        assert f"{step * 9.80665:.2g} mN" in found.answer
        assert f"{0.04 * 1e3 * 2 * MASS_KG * 9.81 * plan.motors / 4 * 64000 / 65535:.2g} mN" in found.limit


def test_steps_of_readings_that_never_change_may_be_large_and_are_a_warning() -> None:
    found = forces_judged(np.full(80, 12.0), rate_hz=80, value=grams(-20))["steps of Fz"]

    assert found.state == "warning"
    assert "no change in 80 samples, whole numbers of 2e+02 mN" in found.answer
    assert forces_judged(np.full(80, 12.0), rate_hz=80, value=grams(0.01))["steps of Fz"].state == "ok"


def test_noise_beyond_the_steps_resolves_what_is_between_them() -> None:
    raw = np.round(np.random.default_rng(1).normal(0, 2, 800))

    assert forces_judged(raw, rate_hz=80, value=grams(5))["steps of Fz"].state == "ok"


@pytest.mark.parametrize(
    ("value", "counts_per_turn", "state"),
    [
        (LineValue(name="phi", unit="deg"), 0, "fault"),
        (LineValue(name="phi", unit="deg", scale=0.1), 0, "ok"),
        (LineValue(name="phi"), 4096, "ok"),
        (LineValue(name="phi"), 100, "fault"),
    ],
)
def test_steps_of_an_angle_are_judged_by_those_of_a_swing(value: LineValue, counts_per_turn: int, state: str) -> None:
    encoder = EncoderLines(kind="lines", port="/dev/null", rate_hz=100, values=(value,))
    scale = {"counts_per_turn": counts_per_turn} if counts_per_turn else {"angle_unit": "rad"}
    record = record_of("encoder", encoder, scale=scale)
    raw = 7.0 + (np.arange(200) == 50)
    columns = {"t": np.arange(200) / 100, "phi": encoder.factor(value) * raw}
    answers = judged({"encoder": record}, {"encoder": Sampled(columns)}, [], mass_kg=MASS_KG)["encoder"]

    assert {answer.asked: answer.state for answer in answers}["steps of phi"] == state


def swinging(
    readings_hz: float, value: LineValue, *, rate_hz: float = 500, swings_deg: float = 40.0
) -> dict[str, DeviceAnswer]:
    """Return the answers about two seconds of an encoder on a body that swings at 2.2 Hz."""
    encoder = EncoderLines(kind="lines", port="/dev/null", rate_hz=rate_hz, values=(value,))
    record = record_of("encoder", encoder, scale={"angle_unit": "rad"})
    time_s = np.arange(round(2 * rate_hz)) / rate_hz
    read_s = np.floor(time_s * readings_hz + 1e-6) / readings_hz
    noise_deg = 0.02 * np.random.default_rng(1).standard_normal(len(time_s))[np.round(read_s * rate_hz).astype(int)]
    shown = np.round((180 + swings_deg * np.cos(14 * read_s) + noise_deg) / value.scale)
    columns = {"t": time_s, "phi": encoder.factor(value) * shown}
    answers = judged({"encoder": record}, {"encoder": Sampled(columns)}, [], mass_kg=MASS_KG)["encoder"]
    return {answer.asked: answer for answer in answers}


def test_a_swing_is_no_noise_that_resolves_the_steps_of_an_angle() -> None:
    found = swinging(500, LineValue(name="phi", unit="deg"))["steps of phi"]

    assert (found.state, found.answer) == ("fault", "1 degrees")
    assert swinging(500, LineValue(name="phi", unit="deg", scale=0.01))["steps of phi"].state == "ok"


@pytest.mark.parametrize(("scale", "swings_deg"), [(0.01, 40.0), (0.088, 40.0), (1.0, 40.0), (0.01, 4.0), (0.088, 4.0)])
def test_readings_that_are_repeated_in_the_lines_of_a_moving_encoder_are_named(scale: float, swings_deg: float) -> None:
    found = swinging(50, LineValue(name="phi", unit="deg", scale=scale), swings_deg=swings_deg)

    assert found["readings"].state == "warning"
    assert found["readings"].answer == "each repeated in about 10 samples: 50 a second"


@pytest.mark.parametrize("scale", [0.01, 0.088, 1.0])
@pytest.mark.parametrize("swings_deg", [40.0, 4.0, 0.0])
@pytest.mark.parametrize("rate_hz", [50.0, 500.0])
def test_a_coarse_encoder_whose_readings_come_with_every_line_is_not_said_to_repeat_them(
    scale: float, swings_deg: float, rate_hz: float
) -> None:
    value = LineValue(name="phi", unit="deg", scale=scale)

    assert "readings" not in swinging(rate_hz, value, rate_hz=rate_hz, swings_deg=swings_deg)


RIG = """
[devices.encoder]
kind = "lines"
port = "/dev/null"
rate_hz = 200
values = [{ name = "phi", unit = "deg" }, { name = "device_us" }]

[devices.loadcell]
kind = "lines"
port = "/dev/null"
rate_hz = 5
values = [{ name = "Fz", unit = "g" }]
"""


def test_preflight_of_a_simulated_rig_with_lines_judges_all_of_it(tmp_path: Path) -> None:
    with lab_in(tmp_path) as lab:
        content = re.sub(r"(?ms)^\[devices\.\w+\].*?(?=^\[)", "", new_rig_text())
        (tmp_path / RIG_FILE).write_text(content + RIG)
        with rig_sim(lab):
            of_swing = lab.cfid("rig", "preflight", "swing", "--for", 1, "--json")
            of_thrust = lab.cfid("rig", "preflight", "thrust", "--for", 3, "--yes", "--json")

    swing, thrust = (json.loads(one.out)["devices"] for one in (of_swing, of_thrust))
    assert "steps of phi" in [one["asked"] for one in swing["encoder"]]
    lines = {one["asked"]: one["state"] for one in thrust["loadcell"]}
    assert (lines["rate"], lines["losses"], lines["steps of Fz"]) == ("ok", "ok", "ok")
    (balance,) = thrust["rotors"]
    assert (balance["state"], "3.5 kHz" in balance["answer"]) == ("ok", True)
