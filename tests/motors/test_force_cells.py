"""Load cells with one axis, with faults or with a clock of their own: the map of six axes, or a refusal."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from cfid.drag.data import reduce_run as reduce_wind
from cfid.errors import DataError, FitError
from cfid.estimate.staircase import other_level
from cfid.motors import maps, vibration
from cfid.motors.data import reduce_run
from cfid.motors.maps.verdict import of_forces
from cfid.motors.rotor.data import followed
from cfid.recordings.read import read_recording
from cfid.recordings.wrench import AXES, wrench_of
from cfid.records.run import Run, read_run, write_header
from cfid.sim.propulsion import RotorTruth
from tests.lab import codes, made_run, new_campaign, with_axes
from tests.motors.stand_in_a_folder import BEGIN_S, climbed, write_run

Array = npt.NDArray[np.float64]

FILTERED = RotorTruth(unbalance=(0.01,) * 6, blade_pass=(0.01,) * 6)  # the amplifier averages vibration out
STEPS = tuple(range(0, 64001, 8000))
HOW: dict[str, Any] = {"motors": [1, 3], "hold_s": 5.0, "rest_s": 3.0}


def recorded(folder: Path, *axes: str, **more: Any) -> Run:
    """Write a staircase of two motors, recorded with an 80 Hz amplifier, 5 s per step."""
    new_campaign(folder)
    record = climbed(STEPS, rate_hz=80.0, hold_s=5.0, rest_s=3.0, spikes_per_s=0.0, **more)
    run = write_run(folder, record, steps=STEPS, **HOW)
    return with_axes(run, *axes) if axes else run


@pytest.fixture(scope="module")
def of_fz(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return recorded(tmp_path_factory.mktemp("fz"), "Fz")


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return recorded(tmp_path, "Fz", rotors=FILTERED)


def test_one_axis_gives_the_thrust_of_six_and_no_torque(tmp_path: Path, of_fz: Run) -> None:
    one, six = maps.fit_thrust([of_fz]), maps.fit_thrust([recorded(tmp_path)])

    assert one.accepted, one.findings
    # A tare's degrees of freedom are those of all axes of a record, which changes the weights a little.
    value, std = (
        np.array([getattr(fit.quantities["motor.thrust_poly"], field) for fit in (one, six)])
        for field in ("value", "std")
    )
    assert np.all(np.abs(value[0] - value[1]) < 0.05 * std[1])
    assert std[0] == pytest.approx(std[1], rel=0.02)
    assert one.figures()
    assert "steps are steady, Fz from" in of_forces(of_fz)
    with pytest.raises(FitError, match="torque_nm"):
        maps.fit_torque([of_fz])


def test_torque_by_an_arm_meets_the_thrust_of_another_run_by_command(tmp_path: Path, of_fz: Run) -> None:
    of_tz = recorded(tmp_path, "Tz", seed=4)
    result = maps.fit_torque([of_fz, of_tz])
    slope = result.quantities["motor.torque_poly"]

    assert result.accepted, result.findings
    assert abs(slope.value[0] - RotorTruth().torque_m) < 4 * slope.std[0]
    with pytest.raises(FitError, match="thrust_n"):
        maps.fit_thrust([of_tz])


def test_what_one_axis_at_80_hz_cannot_show_is_refused(tmp_path: Path, of_fz: Run) -> None:
    speeds = vibration.fit(of_fz)
    assert not speeds.accepted
    assert "vibration-aliased" in codes(speeds)

    run = recorded(tmp_path, "Fz")
    requested = {**run.header.requested, "wind_min_mps": 1.0, "wind_max_mps": 1.2}
    write_header(run.folder, run.header.model_copy(update={"kind": "wind", "requested": requested}))
    with pytest.raises(DataError, match="drag needs Fx, Fy"):
        reduce_wind(run.folder)


# Faults


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


@pytest.mark.parametrize(("share", "row"), [(0.1, 1), (0.1, 4), (0.6, 1)])
def test_an_amplifier_that_repeats_the_reading_without_load_gives_neither_verdict_nor_map(
    run: Run, share: float, row: int
) -> None:
    faulty = changed(run, without_load(share, row=row))

    with pytest.raises(DataError, match="two levels"):
        of_forces(faulty)
    with pytest.raises(DataError, match="lie far from the others"):
        maps.fit_thrust([faulty])


def test_a_step_in_which_readings_drop_out_is_left_out_and_the_others_count(run: Run) -> None:
    key = "motor.max_thrust_n"
    largest_n = maps.fit_thrust([run]).quantities[key].value
    faulty = changed(
        run, lambda force_n, command: np.where(command == 40000, without_load(0.3)(force_n, command), force_n)
    )
    result = maps.fit_thrust([faulty])

    assert result.accepted, result.findings
    assert "command 40000" in next(one.text for one in result.findings if one.code == "step-left-out")
    assert "7 of 8 steps are steady" in of_forces(faulty)
    assert abs(result.quantities[key].value - largest_n) < 2 * result.quantities[key].std


@pytest.mark.parametrize("rows", [1, 8])
def test_readings_in_coarse_steps_that_a_slow_device_repeats_are_steady(run: Run, rows: int) -> None:
    def coarse(force_n: Array, _: Array) -> Array:
        held = np.repeat(force_n[::rows], rows)[: len(force_n)]
        return np.asarray(0.0098 * np.rint(held / 0.0098))

    left_out = maps.fit_thrust([changed(run, coarse)]).findings
    assert not [one.text for one in left_out if "drops out" in one.text]


def test_a_second_level_is_told_from_a_vibration_that_comes_and_goes() -> None:
    rng, place = np.random.default_rng(5), np.arange(2000)
    burst = np.sin(0.9 * place) * (np.sin(0.01 * place) > 0.8)
    vibration_n, noise = 0.1 + 0.2 * np.sin(0.9 * place), rng.normal(0, 1e-3, 2000)

    assert not other_level(0.1 + 0.2 * burst + noise)
    assert not other_level(vibration_n)
    assert other_level(0.1 + 0.2 * np.abs(burst) + noise)
    assert "0.02" in other_level(np.where(rng.random(2000) < 0.1, 0.02, vibration_n))


@pytest.mark.parametrize(("factor", "hint"), [(1e3 / 9.80665, "grams of thrust"), (0.1, "implausible")])
def test_a_thrust_that_no_motor_of_the_platform_has_is_not_called_good(run: Run, factor: float, hint: str) -> None:
    wrong = changed(run, lambda force_n, _: factor * force_n)
    with pytest.raises(FitError, match=hint):
        of_forces(wrong)

    new_campaign(run.folder.parents[1], ('platform = "cf2"', 'platform = "other"'))
    assert "8 of 8 steps are steady" in of_forces(wrong)


def test_commands_lie_where_they_lay_among_forces_that_arrived_in_a_late_burst(tmp_path: Path) -> None:
    """The load cell's own clock times its rows; the first 800 arrive 0.2 s after the first was taken."""
    record = climbed([20000, 40000], motors=(1,), rate_hz=4000, spikes_per_s=0)
    forces = {"t": BEGIN_S + np.maximum(record.time_s, 0.2), **dict(zip(AXES, record.wrench.T, strict=True))}
    commands = dict(zip(("m1", "m2", "m3", "m4"), record.commands.astype(np.int64).T, strict=True))
    devices = {
        "loadcell": {**forces, "device_us": np.rint(1e6 * record.time_s).astype(np.int64)},
        "commands": {"t": BEGIN_S + record.command_time_s, **commands},
    }
    run = made_run(tmp_path, "thrust", devices, facts_of={"loadcell": {"units": "n,nm"}})
    rotor = followed(run).rotors[0]

    assert reduce_run(wrench_of(read_recording(run.folder))).began_s == pytest.approx(BEGIN_S, abs=2e-3)
    changes_s = rotor.begin_s[1:][np.diff(rotor.command) != 0]
    driven_s = record.command_time_s[1:][np.diff(record.commands.max(axis=1)) != 0]
    np.testing.assert_allclose(changes_s, driven_s, atol=2e-3)
