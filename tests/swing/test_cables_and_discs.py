"""Cables that pull as springs and discs off their axis: what one swing cannot separate is in W's uncertainty.

The plant is integrated by SciPy. A rig has one disc, so its phase is the same in all of its swings.
"""

import json
import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import cfid.swing
from cfid.records.rig_file import EncoderScale, thesis_rig
from cfid.units import CRYSTAL_STD
from tests.campaigns import Cfid
from tests.swing.integrated import encoded, frequency_on, motion, written

Array = npt.NDArray[np.float64]

FREQUENCY_S2 = 0.028 * 9.81 * 0.0229 / 3.12e-5
FRICTION_PER_S = 3e-6 / 3.12e-5
CLOCK = 2 * CRYSTAL_STD  # of W, relative; the plant's clock is exact
KEY = "swing.natural_frequency_squared_s2"


@cache
def swung(release_deg: float, cable: float = 0.0) -> tuple[Array, Array]:
    return motion(
        frequency_squared_s2=FREQUENCY_S2,
        release_deg=release_deg,
        seconds=15,
        viscous_per_s=FRICTION_PER_S,
        coulomb_per_s2=FRICTION_PER_S,
        cable=cable,
    )


def errors(
    cfid: Cfid,
    folder: Path,
    releases_deg: tuple[float, ...],
    *,
    cable: float = 0.0,
    eccentric_deg: float = 0.0,
    phase_deg: float = 0.0,
) -> tuple[Array, Array, list[set[str]]]:
    """Return relative errors of W its standard uncertainties (n,) without the clock's, and all codes of findings."""
    found, codes = [], []
    for seed, release_deg in enumerate(releases_deg):
        time_s, angle = swung(release_deg, cable)
        read = encoded(angle, seed=seed, eccentric_deg=eccentric_deg, phase_deg=phase_deg)
        ended = cfid("fit", "swing", written(folder / f"{seed}.csv", time_s, read), "--json")
        assert ended.returncode == 0, ended.stderr
        result = json.loads(ended.stdout)
        found.append([result["parameters"][KEY][part] / FREQUENCY_S2 for part in ("value", "std")])
        codes.append({one["code"] for one in result["findings"]})
    values, std = np.array(found).T
    return values - 1, np.sqrt(std**2 - CLOCK**2), codes


@pytest.mark.parametrize("phase_deg", [0, 10, 60, 180])
def test_a_disc_off_its_axis_is_within_the_interval_at_any_phase(cfid: Cfid, tmp_path: Path, phase_deg: float) -> None:
    error, std, codes = errors(cfid, tmp_path, (25, 26, 35, 36, 45, 46, 55, 56), eccentric_deg=0.3, phase_deg=phase_deg)

    assert np.max(np.abs(error) / std) < 3
    assert np.max(np.abs(error)) < 9e-3  # a cable in place of the disc makes it 1 %
    assert all("swing-cable-or-encoder" in of_one for of_one, share in zip(codes, std, strict=True) if share > 1e-3)


@pytest.mark.parametrize("cable", [0.003, 0.01])
def test_a_cable_is_within_the_interval(cfid: Cfid, tmp_path: Path, cable: float) -> None:
    error, std, codes = errors(cfid, tmp_path, (25, 35, 45, 55, 65), cable=cable)

    assert np.max(np.abs(error) / std) < 2.5
    assert np.max(np.abs(error)) < cable  # what it makes of W where it is left in
    assert "swing-cable-or-encoder" in codes[0]


@pytest.mark.parametrize(("eccentric_deg", "phase_deg"), [(0.0, 0.0), (0.3, 0.0), (0.3, 60.0)])
def test_the_stated_uncertainty_is_the_size_of_the_errors(
    cfid: Cfid, tmp_path: Path, eccentric_deg: float, phase_deg: float
) -> None:
    releases_deg = tuple(map(float, range(25, 81, 5)))
    error, std, _ = errors(cfid, tmp_path, releases_deg, eccentric_deg=eccentric_deg, phase_deg=phase_deg)

    assert 0.7 < 1 / math.sqrt(np.mean((error / std) ** 2)) < 1.5
    assert np.mean(np.abs(error) < 1.96 * std) > 0.9
    assert np.max(std[-3:]) < 3e-4  # large swings separate the two


def test_two_minutes_of_a_friction_that_goes_with_the_root_of_the_speed_are_as_accurate_as_stated(
    cfid: Cfid, tmp_path: Path
) -> None:
    time_s, angle = motion(
        frequency_squared_s2=FREQUENCY_S2, release_deg=70, seconds=120, row_s=1e-3, friction_per_s2=root_of_speed
    )
    scores = []
    for seed in range(3):
        ended = cfid("fit", "swing", written(tmp_path / f"{seed}.csv", time_s, encoded(angle, seed=seed)), "--json")
        found = json.loads(ended.stdout)["parameters"][KEY]
        std = math.sqrt(found["std"] ** 2 - (CLOCK * FREQUENCY_S2) ** 2)
        assert std < 5e-5 * FREQUENCY_S2
        scores.append((found["value"] - FREQUENCY_S2) / std)

    assert 0.7 < 1 / math.sqrt(np.mean(np.square(scores))) < 1.5


