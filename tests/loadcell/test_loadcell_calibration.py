"""Weights hung on a load cell with known faults give back its gains, cross-talk and linearity."""

import json
import math
import tomllib
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import ConfigError, DataError, FitError
from cfid.findings import texts
from cfid.loadcell import fit
from cfid.loadcell.estimation import AxisFit, Loads, applied_wrench, fit_axes, place_error
from cfid.loadcell.result import rig_keys
from cfid.recordings.read import read_recording
from cfid.recordings.wrench import wrench_of
from cfid.records.rig_file import LoadCellMount, RigFacts, Scales, change_rig, load_rig
from cfid.records.run import Label, Pull, Run
from tests.lab import Cfid, made_run, new_campaign, with_axes

Array = npt.NDArray[np.float64]

GRAVITY = 9.81
NOISE_N, NOISE_NM = 0.002, 2e-5  # standard deviations of one sample
COUNTS_PER_N, COUNTS_PER_NM = 1e6, 1e9
RATE_HZ, SAMPLES = 500.0, 500
AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
SHOWN = tuple(axis.capitalize() for axis in AXES)
WAYS = {"z": (0, 0, 1), "-z": (0, 0, -1), "x": (1, 0, 0), "-x": (-1, 0, 0), "y": (0, 1, 0), "-y": (0, -1, 0)}
ARMS_MM = [(0.0, 0.0, 10.0), (46.0, 0.0, 10.0), (-46.0, 0.0, 10.0), (0.0, 46.0, 10.0), (0.0, -46.0, 10.0)]
UPRIGHT = [("-z", 0.0, ARMS_MM[0]), *(("-z", grams, at) for grams in (20.0, 50.0, 100.0) for at in ARMS_MM)]
SIDES = [
    load
    for pull, arms in (
        ("x", [(0.0, 0.0, 40.0), (0.0, 0.0, 60.0), (0.0, 40.0, 50.0), (0.0, -40.0, 50.0)]),
        ("y", [(0.0, 0.0, 40.0), (0.0, 0.0, 60.0), (40.0, 0.0, 50.0), (-40.0, 0.0, 50.0)]),
    )
    for load in [(pull, 0.0, arms[0]), *((pull, grams, at) for grams in (20.0, 50.0, 100.0) for at in arms)]
]


class Cell:
    """A load cell with a matrix (6, 6) of gains and cross-talk, and gains that change by `bend` with the load."""

    def __init__(self, matrix: Array, *, bend: float = 0.0, largest: tuple[float, float] = (0.981, 0.981 * 0.046)):
        self.matrix, self.bend, self.largest = matrix, bend, np.repeat(largest, 3)

    def shows(self, force: Array, at: Array) -> Array:
        x, y, z = at
        torque = np.array([y * force[2] - z * force[1], z * force[0] - x * force[2], x * force[1] - y * force[0]])
        load = np.concatenate([force, torque])
        bent = self.bend * np.diag(self.matrix) * load * np.abs(load) / self.largest
        return np.asarray(self.matrix @ load + bent)


def cell_of(rng: np.random.Generator, bend: float = 0.0) -> Cell:
    """Return a load cell with random gains within 1 %, and random cross-talk of up to 1 % or 0.3 mm."""
    sizes = np.block([[np.full((3, 3), 0.01), np.full((3, 3), 0.1)], [np.full((3, 3), 3e-4), np.full((3, 3), 0.01)]])
    return Cell(np.eye(6) + sizes * rng.uniform(-1, 1, (6, 6)), bend=bend)


