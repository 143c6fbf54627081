"""Cables that pull as springs and discs off their axis: what one swing cannot separate is in W's uncertainty.

A rig has one disc, so its phase is the same in all of its swings.
"""

import math
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import cfid.swing
from cfid.records.parameters import Parameter
from cfid.records.result import Result
from cfid.records.rig_file import EncoderScale, thesis_rig
from cfid.units import CRYSTAL_STD
from tests.recordings.made import made_angle
from tests.swing.swung import encoded, swung

Array = npt.NDArray[np.float64]

FREQUENCY_S2 = 0.028 * 9.81 * 0.0229 / 3.12e-5
FRICTION_PER_S = 3e-6 / 3.12e-5
CLOCK = 2 * CRYSTAL_STD  # of W, relative; the plant's clock is exact
KEY = "swing.natural_frequency_squared_s2"


@cache
def of_release(release_deg: float, cable: float = 0.0) -> tuple[Array, Array]:
    return swung(
        FREQUENCY_S2,
        release_rad=math.radians(release_deg),
        seconds=16,
        viscous=FRICTION_PER_S,
        coulomb=FRICTION_PER_S,
        cable=cable,
        slip_rad_per_s=0.01,
        row_s=4e-3,
    )


def fitted(
    release_deg: float, *, cable: float = 0.0, seed: int = 1, counts: float = 8192.0, off: float = 1.0, **disc: float
) -> Result:
    time_s, angle = of_release(release_deg, cable)
    read = encoded(angle, np.random.default_rng(seed), noise_deg=0.02, counts=counts, **disc)
    return cfid.swing.fit(made_angle(time_s, off * read))


def error_and_std(found: Parameter) -> tuple[float, float]:
    """Return the relative error of W, and its relative standard uncertainty without the clock's."""
    std = found.std / FREQUENCY_S2
    return found.value / FREQUENCY_S2 - 1, math.sqrt(std**2 - CLOCK**2)


def errors(swings: Iterable[Mapping[str, float]]) -> tuple[Array, Array, list[set[str]]]:
    """Return relative errors of W, its standard uncertainties (n,), and all codes of findings."""
    results = [fitted(**imperfect, seed=seed) for seed, imperfect in enumerate(swings)]
    error, std = np.array([error_and_std(result.quantities[KEY]) for result in results]).T
    return error, std, [{one.code for one in result.findings} for result in results]


@pytest.mark.parametrize(("eccentric_deg", "phases_deg"), [(0.0, [0]), (0.3, [0, 60, 180])])
def test_the_stated_uncertainty_is_the_size_of_the_errors_whatever_the_disc(
    eccentric_deg: float, phases_deg: list[float]
) -> None:
    error, std, codes = errors(
        {"release_deg": release_deg, "eccentric_deg": eccentric_deg, "phase_deg": phase_deg}
        for release_deg in range(25, 81, 5)
        for phase_deg in phases_deg
    )

    assert 0.7 < 1 / math.sqrt(np.mean((error / std) ** 2)) < 1.5
    assert np.mean(np.abs(error) < 1.96 * std) > 0.9
    assert np.median(std[-9:]) < 3e-4  # large swings separate the two
    assert np.max(np.abs(error)) < 9e-3  # a cable in place of the disc makes it 1 %
    assert all("swing-cable-or-encoder" in found for found, share in zip(codes, std, strict=True) if share > 1e-3)


@pytest.mark.parametrize(("cable", "releases_deg"), [(0.01, (25, 35, 45, 55, 65)), (-0.01, (60,))])
def test_a_spring_that_pulls_or_pushes_is_within_the_interval(cable: float, releases_deg: tuple[float, ...]) -> None:
    error, std, codes = errors(
        {"release_deg": release_deg, "cable": cable, "counts": 65536} for release_deg in releases_deg
    )

    assert np.max(np.abs(error) / std) < 2.5
    assert np.max(np.abs(error)) < 1.01 * abs(cable)  # what it makes of W where it is left in
    assert "swing-cable-or-encoder" in codes[0]


def test_two_minutes_of_a_friction_that_goes_with_the_root_of_the_speed_are_as_accurate_as_stated() -> None:
    time_s, angle = swung(FREQUENCY_S2, release_rad=math.radians(70), seconds=120, root=0.0385)
    reads = [encoded(angle, np.random.default_rng(seed), noise_deg=0.02) for seed in range(3)]
    error, std = np.array([error_and_std(cfid.swing.fit(made_angle(time_s, read)).quantities[KEY]) for read in reads]).T

    assert np.max(std) < 5e-5
    assert 0.7 < 1 / math.sqrt(np.mean((error / std) ** 2)) < 1.5


def test_what_the_rig_states_of_its_cable_and_disc_sharpens_a_swing() -> None:
    """The disc is drawn anew for each swing, from what the rig states of it."""
    time_s, angle = of_release(30)
    rigs = [
        thesis_rig().model_copy(update={"encoder": encoder})
        for encoder in (EncoderScale(clock_std=0), EncoderScale(clock_std=0, disc_std_deg=0.15, cable_std=0))
    ]
    scores, shares = [], []
    for seed, (sine, cosine) in enumerate(np.random.default_rng(3).normal(0, 0.15, (12, 2))):
        disc = {"eccentric_deg": math.hypot(sine, cosine), "phase_deg": math.degrees(math.atan2(cosine, sine))}
        read = made_angle(time_s, encoded(angle, np.random.default_rng(seed), noise_deg=0.02, **disc))
        unknown, stated = (cfid.swing.fit(read, rig=rig).quantities[KEY] for rig in rigs)
        scores.append((stated.value - FREQUENCY_S2) / stated.std)
        shares.append(stated.std / unknown.std)

    assert 0.7 < 1 / math.sqrt(np.mean(np.square(scores))) < 1.5
    assert np.median(shares) < 0.2


@pytest.mark.parametrize(
    "imperfect", [{"release_deg": 45, "counts": 4096, "off": 4096 / 4000}, {"release_deg": 60, "cable": -0.04}]
)
def test_wrong_counts_per_turn_and_a_strong_spring_give_no_number(imperfect: dict[str, Any]) -> None:
    result = fitted(**imperfect)

    assert not result.accepted
    assert KEY not in result.without_rejected().quantities


def test_a_second_harmonic_of_the_disc_that_resembles_a_cable_is_within_the_interval() -> None:
    time_s, angle = of_release(65)
    read = encoded(angle - math.radians(0.05) * np.sin(2 * angle), np.random.default_rng(1), noise_deg=0.02)
    error, std = error_and_std(cfid.swing.fit(made_angle(time_s, read)).quantities[KEY])

    assert 1e-3 < abs(error) < 2.5 * std < 0.02
