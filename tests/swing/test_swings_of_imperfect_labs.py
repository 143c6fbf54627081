"""Swings as an imperfect lab records them: an eccentric encoder, windows set by hand, numbers in a wrong unit.

The plant is a fixed-step integrator of its own.
"""

import ctypes
import math
from collections.abc import Callable
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.stats import beta

import cfid.swing
from cfid.errors import ConfigError, FitError
from cfid.recordings.angle import AngleRecord, labelled
from cfid.records.parameters import Source
from cfid.records.result import Result
from cfid.records.rig_file import load_rig, new_rig_text
from cfid.records.run import DeviceRecord, Label
from cfid.records.run_writer import create_run
from cfid.sim.app_core import compiled
from cfid.swing.estimation import SwingFit, fit_swing
from cfid.swing.window import find_swing
from cfid.units import CRYSTAL_STD

Array = npt.NDArray[np.float64]

ROW_S = 1e-3
STEP_S = 5e-4
FINE_STEP_S = 1e-4  # within a coarse step, a jump of dry friction changes W by up to 6e-6, an interval's width
HELD_S = 1.0
SLIP_RAD_PER_S = 2e-3  # dry friction changes its sign within this speed
STRIBECK_RAD_PER_S = 0.5  # within which dry friction is larger, if `stribeck` is set


class Trials:
    """Randomly drawn pendulums (n,), with friction divided by inertia."""

    def __init__(
        self, rng: np.random.Generator, count: int, *, stribeck: float = 0.0, cable: float = 0.0, ripple_nm: float = 0.0
    ) -> None:
        """Draw the pendulums.

        `stribeck` is the relative excess of dry friction at standstill. `cable` is the ratio of a cable's stiffness to
        that of gravity. `ripple_nm` is the standard deviation of dry friction that varies with the cosine of the angle.
        """
        inertia = rng.uniform(3.1e-5, 7e-5, count)
        self.frequency_squared_s2 = 0.028 * 9.81 * rng.uniform(0.0229, 0.038, count) / inertia
        self.viscous = rng.uniform(0.5, 2, count) * 1.2e-5 / inertia
        self.coulomb = rng.uniform(0.2, 1, count) * 3e-5 / inertia
        self.quadratic = rng.uniform(0, 2, count) * 2e-8 / inertia
        self.release_rad = np.radians(rng.uniform(40, 60, count))
        self.stribeck, self.cable = stribeck, cable
        self.ripple: Array | None = ripple_nm * rng.standard_normal(count) / inertia if ripple_nm else None

    def swung(self, duration_s: float, step_s: float = STEP_S) -> tuple[Array, Array]:
        """Return times (t,) every millisecond and angles (t, n): at rest, lifted, held, let go."""
        lift = np.clip(3 * np.linspace(0, 1, round(HELD_S / ROW_S)) - 1, 0, 1)
        rows = round((duration_s - HELD_S) / ROW_S)
        each = (self.frequency_squared_s2, self.viscous, self.coulomb, self.quadratic, self.release_rad)
        ripple = np.zeros_like(self.release_rad) if self.ripple is None else self.ripple
        angles = np.zeros((len(self.release_rad), rows))
        for place, angle in enumerate(angles):
            of_one = [*(values[place] for values in each), self.stribeck, self.cable, ripple[place]]
            numbers = np.array([*of_one, SLIP_RAD_PER_S, STRIBECK_RAD_PER_S])
            _compiled()(numbers, step_s, rows, round(ROW_S / step_s), angle)
        kept = np.concatenate([lift[:, np.newaxis] * self.release_rad, angles.T])
        return ROW_S * np.arange(0.0, len(kept)), kept


@cache
def _compiled() -> Callable[..., None]:
    """Return the function that swings one pendulum; its steps in C take a hundredth of the time of steps in NumPy."""
    step_by_step = compiled(Path(__file__).with_name("swung.c")).swing
    numbers = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")
    step_by_step.argtypes = [numbers, ctypes.c_double, ctypes.c_int, ctypes.c_int, numbers]
    step_by_step.restype = None
    return step_by_step