def record(
    folder: Path,
    cell: Cell,
    loads: list[tuple[str, float, tuple[float, float, float]]],
    *,
    seed: int = 1,
    at_std_mm: float = 0.0,
    weights_off: float = 0.0,
    weight_std_g: float | None = None,
    facts: RigFacts | None = None,
) -> list[Run]:
    """Write a run for each load; places err by `at_std_mm`, and all weights by the fraction `weights_off`."""
    rng = np.random.default_rng(seed)
    zeros = {way: rng.normal(0, 1, 6) * ([0.3] * 3 + [3e-3] * 3) for way in WAYS}
    runs = []
    for number, (pull, grams, at_mm) in enumerate(loads):
        force = np.array(WAYS[pull]) * GRAVITY * grams * 1e-3 * (1 + weights_off)
        at = (np.array(at_mm) + rng.normal(0, at_std_mm, 3)) * 1e-3
        noise = rng.normal(0, 1, (SAMPLES, 6)) * ([NOISE_N] * 3 + [NOISE_NM] * 3)
        wrench = zeros[pull] + cell.shows(force, at) + noise
        counts = np.rint(wrench * np.repeat([COUNTS_PER_N, COUNTS_PER_NM], 3)).astype(int)
        runs.append(
            made_run(
                folder,
                "loadcell",
                {"loadcell": {"t": 1.7e9 + np.arange(SAMPLES) / RATE_HZ, **dict(zip(SHOWN, counts.T, strict=True))}},
                label=Label(
                    pull=pull,
                    weight_g=grams or None,
                    weight_std_g=weight_std_g if grams else None,
                    at_mm=at_mm if grams else None,
                ),
                facts_of={"loadcell": {"counts_per_n": COUNTS_PER_N, "counts_per_nm": COUNTS_PER_NM}},
                started=datetime(2026, 11, 21, 8, 0, number, tzinfo=UTC),
                facts=facts or RigFacts(scales=Scales(linearity_std=0.001)),
            )
        )
    return runs


def true_keys(cell: Cell, found: dict[str, object]) -> dict[str, float]:
    """Return the true value of each key of a result."""
    truth = {}
    for key in found:
        name = key.rpartition(".")[2]
        if ".gain." in key:
            truth[key] = cell.matrix[AXES.index(name), AXES.index(name)]
        elif ".linearity." in key:
            truth[key] = cell.bend
        else:
            acting, _, shown = name.partition("_into_")
            truth[key] = cell.matrix[AXES.index(shown), AXES.index(acting)]
    return truth


def test_a_cell_turned_to_three_sides_shows_all_six_gains_and_its_cross_talk(tmp_path: Path) -> None:
    cell = cell_of(np.random.default_rng(5))
    result = fit(record(tmp_path, cell, UPRIGHT + SIDES), gravity_mps2=GRAVITY, at_std_m=2e-5)

    assert result.accepted
    assert {key for key in result.quantities if ".gain." in key} == {f"loadcell.gain.{axis}" for axis in AXES}
    assert result.quantities["loadcell.gain.fz"].unit == "1"
    for key, true in true_keys(cell, dict(result.quantities)).items():
        one = result.quantities[key]
        assert abs(one.value - true) < 3 * one.std, key
    assert result.quantities["loadcell.gain.fz"].std < 0.003
    assert abs(result.quantities["loadcell.cross_talk_nm_per_n.fz_into_tz"].std) < 1e-4


def test_an_upright_cell_shows_no_gain_of_what_was_not_loaded(tmp_path: Path) -> None:
    result = fit(record(tmp_path, cell_of(np.random.default_rng(6)), UPRIGHT), gravity_mps2=GRAVITY)

    assert {key for key in result.quantities if ".gain." in key} == {
        f"loadcell.gain.{axis}" for axis in ("fz", "tx", "ty")
    }
    assert "loadcell-axes-missing" in {one.code for one in result.findings}


def test_weights_at_one_place_do_not_separate_force_from_torque(tmp_path: Path) -> None:
    one_arm = [("-z", grams, (46.0, 0.0, 10.0)) for grams in (0.0, 20.0, 50.0, 100.0, 150.0)]
    runs = record(tmp_path, cell_of(np.random.default_rng(7)), one_arm)

    with pytest.raises(FitError, match="no gain"):
        fit(runs, gravity_mps2=GRAVITY)


