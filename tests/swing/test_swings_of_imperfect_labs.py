"""Swings as an imperfect lab records them: an eccentric encoder, windows set by hand, numbers in a wrong unit."""

import math
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

import cfid.swing
from cfid.errors import ConfigError, FitError
from cfid.recordings.angle import labelled
from cfid.records.rig_file import load_rig, new_rig_text
from cfid.records.run import Label
from cfid.swing.estimation import SwingFit, fit_swing
from cfid.swing.window import find_swing
from cfid.units import CRYSTAL_STD
from tests.coverage_rows import Row
from tests.lab import made_run
from tests.recordings.made import made_angle
from tests.swing.swung import FINE_STEP_S, encoded, swung

Array = npt.NDArray[np.float64]

KEY = "swing.natural_frequency_squared_s2"


class Trial(NamedTuple):
    """A pendulum, with friction divided by inertia."""

    frequency_squared_s2: float
    friction: dict[str, float]
    release_rad: float

    def swung(self, seconds: float, **imperfect: float) -> tuple[Array, Array]:
        return swung(
            self.frequency_squared_s2, release_rad=self.release_rad, seconds=seconds, **(self.friction | imperfect)
        )


def drawn(rng: np.random.Generator, count: int, *, ripple_nm: float = 0.0, **imperfect: float) -> list[Trial]:
    """Draw pendulums; `ripple_nm` is the standard deviation of dry friction that goes with the cosine of the angle."""
    inertia = rng.uniform(3.1e-5, 7e-5, count)
    frequency = 0.028 * 9.81 * rng.uniform(0.0229, 0.038, count) / inertia
    friction = {
        "viscous": rng.uniform(0.5, 2, count) * 1.2e-5 / inertia,
        "coulomb": rng.uniform(0.2, 1, count) * 3e-5 / inertia,
        "quadratic": rng.uniform(0, 2, count) * 2e-8 / inertia,
    }
    release = np.radians(rng.uniform(40, 60, count))
    if ripple_nm:
        friction["ripple"] = ripple_nm * rng.standard_normal(count) / inertia
    return [
        Trial(float(w), {**{name: float(each[i]) for name, each in friction.items()}, **imperfect}, float(release[i]))
        for i, w in enumerate(frequency)
    ]


ONE, OTHER = (drawn(np.random.default_rng(seed), 1)[0] for seed in (3, 5))


def one_swing() -> tuple[Array, Array]:
    """Return times and readings of a swing."""
    time_s, angle = ONE.swung(9.0)
    return time_s, encoded(angle, np.random.default_rng(5))


def error_and_std(fit: SwingFit, truth: float) -> tuple[float, float]:
    """Return the error of W and its standard uncertainty, relative to the truth."""
    found, std = (one.natural_frequency_squared_s2 for one in (fit.coefficients, fit.std))
    return float(found / truth) - 1, float(std / truth)


@pytest.mark.parametrize(
    "friction",
    [
        {"stribeck": 0.5},
        {"ripple": 0.7 * OTHER.friction["coulomb"]},
        {"coulomb": 0.9, "ripple": -0.87},  # hardly any friction at the rest angle, more to either side
    ],
)
def test_dry_friction_that_varies_leaves_the_frequency_within_three_standard_uncertainties(
    friction: dict[str, float],
) -> None:
    time_s, angle = OTHER.swung(14.0, step_s=FINE_STEP_S, **friction)
    fit = fit_swing(find_swing(time_s, encoded(angle, np.random.default_rng(5))))
    error, std = error_and_std(fit, OTHER.frequency_squared_s2)

    assert abs(error) < 3 * std < 1e-3
    assert "swing-cable-or-encoder" not in {finding.code for finding in fit.findings}


def test_a_swing_in_noise_of_degrees_is_within_its_interval_or_rejected() -> None:
    time_s, angle = ONE.swung(8.0)
    accepted = []
    for seed, noise_deg in product(range(5, 9), (1.15, 1.72)):
        try:
            fit = fit_swing(find_swing(time_s, encoded(angle, np.random.default_rng(seed), noise_deg=noise_deg)))
        except FitError:
            continue
        if fit.accepted:
            accepted.append(error_and_std(fit, ONE.frequency_squared_s2))

    assert len(accepted) < 8
    assert all(abs(error) < min(3 * std, 0.01) for error, std in accepted)


