"""Preflight of devices that send lines: their steps are judged by what is measured, their rate by the stated rate."""

import numpy as np
import numpy.typing as npt
import pytest

from cfid.console.preflight import judged
from cfid.estimate.battery_endurance import Held
from cfid.records.rig_file import EncoderLines, LineValue, LoadCellLines
from cfid.rig.check import DeviceAnswer
from cfid.rig.recorder import Sampled
from cfid.rig.text_lines import _record as record_of

Array = npt.NDArray[np.float64]

MASS_KG = 0.028
ONE, TWO = (Held(64000, motors, 10.0) for motors in (1, 2))  # 0.134 and 0.268 N of vehicles that lift twice their mass
CHANGING = 1.0 + (np.arange(80) % 10 == 0)
NOISY = np.round(np.random.default_rng(1).normal(0, 2, 800))


def forces_judged(
    raw: Array, *, rate_hz: float = 80.0, scale: float = 1.0, plan: Held = TWO, lost: int = 0
) -> dict[str, DeviceAnswer]:
    """Return the answers about the raw numbers of scales in grams times `scale` (n,), one per period."""
    value = LineValue(name="Fz", unit="g", scale=scale)
    cell = LoadCellLines(kind="lines", port="/dev/null", rate_hz=rate_hz, values=(value,))
    columns = {"t": np.arange(len(raw)) / rate_hz, "Fz": cell.factor(value) * raw} if len(raw) else {}
    records = {"loadcell": record_of("loadcell", cell, {})}
    answers = judged(records, {"loadcell": Sampled(columns, lost)}, [plan], mass_kg=MASS_KG)["loadcell"]
    return {answer.asked: answer for answer in answers}


@pytest.mark.parametrize("rate_hz", [1.0, 5.0, 10.0])
def test_slow_scales_that_keep_their_stated_rate_are_ready(rate_hz: float) -> None:
    found = forces_judged(12.3 + 0.1 * (np.arange(round(10 * rate_hz)) % 3 == 0), rate_hz=rate_hz)

    assert [found[line].state for line in ("rate", "losses", "steps of Fz")] == ["ok"] * 3


def test_scales_that_send_less_than_they_state_or_nothing_are_faults() -> None:
    assert forces_judged(np.arange(20) / 10, rate_hz=10, lost=20)["losses"].state == "fault"
    silent, unmatched = (forces_judged(np.zeros(0), rate_hz=10, lost=lost)["rate"] for lost in (0, 20))
    assert (silent.state, silent.answer) == ("fault", "0 samples")
    assert "pattern" in unmatched.advice
    assert "pattern" not in silent.advice


@pytest.mark.parametrize(
    ("raw", "scale", "plan", "state"),
    [
        (CHANGING, 0.1, ONE, "ok"),
        (CHANGING, 1.0, TWO, "ok"),
        *((CHANGING, scale, plan, "fault") for scale, plan in ((1.0, ONE), (5.0, TWO), (20.0, TWO))),
        (np.full(80, 12.0), -20, TWO, "warning"),  # readings that never change may have large steps
        (np.full(80, 12.0), 0.01, TWO, "ok"),
        (NOISY, 5.0, TWO, "ok"),  # noise beyond the steps resolves what is between them
    ],
)
def test_steps_are_judged_by_the_thrust_that_the_plan_gives(raw: Array, scale: float, plan: Held, state: str) -> None:
    found = forces_judged(raw, scale=scale, plan=plan)["steps of Fz"]

    assert found.state == state
    if state == "fault":
        assert f"{scale * 9.80665:.2g} mN" in found.answer
        assert f"{0.04 * 1e3 * 2 * MASS_KG * 9.81 * plan.motors / 4 * 64000 / 65535:.2g} mN" in found.limit


def angles_judged(raw: Array, value: LineValue, *, rate_hz: float, turn: int = 0) -> dict[str, DeviceAnswer]:
    """Return the answers about the raw numbers of an encoder (n,), in counts where a turn has some."""
    encoder = EncoderLines(kind="lines", port="/dev/null", rate_hz=rate_hz, values=(value,))
    records = {"encoder": record_of("encoder", encoder, {"counts_per_turn": turn} if turn else {"angle_unit": "rad"})}
    columns = {"t": np.arange(len(raw)) / rate_hz, "phi": encoder.factor(value) * raw}
    answers = judged(records, {"encoder": Sampled(columns)}, [], mass_kg=MASS_KG)["encoder"]
    return {answer.asked: answer for answer in answers}


def degrees(scale: float = 1.0) -> LineValue:
    return LineValue(name="phi", unit="deg", scale=scale)


@pytest.mark.parametrize(
    ("value", "turn", "state"),
    [
        (degrees(), 0, "fault"),
        (degrees(0.1), 0, "ok"),
        (LineValue(name="phi"), 4096, "ok"),
        (LineValue(name="phi"), 100, "fault"),
    ],
)
def test_steps_of_an_angle_are_judged_by_those_of_a_swing(value: LineValue, turn: int, state: str) -> None:
    raw = 7.0 + (np.arange(200) == 50)

    assert angles_judged(raw, value, rate_hz=100, turn=turn)["steps of phi"].state == state


def swinging(
    readings_hz: float, scale: float, *, rate_hz: float = 500, swings_deg: float = 40.0
) -> dict[str, DeviceAnswer]:
    """Return the answers about two seconds of an encoder on a body that swings at 2.2 Hz."""
    time_s = np.arange(round(2 * rate_hz)) / rate_hz
    read_s = np.floor(time_s * readings_hz + 1e-6) / readings_hz
    noise_deg = 0.02 * np.random.default_rng(1).standard_normal(len(time_s))[np.round(read_s * rate_hz).astype(int)]
    raw = np.round((180 + swings_deg * np.cos(14 * read_s) + noise_deg) / scale)
    return angles_judged(raw, degrees(scale), rate_hz=rate_hz)


@pytest.mark.parametrize(("scale", "state"), [(1.0, "fault"), (0.01, "ok")])
def test_a_swing_is_no_noise_that_resolves_the_steps_of_an_angle(scale: float, state: str) -> None:
    assert swinging(500, scale)["steps of phi"].state == state


@pytest.mark.parametrize("scale", [0.01, 0.088, 1.0])
@pytest.mark.parametrize("swings_deg", [40.0, 4.0, 0.0])
def test_readings_that_are_repeated_in_lines_are_named_and_a_coarse_encoder_is_not_said_to_repeat_them(
    scale: float, swings_deg: float
) -> None:
    for rate_hz in (50.0, 500.0):
        assert "readings" not in swinging(rate_hz, scale, rate_hz=rate_hz, swings_deg=swings_deg)
    if swings_deg and (scale < 1 or swings_deg > 4):
        repeated = swinging(50, scale, swings_deg=swings_deg)["readings"]
        assert repeated.state == "warning"
        assert "10 samples: 50 a second" in repeated.answer
