"""The 95 % intervals of rotors' rates contain the truth as often as they claim, and are no wider than that takes."""

from pathlib import Path

import numpy as np
import pytest

from cfid.motors.rotor.data import followed
from cfid.motors.rotor.estimation import FALL, RISE, RotorFit, fit_rotor
from tests.coverage_rows import Row
from tests.motors.rotor_plant import Plant, red, write_log, write_stand

PLANT = Plant()
THESIS = [level for step in np.linspace(0.2, 0.95, 8).tolist() for level in (0.0, step)]


def stand(folder: Path, seed: int, **how: object) -> RotorFit:
    write_stand(folder / "stand.csv", PLANT, seed, **how)  # type: ignore[arg-type]
    return fit_rotor(followed(folder / "stand.csv").rotors[0])


def log(folder: Path, seed: int, *, noise: float = 0.0, **how: object) -> RotorFit:
    table = write_log(folder / "log.csv", PLANT, seed, volts=False, **how)  # type: ignore[arg-type]
    table["rpm.m1"] += noise * red(np.random.default_rng(seed), len(table), samples=10)
    table.to_csv(folder / "log.csv", index=False)
    return fit_rotor(followed(folder / "log.csv").rotors[1])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "fitted", "how"),
    [
        ("stand, 15 steps between speeds, rows of 10 ms", stand, {}),
        ("stand, 8 steps from standstill, rows of 20 ms", stand, {"levels": THESIS, "hold_s": 1.5, "row_s": 0.02}),
        ("stand, speeds rounded to 380 rpm", stand, {"step": 40.0, "noise": 0.05}),
        ("log, commands at any time, rows of 10 ms", log, {"row_s": 0.01}),
        ("log, commands at any time, rows of 20 ms", log, {"row_s": 0.02}),
        ("log, red noise of 8 rad/s, rows of 2 ms", log, {"noise": 76.0}),
    ],
)
def test_intervals_of_rates_hold_the_truth(tmp_path: Path, name: str, fitted: object, how: dict[str, object]) -> None:
    fits = [fitted(tmp_path, seed, **how) for seed in range(30)]  # type: ignore[operator]
    for place, way in ((RISE, "rising"), (FALL, "falling")):
        true = np.log([PLANT.rate(fit.at_rad_s, rising=way == "rising") for fit in fits])
        error = np.array([fit.values[place] for fit in fits]) - true
        row = Row(f"{name}: {way}", error, np.array([fit.std[place] for fit in fits]))
        print(row)
        assert row.covers(), row
        assert row.ratio > 0.7, row