def root_of_speed(speed_rad_per_s: float) -> float:
    return 0.0385 * math.sqrt(speed_rad_per_s)


def test_an_inertia_from_swings_with_a_disc_off_its_axis_is_within_its_interval(cfid: Cfid, tmp_path: Path) -> None:
    inertia_kg_m2 = np.diag([16.57e-6, 16.66e-6, 29.26e-6])
    words = []
    for seed, mount in enumerate(("x", "y", "z", "xy", "xz", "yz")):
        time_s, angle = motion(
            frequency_squared_s2=frequency_on(mount, inertia_kg_m2),
            release_deg=35,
            seconds=15,
            viscous_per_s=FRICTION_PER_S,
            coulomb_per_s2=FRICTION_PER_S,
        )
        read = encoded(angle, seed=seed, eccentric_deg=0.3)
        words.append(f"{mount}={written(tmp_path / f'{mount}.csv', time_s, read)}")
    ended = cfid("fit", "inertia", *words, "--geometry", "thesis", "--json")
    result = json.loads(ended.stdout)
    matrix = result["parameters"]["inertia.matrix_kg_m2"]

    assert ended.returncode == 0, ended.stderr
    error = np.array(matrix["value"]) - inertia_kg_m2
    assert np.max(np.abs(error) / np.array(matrix["std"])) < 2.5
    assert "swing-cable-or-encoder" in {one["code"] for one in result["findings"]}


def test_what_the_rig_states_of_its_cable_and_disc_sharpens_a_swing(tmp_path: Path) -> None:
    """The disc is drawn anew for each swing, from what the rig states of it."""
    time_s, angle = swung(30)
    scores: list[float] = []
    shares: list[float] = []
    for seed, (sine, cosine) in enumerate(np.random.default_rng(3).normal(0, 0.15, (12, 2))):
        eccentric_deg, phase_deg = math.hypot(sine, cosine), math.degrees(math.atan2(cosine, sine))
        read = encoded(angle, seed=seed, eccentric_deg=eccentric_deg, phase_deg=phase_deg)
        path = written(tmp_path / f"{seed}.csv", time_s, read)
        stds = []
        for encoder in (EncoderScale(clock_std=0), EncoderScale(clock_std=0, disc_std_deg=0.15, cable_std=0)):
            quantity = cfid.swing.fit(path, rig=thesis_rig().model_copy(update={"encoder": encoder})).quantities[KEY]
            stds.append(quantity.std)
        scores.append((quantity.value - FREQUENCY_S2) / quantity.std)
        shares.append(stds[1] / stds[0])

    assert 0.7 < 1 / math.sqrt(np.mean(np.square(scores))) < 1.5
    assert np.median(shares) < 0.2


def fitted(cfid: Cfid, path: Path, *options: object) -> tuple[int, dict[str, Any]]:
    ended = cfid("fit", "swing", path, "--json", *options)
    return ended.returncode, json.loads(ended.stdout)


@pytest.mark.parametrize("release_deg", [45, 60])
def test_an_encoder_whose_counts_per_turn_are_wrong_gives_no_number(
    cfid: Cfid, tmp_path: Path, release_deg: float
) -> None:
    time_s, angle = swung(release_deg)
    read = encoded(angle, seed=1, counts=4096) * 4096 / 4000
    code, result = fitted(cfid, written(tmp_path / "swing.csv", time_s, read))

    assert (code, result["accepted"], KEY in result["parameters"]) == (5, False, False)


def test_a_disc_of_two_degrees_is_within_the_interval(cfid: Cfid, tmp_path: Path) -> None:
    time_s, angle = swung(60)
    for phase_deg in (40, 178):
        read = encoded(angle, seed=1, eccentric_deg=2, phase_deg=phase_deg, counts=65536)
        code, result = fitted(cfid, written(tmp_path / f"{phase_deg}.csv", time_s, read))

        assert code == 0
        value, std = (result["parameters"][KEY][part] for part in ("value", "std"))
        assert abs(value - FREQUENCY_S2) < 3 * std < 0.05 * FREQUENCY_S2


def test_a_spring_that_pushes_is_in_the_uncertainty_until_it_is_no_pendulum(cfid: Cfid, tmp_path: Path) -> None:
    def of_push(push: float) -> tuple[int, dict[str, Any]]:
        time_s, angle = swung(60, -push)
        return fitted(cfid, written(tmp_path / f"{push}.csv", time_s, encoded(angle, seed=1, counts=65536)))

    code, result = of_push(0.01)
    value, std = (result["parameters"][KEY][part] for part in ("value", "std"))
    assert code == 0
    assert abs(value - FREQUENCY_S2) < 2 * std < 0.02 * FREQUENCY_S2
    assert "swing-cable-or-encoder" in {finding["code"] for finding in result["findings"]}

    code, result = of_push(0.04)
    assert (code, result["accepted"], KEY in result["parameters"]) == (5, False, False)