def encoded(angle_rad: Array, rng: np.random.Generator, *, eccentric_rad: float = 0.0, phase_rad: float = 1.0) -> Array:
    """Return an encoder's readings (t,): 8192 counts a turn, the disc off the axis in one direction from rest."""
    read = angle_rad + rng.uniform(0, 2 * math.pi) + eccentric_rad * np.sin(angle_rad + phase_rad)
    return np.asarray(2 * math.pi / 8192 * np.floor(read / (2 * math.pi / 8192)))


@cache
def one_swing() -> tuple[Array, Array, float]:
    trials = Trials(np.random.default_rng(3), 1)
    time_s, angle = trials.swung(9.0)
    return time_s, angle[:, 0], float(trials.frequency_squared_s2[0])


def recorded(angle: Array, label: Label) -> AngleRecord:
    time_s = one_swing()[0]
    source = Source("one.csv", "0" * 64)
    return AngleRecord(path=Path("one.csv"), source=source, label=label, time_s=time_s, angle_rad=angle, findings=())


def error_and_std(fit: SwingFit, truth: float) -> tuple[float, float]:
    """Return the error of W and its standard uncertainty, relative to the truth."""
    found, std = (one.natural_frequency_squared_s2 for one in (fit.coefficients, fit.std))
    return float(found / truth) - 1, float(std / truth)


@pytest.mark.parametrize(("friction", "count"), [("low speed", 2), ("angle", 1), ("angle alone", 1)])
def test_dry_friction_that_varies_leaves_the_frequency_within_three_standard_uncertainties(
    friction: str, count: int
) -> None:
    trials = Trials(np.random.default_rng(5), count, stribeck=0.5 if friction == "low speed" else 0.0)
    if friction == "angle":
        trials.ripple = 0.7 * trials.coulomb
    elif friction == "angle alone":  # hardly any friction at the rest angle, more to either side
        trials.coulomb[:] = 0.9
        trials.ripple = -0.97 * trials.coulomb
    time_s, angle = trials.swung(14.0, FINE_STEP_S)
    for column, truth in zip(angle.T, trials.frequency_squared_s2, strict=True):
        fit = fit_swing(find_swing(time_s, encoded(column, np.random.default_rng(5))))
        error, std = error_and_std(fit, truth)

        assert abs(error) < 3 * std < 1e-3
        assert "swing-cable-or-encoder" not in {finding.code for finding in fit.findings}


@pytest.mark.parametrize("noise_rad", [0.02, 0.03])
def test_a_swing_in_noise_of_degrees_is_within_its_interval_or_rejected(noise_rad: float) -> None:
    trials = Trials(np.random.default_rng(3), 1)
    time_s, angle = trials.swung(8.0)
    truth, rejected = trials.frequency_squared_s2[0], 0
    for seed in range(5, 9):
        rng = np.random.default_rng(seed)
        read = encoded(angle[:, 0], rng) + noise_rad * rng.standard_normal(len(time_s))
        try:
            fit = fit_swing(find_swing(time_s, read))
        except FitError:
            rejected += 1
            continue
        rejected += not fit.accepted
        error, std = error_and_std(fit, truth)
        assert not fit.accepted or abs(error) < min(3 * std, 0.01)

    assert rejected > 0


