"""The clock of a file: rows show that of a Crazyflie's uSD-card log, at every rate; all other times are as written."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cfid.recordings.vehicle import VEHICLE_LOG, read_rows
from cfid.records.run import read_run
from tests.campaigns import Cfid
from tests.logs.usd_bytes import Record, bytes_of, written

GYRO = ("gyro.x(f)", "gyro.y(f)", "gyro.z(f)")
SLOW = 84 / 85


@pytest.fixture
def campaign(tmp_path: Path, cfid: Cfid) -> Path:
    assert cfid("new", tmp_path / "campaign").returncode == 0
    return tmp_path / "campaign"


def card(folder: Path, period_ms: float, rate: float, count: int = 300, event: str = "fixedFrequency") -> Path:
    """Write a log with rows every `period_ms`, whose microseconds run at a rate, with the delays of some writes."""
    late_us = np.random.default_rng(3).integers(0, 40, count)
    stamps = (rate * (5e6 + 1e3 * period_ms * np.arange(count) + late_us)).astype(int)
    records: list[Record] = [(65535, at, (row % 7, 0, 0)) for row, at in enumerate(stamps.tolist())]
    return written(folder, bytes_of([(65535, event, GYRO)], records))


def duration_s(folder: Path) -> float:
    time_s = read_rows(read_run(folder), VEHICLE_LOG).time_s
    return float(time_s[-1] - time_s[0])


def imported(cfid: Cfid, campaign: Path, file: Path, *options: str) -> Path:
    before = set((campaign / "runs").iterdir())
    answer = cfid("import", file, "--campaign", campaign, *options)
    assert answer.returncode == 0, answer.stderr
    (folder,) = set((campaign / "runs").iterdir()) - before
    return folder


@pytest.mark.parametrize("rate", [1.0, SLOW])
@pytest.mark.parametrize("frequency_hz", [1, 2, 5, 10, 12, 13, 15, 16, 20, 21, 25, 32, 100, 150, 500, 1000])
def test_a_card_s_log_gets_true_seconds_at_every_rate_by_either_clock(
    cfid: Cfid, campaign: Path, tmp_path: Path, frequency_hz: int, rate: float
) -> None:
    period_ms = 1000 // frequency_hz
    run = imported(cfid, campaign, card(tmp_path, period_ms, rate))
    assert duration_s(run) == pytest.approx(0.299 * period_ms, rel=3e-4)


def test_a_gyro_whose_own_rate_is_off_does_not_change_the_clock(cfid: Cfid, campaign: Path, tmp_path: Path) -> None:
    for off in (0.998, 1.002):
        for rate in (1.0, SLOW):
            run = imported(cfid, campaign, card(tmp_path, 10 * off, rate))
            assert duration_s(run) == pytest.approx(2.99 * off, rel=3e-4)


@pytest.mark.parametrize(
    ("period_ms", "count", "event"),
    [(1.31, 300, "fixedFrequency"), (1, 300, "estPosition"), (1, 40, "fixedFrequency")],
)
def test_a_card_s_log_that_shows_no_clock_is_not_read_until_the_option_states_it(
    cfid: Cfid, campaign: Path, tmp_path: Path, period_ms: float, count: int, event: str
) -> None:
    file = card(tmp_path, period_ms, SLOW, count, event)
    for words in (("import", file, "--campaign", campaign), ("show", file), ("convert", file, "--to", "csv")):
        refused = cfid(*words)
        assert refused.returncode == 2
        assert "--clock true or 84/85" in " ".join(refused.stderr.split())
    assert not list((campaign / "runs").iterdir())

    for clock, ratio in (("true", SLOW), ("84/85", 1.0)):
        run = imported(cfid, campaign, file, "--kind", "flight", "--clock", clock)
        assert duration_s(run) == pytest.approx(1e-3 * (count - 1) * period_ms * ratio, rel=1e-3)


@pytest.mark.parametrize("rate_hz", [24, 25, 101.19, 506])
def test_a_swing_whose_times_a_computer_wrote_keeps_them(
    cfid: Cfid, campaign: Path, tmp_path: Path, rate_hz: float
) -> None:
    time_s = np.arange(0, 14, 1 / rate_hz)
    swing = solve_ivp(
        lambda _, state: (state[1], -60 * np.sin(state[0]) - 0.1 * state[1]),
        (0, 14),
        (0.7, 0.0),
        t_eval=time_s,
        rtol=1e-10,
        atol=1e-12,
    )
    rate_dps = np.degrees(swing.y[1]) + np.random.default_rng(1).normal(0, 0.1, len(time_s))
    lines = [f"{t:.6f},0.1,0.2,{rate:.4f}\n" for t, rate in zip(time_s, rate_dps, strict=True)]
    (tmp_path / "swing.csv").write_text("timestamp [s],gyro.x,gyro.y,gyro.z\n" + "".join(lines))

    run = imported(cfid, campaign, tmp_path / "swing.csv", "--axis", "z")
    assert duration_s(run) == pytest.approx(time_s[-1], abs=1e-5)
    fitted = cfid("fit", "swing", run, "--json", "--no-figures", "--campaign", campaign)
    square = json.loads(fitted.stdout)["parameters"]["swing.natural_frequency_squared_s2"]["value"]
    assert square == pytest.approx(60.0, rel=1e-3)

    slow = imported(cfid, campaign, tmp_path / "swing.csv", "--axis", "z", "--clock", "84/85")
    assert duration_s(slow) == pytest.approx(time_s[-1] / SLOW, rel=1e-6)


def test_a_clock_is_refused_by_every_reader_that_does_not_use_it(cfid: Cfid, campaign: Path, tmp_path: Path) -> None:
    steps = np.arange(200)
    tables = {
        "angle.csv": ("t,phi_rad", [f"{at / 100},{np.cos(at / 9):.5f}" for at in steps]),
        "forces.csv": (
            "t [s],Fx [N],Fy [N],Fz [N],Tx [Nm],Ty [Nm],Tz [Nm]",
            [f"{at / 100},0,0,{at % 5},0,0,0" for at in steps],
        ),
        "stand.csv": ("t [s],cmd,thrust_n", [f"{at / 100},{at // 50 * 10000},{at // 50 / 10}" for at in steps]),
        "other.csv": ("t [s],a,b", [f"{at / 100},1,{at % 5}" for at in steps]),
    }
    for name, (head, lines) in tables.items():
        (tmp_path / name).write_text("\n".join([head, *lines, ""]))
        kind = ("--kind", "flight") if name == "other.csv" else ()
        for words in (
            ("import", tmp_path / name, *kind, "--campaign", campaign),
            ("convert", tmp_path / name, "--to", "csv", "--out", tmp_path / "out.csv"),
        ):
            assert cfid(*words).returncode == 0, (words, cfid(*words).stderr)
            (tmp_path / "out.csv").unlink(missing_ok=True)
            refused = cfid(*words, "--clock", "84/85")
            assert refused.returncode == 2, words
            assert "--clock" in refused.stderr