def test_a_gain_that_changes_with_the_load_is_found_and_noted(tmp_path: Path) -> None:
    cell = Cell(np.eye(6), bend=0.02)
    result = fit(record(tmp_path, cell, UPRIGHT), gravity_mps2=GRAVITY, at_std_m=2e-5)

    one = result.quantities["loadcell.linearity.fz"]
    assert one.value == pytest.approx(0.02, abs=3 * one.std)
    assert one.std < 0.005
    assert result.quantities["loadcell.gain.fz"].value == pytest.approx(1.0, abs=0.005)
    assert "changes by 2" in " ".join(texts(result.findings, "note"))


def test_a_weight_with_another_label_is_rejected(tmp_path: Path) -> None:
    wrong_load = ("-z", 70.0, ARMS_MM[2])
    *right, wrong = record(tmp_path, Cell(np.eye(6)), [*UPRIGHT[1:], wrong_load])
    label = wrong.header.label.model_copy(update={"weight_g": 100.0})
    mistaken = Run(folder=wrong.folder, header=wrong.header.model_copy(update={"label": label}))
    result = fit([*right, mistaken], gravity_mps2=GRAVITY)

    assert not result.accepted
    assert "loadcell-misfit" in {one.code for one in result.findings}


def test_a_run_states_how_uncertain_its_weight_and_place_are(tmp_path: Path) -> None:
    runs = record(tmp_path, cell_of(np.random.default_rng(3)), UPRIGHT)

    def stated(**stds: float) -> list[Run]:
        headers = [
            run.header.model_copy(update={"label": run.header.label.model_copy(update=stds)})
            if run.header.label.weight_g
            else run.header
            for run in runs
        ]
        return [Run(folder=run.folder, header=header) for run, header in zip(runs, headers, strict=True)]

    key = "loadcell.gain.fz"
    exact, uncertain = fit(runs).quantities[key], fit(stated(weight_std_g=2.0)).quantities[key]
    assert float(uncertain.std) > 2 * float(exact.std)
    key = "loadcell.gain.ty"
    usual, same, moved = (fit(each).quantities[key] for each in (runs, stated(at_std_mm=0.2), stated(at_std_mm=5.0)))
    assert float(same.std) == pytest.approx(float(usual.std))
    assert float(moved.std) > 5 * float(same.std)


def test_the_scales_of_the_weights_are_a_common_cause_of_every_gain(tmp_path: Path) -> None:
    result = fit(record(tmp_path, Cell(np.eye(6)), UPRIGHT), gravity_mps2=GRAVITY)

    effects = result.common["scales"]
    assert effects["loadcell.gain.fz"] == pytest.approx([-0.001], rel=0.01)
    assert result.quantities["loadcell.gain.fz"].std > 0.001


def test_a_weight_that_hangs_25_times_leaves_the_gain_as_uncertain_as_itself(cfid: Cfid, tmp_path: Path) -> None:
    """The weight of 100 g is known to 1 %, and is 1 % heavier than stated."""
    new_campaign(tmp_path)
    loads = [("-z", grams, ARMS_MM[0]) for grams in (0.0, *[100.0] * 25, 0.0)]
    record(tmp_path, Cell(np.eye(6)), loads, weights_off=0.01, weight_std_g=1.0)

    gain = json.loads(cfid("fit", "loadcell", "--json").stdout)["parameters"]["loadcell.gain.fz"]
    assert gain["value"] == pytest.approx(1.01, abs=2e-4)
    assert gain["std"] == pytest.approx(0.01, rel=0.05)


@pytest.mark.parametrize("stated_in_the_rig", [True, False])
def test_the_uncertainty_of_gravity_is_that_of_every_gain(cfid: Cfid, tmp_path: Path, stated_in_the_rig: bool) -> None:
    new_campaign(tmp_path)
    record(tmp_path, Cell(np.eye(6)), UPRIGHT)
    words = () if stated_in_the_rig else ("--gravity-mps2", "9.81:0.05")
    if stated_in_the_rig:
        change_rig(tmp_path, "site", {"gravity_mps2": 9.81, "gravity_std_mps2": 0.05})

    gain = json.loads(cfid("fit", "loadcell", "--json", *words).stdout)["parameters"]["loadcell.gain.fz"]
    assert gain["std"] == pytest.approx(0.05 / 9.81, rel=0.1)