def test_a_swing_recorded_by_a_busy_computer_is_timed_by_the_encoders_own_clock(tmp_path: Path) -> None:
    columns = ("t", "phi", "device_us")
    encoder = DeviceRecord(file="encoder.csv", columns=columns, counts_per_turn=8192.0)
    scores, stds = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        trials = Trials(rng, 1)
        taken_s, angle = trials.swung(8.0)
        truth = float(trials.frequency_squared_s2[0])
        late_s = rng.gamma(3.0, 15e-6, len(taken_s))
        arrival_s = np.maximum.accumulate(taken_s + late_s + 16e-3 * (rng.random(len(taken_s)) < 0.01))
        kept = np.append(np.diff(arrival_s) > 0, True)  # a poll waits for an answer, so others were never sent
        counts = np.round(encoded(angle[:, 0], rng) / (2 * math.pi / 8192))
        rows = (1.7e9 + arrival_s, counts, np.floor(1e6 * taken_s * (1 + 30e-6)) + 5e6)
        with create_run(
            tmp_path / "runs",
            kind="swing",
            label=Label(),
            devices={"encoder": encoder},
            started=datetime(2026, 1, 1, tzinfo=UTC),
            cfid_version="0.2.0",
        ) as writer:
            writer.append("encoder", [column[kept] for column in rows])
        in_table = AngleRecord(
            path=Path("swing.csv"),
            source=Source("swing.csv", ""),
            label=Label(),
            time_s=arrival_s[kept] - arrival_s[0],
            angle_rad=encoded(angle[:, 0], rng)[kept],
            findings=(),
        )
        device = cfid.swing.fit(writer.folder)
        scores.append(score(device, truth))
        fits = [
            result.quantities["swing.natural_frequency_squared_s2"] for result in (device, cfid.swing.fit(in_table))
        ]
        stds.append([math.sqrt(fit.std**2 - (2 * CRYSTAL_STD * fit.value) ** 2) for fit in fits])

    assert max(scores) < 2.5
    assert all(by_arrival > 1.5 * by_device for by_device, by_arrival in stds)


def score(result: Result, truth: float) -> float:
    """Return the error of a frequency in its standard uncertainties."""
    found = result.quantities["swing.natural_frequency_squared_s2"]
    return float(abs(found.value - truth) / found.std)


def test_a_window_from_zero_changes_nothing_and_one_that_begins_at_rest_finds_the_release() -> None:
    time_s, angle, _ = one_swing()
    read = encoded(angle, np.random.default_rng(5))
    whole, zero, early = (find_swing(time_s, read, from_s=from_s) for from_s in (None, 0.0, 0.2))

    assert (zero.release, zero.hand_gone, zero.end) == (whole.release, whole.hand_gone, whole.end)
    assert early.release_s == pytest.approx(whole.release_s, abs=0.005)
    assert early.peak_angle_rad == pytest.approx(whole.peak_angle_rad, abs=1e-3)


@pytest.mark.parametrize("part", np.linspace(0.1, 0.9, 5))
def test_the_end_of_a_window_is_no_peak(part: float) -> None:
    time_s, angle, _ = one_swing()
    read = encoded(angle, np.random.default_rng(5))
    whole = find_swing(time_s, read)
    before, after = whole.peak_time_s[5:7]
    cut = find_swing(time_s, read, to_s=float(before + part * (after - before)))
    height, there = np.abs(cut.peak_angle_rad[-1]), np.abs(whole.peak_angle_rad[5])

    assert len(cut.peak_time_s) == 6
    assert math.degrees(height) == pytest.approx(math.degrees(there), abs=0.5)


@pytest.mark.parametrize("platform", ["cf2", "other"])
@pytest.mark.parametrize(
    ("given", "guess", "of_vehicles"),
    [
        ({"mass_kg": 28.0}, "28.0 kg: grams?", True),
        ({"mass_kg": 0.28}, "the mass is implausible, 0.28 kg", True),
        ({"distance_m": 23.0}, "distance", False),
        ({"gravity_mps2": 981.0}, "cm/s^2?", False),
        ({"gravity_mps2": 9.18}, "gravity_mps2 is implausible", False),
    ],
)
def test_a_number_that_cannot_be_takes_the_inertia_and_leaves_the_frequency(
    given: dict[str, Any], guess: str, of_vehicles: bool, platform: str, tmp_path: Path
) -> None:
    record = recorded(encoded(one_swing()[1], np.random.default_rng(5)), Label())
    path = tmp_path / "rig.toml"
    path.write_text(new_rig_text().replace('platform = "cf2"', f'platform = "{platform}"'))
    result = cfid.swing.fit(record, rig=load_rig(path), **{"mass_kg": 0.028, "distance_m": 0.023, **given})

    assert "swing.natural_frequency_squared_s2" not in result.rejected
    assert result.accepted == (of_vehicles and platform == "other")
    assert result.accepted or guess in result.rejected["swing.axis_inertia_kg_m2"]