def test_a_swing_recorded_by_a_busy_computer_is_timed_by_the_encoders_own_clock(tmp_path: Path) -> None:
    scores, stds = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        trial = drawn(rng, 1)[0]
        taken_s, angle = trial.swung(8.0)
        late_s = rng.gamma(3.0, 15e-6, len(taken_s))
        arrival_s = np.maximum.accumulate(taken_s + late_s + 16e-3 * (rng.random(len(taken_s)) < 0.01))
        kept = np.append(np.diff(arrival_s) > 0, True)  # a poll waits for an answer, so others were never sent
        read = encoded(angle, rng)
        counts = np.round(read / (2 * math.pi / 8192))
        rows = {"t": 1.7e9 + arrival_s, "phi": counts, "device_us": np.floor(1e6 * taken_s * (1 + 30e-6)) + 5e6}
        run = made_run(
            tmp_path,
            "swing",
            {"encoder": {name: column[kept] for name, column in rows.items()}},
            facts_of={"encoder": {"counts_per_turn": 8192.0}},
        )
        in_table = made_angle(arrival_s[kept] - arrival_s[0], read[kept])
        by_device, by_arrival = (cfid.swing.fit(source).quantities[KEY] for source in (run, in_table))
        scores.append(abs(by_device.value - trial.frequency_squared_s2) / by_device.std)
        stds.append([math.sqrt(fit.std**2 - (2 * CRYSTAL_STD * fit.value) ** 2) for fit in (by_device, by_arrival)])

    assert max(scores) < 2.5
    assert all(by_arrival > 1.5 * by_device for by_device, by_arrival in stds)


def test_a_window_from_zero_changes_nothing_and_one_that_begins_at_rest_finds_the_release() -> None:
    whole, zero, early = (find_swing(*one_swing(), from_s=from_s) for from_s in (None, 0.0, 0.2))

    assert (zero.release, zero.hand_gone, zero.end) == (whole.release, whole.hand_gone, whole.end)
    assert early.release_s == pytest.approx(whole.release_s, abs=0.005)
    assert early.peak_angle_rad == pytest.approx(whole.peak_angle_rad, abs=1e-3)


@pytest.mark.parametrize("part", np.linspace(0.1, 0.9, 5))
def test_the_end_of_a_window_is_no_peak(part: float) -> None:
    whole = find_swing(*one_swing())
    before, after = whole.peak_time_s[5:7]
    cut = find_swing(*one_swing(), to_s=float(before + part * (after - before)))

    assert len(cut.peak_time_s) == 6
    assert abs(cut.peak_angle_rad[-1]) == pytest.approx(abs(whole.peak_angle_rad[5]), abs=math.radians(0.5))


@pytest.mark.parametrize("platform", ["cf2", "other"])
@pytest.mark.parametrize(
    ("given", "of_vehicles"),
    [
        ({"mass_kg": 28.0}, True),
        ({"mass_kg": 0.28}, True),
        ({"distance_m": 23.0}, False),
        ({"gravity_mps2": 981.0}, False),
        ({"gravity_mps2": 9.18}, False),
    ],
)
def test_a_number_that_cannot_be_takes_the_inertia_and_leaves_the_frequency(
    given: dict[str, Any], of_vehicles: bool, platform: str, tmp_path: Path
) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(new_rig_text().replace('platform = "cf2"', f'platform = "{platform}"'))
    result = cfid.swing.fit(
        made_angle(*one_swing()), rig=load_rig(path), **{"mass_kg": 0.028, "distance_m": 0.023, **given}
    )

    assert KEY not in result.rejected
    assert ("swing.axis_inertia_kg_m2" in result.rejected) != (of_vehicles and platform == "other")


def test_uncertainties_of_mass_and_distance_are_lines_of_the_budget_and_none_is_taken_as_exact() -> None:
    record, key = made_angle(*one_swing()), "swing.axis_inertia_kg_m2"
    exact = cfid.swing.fit(record, mass_kg=0.028, distance_m=0.023)
    known = cfid.swing.fit(record, mass_kg=0.028, mass_std_kg=0.00028, distance_m=0.023, distance_std_m=0.00046)
    value, alone, together = exact.quantities[key].value, exact.quantities[key].std, known.quantities[key].std

    assert together == pytest.approx(math.hypot(alone, 0.01 * value, 0.02 * value), rel=0.01)
    codes = [[one.code for one in result.findings] for result in (exact, known)]
    assert [found.count("input-taken-as-exact") for found in codes] == [2, 0]


def test_a_label_that_contradicts_the_runs_own_is_refused() -> None:
    record = made_angle(*one_swing(), label=Label(axis="z", body="crazyflie", weight_g=20.0))

    for contradicting in ({"axis": "x"}, {"body": "fixture"}, {"weight_g": 50.0}):
        with pytest.raises(ConfigError, match=f"contradicts the run's own label, {next(iter(contradicting))}"):
            labelled(record, **contradicting)
    with pytest.raises(ConfigError, match="axis 'x' contradicts"):
        cfid.swing.fit(record, axis="x")


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
    found, rejected = [], 0
    for trial in drawn(rng, 200, **imperfect):
        time_s, angle = trial.swung(14.0, step_s=FINE_STEP_S)
        fit = fit_swing(find_swing(time_s, encoded(angle, rng, eccentric_deg=eccentric_deg, phase_deg=phase_deg)))
        rejected += not fit.accepted
        found.append(error_and_std(fit, trial.frequency_squared_s2))
    errors, stds = np.array(found).T
    row = Row(name, errors, stds, rejected=rejected)
    print(row)

    assert rejected < 0.02 * len(found)
    assert row.covers()
