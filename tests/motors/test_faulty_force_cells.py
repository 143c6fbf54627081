"""A load cell that drops out or has the wrong unit gives neither a good verdict nor a map."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from cfid.errors import DataError, FitError
from cfid.estimate.staircase import other_level
from cfid.motors import maps
from cfid.motors.maps.verdict import of_forces
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import new_rig_text
from cfid.records.run import Run, read_run
from cfid.sim.propulsion import RotorTruth
from tests.lab import with_axes
from tests.motors.stand_in_a_folder import climbed, write_run

Array = npt.NDArray[np.float64]

FILTERED = RotorTruth(unbalance=(0.01,) * 6, blade_pass=(0.01,) * 6)  # the amplifier averages vibration out
STEPS = tuple(range(0, 64001, 8000))


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """A staircase of two motors, recorded with an 80 Hz amplifier, 5 s per step."""
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    record = climbed(STEPS, rate_hz=80.0, hold_s=5.0, rest_s=3.0, spikes_per_s=0.0, rotors=FILTERED)
    return with_axes(write_run(tmp_path, record, steps=STEPS, motors=[1, 3], hold_s=5.0, rest_s=3.0), "Fz")


def changed(run: Run, change: Callable[[Array, Array], Array]) -> Run:
    """Rewrite Fz as the result of `change`, a function of Fz and of the command in each row."""
    path = run.device_file("loadcell")
    rows, log = pd.read_csv(path), pd.read_csv(run.device_file("commands"))
    command = log["m1"].to_numpy()[np.searchsorted(log["t"], rows["t"], side="right") - 1]
    rows["Fz"] = change(rows["Fz"].to_numpy(), command)
    rows.to_csv(path, index=False, float_format="%.6f")
    return read_run(run.folder)


def without_load(share: float, *, row: int = 1) -> Callable[[Array, Array], Array]:
    """Return a change that repeats the first reading in a share of the rows of running motors, `row` rows at a time."""

    def change(force_n: Array, command: Array) -> Array:
        drawn = np.random.default_rng(8).random(-(-len(force_n) // row)) < share
        return np.where(np.repeat(drawn, row)[: len(force_n)] & (command > 0), force_n[0], force_n)

    return change


@pytest.mark.parametrize(("share", "row"), [(0.3, 1), (0.1, 1), (0.1, 4), (0.6, 1)])
def test_an_amplifier_that_repeats_the_reading_without_load_gives_neither_verdict_nor_map(
    run: Run, share: float, row: int
) -> None:
    faulty = changed(run, without_load(share, row=row))

    with pytest.raises(DataError, match=r"two levels in .* drops out or repeats a reading.*its wires"):
        of_forces(faulty)
    with pytest.raises(DataError, match="lie far from the others"):
        maps.fit_thrust([faulty])


def test_a_step_in_which_readings_drop_out_is_left_out_and_the_others_count(run: Run) -> None:
    faulty = changed(
        run, lambda force_n, command: np.where(command == 40000, without_load(0.3)(force_n, command), force_n)
    )

    sound, found = maps.fit_thrust([run]), maps.fit_thrust([faulty])
    assert found.accepted, found.findings
    (left_out,) = (one.text for one in found.findings if one.code == "step-left-out")
    assert "command 40000" in left_out
    assert "7 of 8 steps are steady" in of_forces(faulty)
    largest, std = (found.quantities["motor.max_thrust_n"].value, found.quantities["motor.max_thrust_n"].std)
    assert abs(largest - sound.quantities["motor.max_thrust_n"].value) < 2 * std


@pytest.mark.parametrize("step_n", [0.0049, 0.0098])
@pytest.mark.parametrize("rows", [1, 8])
def test_readings_in_coarse_steps_that_a_slow_device_repeats_are_steady(run: Run, step_n: float, rows: int) -> None:
    def coarse(force_n: Array, _: Array) -> Array:
        held = np.repeat(force_n[::rows], rows)[: len(force_n)]
        return np.asarray(step_n * np.rint(held / step_n))

    left_out = maps.fit_thrust([changed(run, coarse)]).findings
    assert not [one.text for one in left_out if "drops out" in one.text]


def test_a_vibration_that_comes_and_goes_is_of_one_level() -> None:
    rng = np.random.default_rng(5)
    place = np.arange(2000)
    burst = np.sin(0.9 * place) * (np.sin(0.01 * place) > 0.8)

    assert not other_level(0.1 + 0.2 * burst + rng.normal(0, 1e-3, 2000))
    assert other_level(0.1 + 0.2 * np.abs(burst) + rng.normal(0, 1e-3, 2000))


def test_a_value_that_comes_back_within_a_vibration_is_another_level() -> None:
    place = np.arange(400)
    vibration = 0.1 + 0.2 * np.sin(0.9 * place)
    dropped = np.where(np.random.default_rng(3).random(400) < 0.1, 0.02, vibration)

    assert not other_level(vibration)
    assert "repeat 0.02 between others" in other_level(dropped)


@pytest.mark.parametrize(("factor", "hint"), [(1e3 / 9.80665, "grams of thrust"), (0.1, "implausible")])
def test_a_thrust_that_no_motor_of_the_platform_has_is_not_called_good(run: Run, factor: float, hint: str) -> None:
    wrong = changed(run, lambda force_n, _: factor * force_n)

    with pytest.raises(FitError, match=f"{hint}.*Check unit and scale of devices.loadcell"):
        of_forces(wrong)

    text = new_rig_text().replace('platform = "cf2"', 'platform = "other"')
    (run.folder.parents[1] / RIG_FILE).write_text(text)
    assert "8 of 8 steps are steady" in of_forces(wrong)


def test_two_steps_in_grams_that_are_stated_as_newtons_are_not_called_good_either(tmp_path: Path) -> None:
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    record = climbed((24000, 48000), rate_hz=80.0, hold_s=5.0, rest_s=3.0, spikes_per_s=0.0, rotors=FILTERED)
    short = write_run(tmp_path, record, steps=(24000, 48000), motors=[1, 3], hold_s=5.0, rest_s=3.0)
    wrong = changed(with_axes(short, "Fz"), lambda force_n, _: force_n * 1e3 / 9.80665)

    with pytest.raises(FitError, match="grams of thrust"):
        of_forces(wrong)