def test_uncertainties_of_mass_and_distance_are_lines_of_the_budget_and_none_is_taken_as_exact() -> None:
    record, key = recorded(encoded(one_swing()[1], np.random.default_rng(5)), Label()), "swing.axis_inertia_kg_m2"
    exact = cfid.swing.fit(record, mass_kg=0.028, distance_m=0.023)
    known = cfid.swing.fit(record, mass_kg=0.028, mass_std_kg=0.00028, distance_m=0.023, distance_std_m=0.00046)
    value, alone, together = exact.quantities[key].value, exact.quantities[key].std, known.quantities[key].std

    assert together == pytest.approx(math.hypot(alone, 0.01 * value, 0.02 * value), rel=0.01)
    assert any("mass 1 %" in line and "mount distances 2 %" in line for line in known.summary())
    codes = [[one.text for one in result.findings if one.code == "input-taken-as-exact"] for result in (exact, known)]
    assert [len(texts) for texts in codes] == [2, 0]
    assert "the mass is taken as exact" in codes[0][0]


def test_an_axis_that_contradicts_the_runs_own_label_is_refused_and_both_are_named() -> None:
    record = recorded(one_swing()[1], Label(axis="z", body="crazyflie"))

    with pytest.raises(ConfigError, match="axis 'x' contradicts the run's own label, axis 'z'"):
        labelled(record, axis="x")
    with pytest.raises(ConfigError, match="body 'fixture' contradicts"):
        labelled(record, body="fixture")
    with pytest.raises(ConfigError, match="axis 'x' contradicts"):
        cfid.swing.fit(record, axis="x")


@pytest.mark.parametrize("scale", [0.5, 1.03, 2.1])
def test_an_angle_in_a_wrong_unit_is_no_spring(scale: float) -> None:
    time_s, angle, frequency = one_swing()
    try:
        fit = fit_swing(find_swing(time_s, scale * encoded(angle, np.random.default_rng(5))))
    except FitError:
        return
    error = fit.coefficients.natural_frequency_squared_s2 / frequency - 1

    assert not fit.accepted or abs(error) < 0.001


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "imperfect", "eccentric_deg", "phase_deg"),
    [
        ("sound", {}, 0.0, 0.0),
        *((f"eccentric encoder, {size} degrees at {phase}", {}, size, phase) for size in (0.3, 1) for phase in (0, 60)),
        ("Stribeck friction", {"stribeck": 0.5}, 0.0, 0.0),
        ("friction varies with the angle", {"ripple_nm": 1e-5}, 0.0, 0.0),
        ("cable, 1 % of gravity", {"cable": 0.01}, 0.0, 0.0),
    ],
)
def test_the_table_of_imperfect_swings(
    name: str, imperfect: dict[str, float], eccentric_deg: float, phase_deg: float
) -> None:
    rng = np.random.default_rng(5)
    trials = Trials(rng, 200, **imperfect)
    time_s, angle = trials.swung(14.0, FINE_STEP_S)
    errors, scores, rejected = [], [], 0
    for column, truth in zip(angle.T, trials.frequency_squared_s2, strict=True):
        read = encoded(column, rng, eccentric_rad=math.radians(eccentric_deg), phase_rad=math.radians(phase_deg))
        fit = fit_swing(find_swing(time_s, read))
        error = fit.coefficients.natural_frequency_squared_s2 - truth
        rejected += not fit.accepted
        errors.append(error / truth)
        scores.append(error / fit.std.natural_frequency_squared_s2)
    hits, count = int(np.sum(np.abs(scores) < 1.96)), len(scores)
    low, high = beta.ppf(0.025, hits, count - hits + 1), beta.ppf(0.975, hits + 1, count - hits)
    print(
        f"{name}: bias {100 * np.mean(errors):+.4f} %, rms {100 * np.std(errors):.4f} %, ratio "
        f"{np.sqrt(np.mean(np.square(scores))):.2f}, cover {hits / count:.3f} ({low:.3f} to {high:.3f}), "
        f"rejected {rejected}"
    )

    assert rejected < 0.02 * count
    assert high >= 0.93