def test_runs_without_a_pull_and_runs_named_twice_are_refused(tmp_path: Path) -> None:
    runs = record(tmp_path, Cell(np.eye(6)), UPRIGHT[:2])
    bare = Run(folder=runs[0].folder, header=runs[0].header.model_copy(update={"label": Label()}))

    with pytest.raises(DataError, match="`pull`"):
        fit([bare])
    with pytest.raises(DataError, match="the same recording"):
        fit([runs[0], runs[0]])
    with pytest.raises(ConfigError):
        fit([])


def test_what_is_stored_changes_rig_toml_and_later_runs_are_divided_by_it(tmp_path: Path) -> None:
    new_campaign(tmp_path)
    matrix = np.eye(6)
    matrix[2, 2], matrix[5, 2] = 1.03, 2e-4
    result = fit(record(tmp_path, Cell(matrix), UPRIGHT), gravity_mps2=GRAVITY)
    cell = load_rig(tmp_path / "rig.toml").loadcell
    change_rig(tmp_path, "loadcell", rig_keys(result, gain=cell.gain, gain_std=cell.gain_std))

    text, after = (tmp_path / "rig.toml").read_text(), load_rig(tmp_path / "rig.toml")
    assert "# a calliper on a motor's mount" in text
    assert after.loadcell.gain is not None
    assert after.loadcell.gain_std is not None
    assert after.loadcell.gain[2] == pytest.approx(1.03, abs=0.005)
    assert after.loadcell.gain[5] == 1.0
    assert after.loadcell.gain_std[2] < 0.005
    assert after.loadcell.gain_std[5] == 0.006
    assert after.loadcell.cross_talk_std_nm_per_n is not None
    assert 5e-5 < after.loadcell.cross_talk_std_nm_per_n < 3e-4

    later = record(
        tmp_path / "later", Cell(matrix), [("-z", 0.0, ARMS_MM[0]), ("-z", 50.0, ARMS_MM[0])], facts=after.facts
    )
    empty, loaded = (wrench_of(read_recording(run.folder)).force_n[:, 2].mean() for run in later)
    assert loaded - empty == pytest.approx(-0.05 * GRAVITY, rel=0.004)
    assert (
        tomllib.loads((later[0].folder / "run.toml").read_text())["rig"]["loadcell"]["gain"][2]
        == after.loadcell.gain[2]
    )


@pytest.mark.parametrize("campaigns", [12, pytest.param(120, marks=pytest.mark.slow)])
def test_intervals_hold_the_truth_of_cells_with_cross_talk_bends_and_misplaced_weights(
    tmp_path: Path, campaigns: int
) -> None:
    held = total = 0
    for seed in range(campaigns):
        rng = np.random.default_rng(1000 + seed)
        cell = cell_of(rng, bend=float(rng.normal(0, 0.005)))
        off = float(rng.normal(0, 0.001))
        runs = record(tmp_path / str(seed), cell, UPRIGHT, seed=seed, at_std_mm=0.2, weights_off=off)
        result = fit(runs, gravity_mps2=GRAVITY, at_std_m=2e-4)
        inside = [
            abs(result.quantities[key].value - true) < 1.96 * result.quantities[key].std
            for key, true in true_keys(cell, dict(result.quantities)).items()
            if key.rpartition(".")[2] in {"fz", "tx", "ty"} or "fz_into" in key
        ]
        held, total = held + sum(inside), total + len(inside)
    few = campaigns < 100  # few campaigns: three binomial standard errors, for results with shared places
    lowest, highest = (0.88, 1.0) if few else (0.93, 0.975)
    assert lowest <= held / total <= highest, f"{held} of {total}"
    assert math.isfinite(held / total)


AT_M, AT_STD_M = np.array([0.046, -0.02, 0.01]), 1e-3
SIZES_N = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])


