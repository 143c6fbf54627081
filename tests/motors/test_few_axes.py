"""A load cell with one axis gives the same thrust as six axes, or torque by an arm, and reports what it cannot give."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.drag.data import reduce_run
from cfid.errors import CfidError, DataError, FitError
from cfid.motors import maps, vibration
from cfid.motors.maps.verdict import of_forces
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import new_rig_text
from cfid.records.run import Run, write_header
from cfid.sim.propulsion import RotorTruth
from tests.lab import Cfid, with_axes
from tests.motors.stand_in_a_folder import climbed, write_run

STEPS = tuple(range(0, 64001, 8000))
RATE_HZ = 80.0  # typical of load-cell amplifiers
HOLD_S = 5.0


def recorded(folder: Path, *axes: str, **more: Any) -> Run:
    folder.mkdir(exist_ok=True)
    (folder / RIG_FILE).write_text(new_rig_text())
    record = climbed(STEPS, rate_hz=RATE_HZ, hold_s=HOLD_S, rest_s=3.0, spikes_per_s=0.0, **more)
    run = write_run(folder, record, steps=STEPS, motors=[1, 3], hold_s=HOLD_S, rest_s=3.0)
    return with_axes(run, *axes) if axes else run


@pytest.fixture(scope="module")
def of_fz(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return recorded(tmp_path_factory.mktemp("fz"), "Fz")


def test_one_axis_gives_the_thrust_of_six(tmp_path: Path, of_fz: Run) -> None:
    one, six = maps.fit_thrust([of_fz]), maps.fit_thrust([recorded(tmp_path)])

    assert one.accepted, one.findings
    name = "motor.thrust_poly"
    # A tare's degrees of freedom are those of all axes of a record, which changes the weights a little.
    values, stds = (
        np.array([getattr(fit.quantities[name], field) for fit in (one, six)]) for field in ("value", "std")
    )
    assert np.all(np.abs(values[0] - values[1]) < 0.05 * stds[1])
    assert stds[0] == pytest.approx(stds[1], rel=0.02)
    assert one.figures()


def test_the_verdict_names_the_axis(of_fz: Run) -> None:
    assert "steps are steady, Fz from" in of_forces(of_fz)


def test_thrust_alone_gives_no_torque_and_says_so(of_fz: Run) -> None:
    with pytest.raises(FitError, match="torque_nm: it was not measured"):
        maps.fit_torque([of_fz])


def test_torque_by_an_arm_meets_the_thrust_of_another_run_by_command(tmp_path: Path, of_fz: Run) -> None:
    of_tz = recorded(tmp_path, "Tz", seed=4)

    result = maps.fit_torque([of_fz, of_tz])
    slope = result.quantities["motor.torque_poly"]
    assert result.accepted, result.findings
    assert abs(slope.value[0] - RotorTruth().torque_m) < 4 * slope.std[0]
    with pytest.raises(CfidError, match="thrust_n: it was not measured"):
        maps.fit_thrust([of_tz])


def test_a_wind_needs_all_forces(tmp_path: Path) -> None:
    run = recorded(tmp_path, "Fz")
    requested = {**run.header.requested, "wind_min_mps": 1.0, "wind_max_mps": 1.2}
    write_header(run.folder, run.header.model_copy(update={"kind": "wind", "requested": requested}))

    with pytest.raises(DataError, match="measured Fz alone, and drag needs Fx, Fy"):
        reduce_run(run.folder)


def test_speeds_from_vibration_that_sampling_folds_are_rejected(of_fz: Run) -> None:
    result = vibration.fit(of_fz)

    assert not result.accepted
    assert "vibration-aliased" in {one.code for one in result.findings}


def test_show_names_the_axis_and_draws_it(cfid: Cfid, of_fz: Run) -> None:
    said = cfid("show", of_fz.folder, "--json", folder=of_fz.folder.parents[1])

    assert said.returncode == 0, said.stderr
    assert "mean.Fz" in said.stdout
    assert "mean_nm" not in said.stdout