@pytest.mark.parametrize("pull", ["x", "-y", "-z"])
def test_an_uncertain_place_makes_the_torques_uncertain_as_draws_of_it_scatter(pull: Pull) -> None:
    rng = np.random.default_rng(4)
    drawn = [applied_wrench(weight_n=0.981, pull=pull, at_m=AT_M + rng.normal(0, AT_STD_M, 3)) for _ in range(4000)]
    stated = place_error(load=applied_wrench(weight_n=0.981, pull=pull, at_m=AT_M), std_m=AT_STD_M)

    assert stated == pytest.approx(np.std(drawn, axis=0), rel=0.05, abs=1e-12)


def fz_of(reading_n: np.ndarray[tuple[int, ...], np.dtype[np.float64]], std_n: float) -> AxisFit:
    """Return the fit of Fz to readings (n,) under pulls along z."""
    load, reading = np.zeros((len(SIZES_N), 6)), np.zeros((len(SIZES_N), 6))
    load[:, 2], reading[:, 2] = SIZES_N, reading_n
    std, exact = np.full_like(load, std_n), np.zeros((len(load), len(load)))
    orientation = np.zeros(len(load), dtype=np.intp)
    return fit_axes(Loads(load=load, reading=reading, std=std, of_weights=exact, orientation=orientation))["fz"]


def test_gain_and_linearity_scatter_and_covary_as_stated() -> None:
    rng = np.random.default_rng(5)
    gain, linearity, noise_n = 1.0, 0.5, 2e-3
    true_n = 0.3 + gain * (SIZES_N + linearity * SIZES_N**2)
    found = [fz_of(true_n + rng.normal(0, noise_n, len(SIZES_N)), noise_n) for _ in range(2000)]
    exact = fz_of(true_n, noise_n)

    assert exact.values == pytest.approx([gain, linearity])
    spread = np.cov([one.values for one in found], rowvar=False)
    assert np.sqrt(np.diag(exact.covariance)) == pytest.approx(np.sqrt(np.diag(spread)), rel=0.06)
    assert exact.covariance[0, 1] == pytest.approx(spread[0, 1], rel=0.1)


def test_a_cell_of_one_axis_shows_its_gain_and_names_the_others(tmp_path: Path) -> None:
    cell = cell_of(np.random.default_rng(6))
    runs = [with_axes(run, "Fz") for run in record(tmp_path, cell, UPRIGHT)]
    result = fit(runs, gravity_mps2=GRAVITY)

    one = result.quantities["loadcell.gain.fz"]
    assert {key for key in result.quantities if ".gain." in key} == {"loadcell.gain.fz"}
    assert abs(one.value - cell.matrix[2, 2]) < 3 * one.std
    assert "Fx, Fy, Tx, Ty, Tz" in " ".join(texts(result.findings, "note"))


def test_a_second_calibration_does_not_build_upon_the_first(tmp_path: Path) -> None:
    facts = RigFacts(loadcell=LoadCellMount(gain=(1.0, 1.0, 1.03, 1.0, 1.0, 1.0)))
    result = fit(record(tmp_path, Cell(np.diag([1, 1, 1.03, 1, 1, 1])), UPRIGHT, facts=facts), gravity_mps2=GRAVITY)

    assert result.quantities["loadcell.gain.fz"].value == pytest.approx(1.03, abs=0.005)
    assert "scale-taken-as-exact" in {one.code for one in result.findings}


def test_nothing_and_two_weights_in_one_place_give_the_gain_without_its_bend(tmp_path: Path) -> None:
    loads = [("-z", grams, (0.0, 0.0, 10.0)) for grams in (0.0, 50.0, 100.0)]
    result = fit(record(tmp_path, Cell(np.diag([1, 1, 1.01, 1, 1, 1])), loads), gravity_mps2=GRAVITY)

    assert result.quantities["loadcell.gain.fz"].value == pytest.approx(1.01, abs=1e-3)
    assert "loadcell.linearity.fz" not in result.quantities
