"""Whole campaigns of imperfect labs: the intervals of the matrix contain the truth, or the mistake is found.

The plant is a separate formula, W = m g r / (u' I u + m r^2), for a true body on true mounts that differ from the
stated ones.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from cfid.findings import Finding
from cfid.inertia.matrix import InertiaFit, fit_inertia
from cfid.quantities.plausible import implausible
from cfid.records.rig_file import Mount
from cfid.swing.body import MountedSwing, Surroundings, SwungBody, axis_inertias
from tests.coverage_rows import Row, reaches_93_percent

Array = npt.NDArray[np.float64]

TRUTH = 1e-6 * np.array([[16.4, -0.6, 0.5], [-0.6, 16.9, 1.1], [0.5, 1.1, 29.0]])
MASS_KG, GRAVITY_MPS2 = 0.028, 9.81
SIX = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "xy": (-1, 1, 0), "xz": (1, 0, 1), "yz": (0, 1, 1)}
EIGHT = {**SIX, "a": (2, -1, 2), "b": (1, 2, -2)}
POINTS_MM = {
    "x": (22.8, 22.8, 1.5), "y": (-22.8, 22.8, 1.5), "z": (22.7, 30.7, -17.4), "xy": (23.9, 23.9, 1.5),
    "xz": (24.0, 25.1, 5.7), "yz": (-24.0, 25.1, 5.7), "a": (-20.0, 20.0, 22.0), "b": (24.0, -24.0, 2.0),
    "far": (0.0, 20.0, 60.0),
}  # fmt: skip
STATED = {"mass_kg": 3e-5, "gravity_mps2": 0.003, "centre_m": 1e-4, "point_m": 1e-4, "tilt_rad": math.radians(0.3)}
SWING_STD = 3e-5  # of W
UPPER = np.triu_indices(3)
slow = partial(pytest.param, marks=pytest.mark.slow)


@dataclass(frozen=True, kw_only=True)
class Lab:
    """A lab: its mounts, the standard deviations of its true values from the stated ones, and its mistakes."""

    axes: dict[str, tuple[int, int, int]] = field(default_factory=lambda: SIX)
    spread: dict[str, float] = field(default_factory=lambda: STATED)
    mass_off_kg: float = 0.0
    fixture_kg: float = 0.0
    fixture_m: float = 0.002
    stiffness_nm: float = 0.0
    exchanged: tuple[str, str] | None = None
    inertia_kg_m2: Array = field(default_factory=lambda: TRUTH)
    hung_times: int = 1
    anew: float = 0.0  # the part of the variance of a mount's errors that each hanging has anew

    def swings(self, rng: np.random.Generator) -> list[MountedSwing]:
        """Return the natural frequencies squared on every mount, for newly drawn true values."""
        mass = MASS_KG + self.mass_off_kg + rng.normal(0, self.spread["mass_kg"])
        gravity = GRAVITY_MPS2 + rng.normal(0, self.spread["gravity_mps2"])
        centre = rng.normal(0, self.spread["centre_m"], 3)
        measured = []
        for name, nominal in self.axes.items():
            of_mount = rng.normal(size=6)
            for _ in range(self.hung_times):
                errors = math.sqrt(1 - self.anew) * of_mount
                if self.anew:
                    errors = errors + math.sqrt(self.anew) * rng.normal(size=6)
                axis = np.array(nominal) / np.linalg.norm(nominal)
                axis = axis + np.cross(self.spread["tilt_rad"] * errors[:3], axis)
                axis /= np.linalg.norm(axis)
                offset = 1e-3 * np.array(POINTS_MM[name]) + self.spread["point_m"] * errors[3:] - centre
                distance = math.sqrt(offset @ offset - (offset @ axis) ** 2)
                moment = gravity * (mass * distance + self.fixture_kg * self.fixture_m) + self.stiffness_nm
                inertia = (
                    axis @ self.inertia_kg_m2 @ axis + mass * distance**2 + 3 * self.fixture_kg * self.fixture_m**2
                )
                value = moment / inertia * (1 + SWING_STD * rng.normal())
                measured.append(MountedSwing(axis=name, value=value, std=SWING_STD * value))
        exchanged = dict(zip(self.exchanged, reversed(self.exchanged), strict=True)) if self.exchanged else {}
        by_mount = {swing.axis: swing for swing in measured}
        return [replace(by_mount[exchanged[s.axis]], axis=s.axis) if s.axis in exchanged else s for s in measured]

    def fitted(self, rng: np.random.Generator) -> "tuple[InertiaFit, Setup]":
        """Fit a campaign with the values that the lab states."""
        tenth = (0.1, 0.1, 0.1)
        mounts = {
            name: Mount(point_mm=POINTS_MM[name], point_std_mm=tenth, direction=axis, direction_std_deg=0.3)
            for name, axis in self.axes.items()
        }
        body = SwungBody(
            mass_kg=MASS_KG,
            mass_std_kg=STATED["mass_kg"],
            centre_m=np.zeros(3),
            centre_std_m=np.full(3, STATED["centre_m"]),
            mounts=mounts,
        )
        site = Surroundings(gravity_mps2=GRAVITY_MPS2, gravity_std_mps2=STATED["gravity_mps2"])
        given = axis_inertias(self.swings(rng), body, site)
        return fit_inertia(given), Setup(given.swings, body, site)


class Setup(NamedTuple):
    """The swings of a campaign, and what their fit knows of the body and its surroundings."""

    swings: Sequence[MountedSwing]
    body: SwungBody
    site: Surroundings

    def fitted(self, *swings: MountedSwing) -> InertiaFit:
        """Fit other swings in the same lab."""
        return fit_inertia(axis_inertias(swings, self.body, self.site))


def rejected(fit: InertiaFit) -> bool:
    return any(finding.severity == "rejection" for finding in fit.findings)


def campaigns(lab: Lab, count: int, *, seed: int) -> tuple[Array, Array, int]:
    """Return errors and standard uncertainties of the matrix' entries (count, 6), and the number of rejected fits."""
    rng = np.random.default_rng(seed)
    fits = [lab.fitted(rng)[0] for _ in range(count)]
    errors = np.array([(fit.matrix_kg_m2 - TRUTH)[UPPER] for fit in fits])
    return errors, np.array([fit.std_kg_m2[UPPER] for fit in fits]), sum(map(rejected, fits))


def scores(fit: InertiaFit) -> Array:
    return ((fit.matrix_kg_m2 - TRUTH) / fit.std_kg_m2)[UPPER]


def codes(findings: tuple[Finding, ...]) -> set[str]:
    return {finding.code for finding in findings}


@pytest.mark.parametrize("axes", [SIX, EIGHT], ids=["six", "eight"])
def test_sound_labs_are_covered_and_none_is_rejected(axes: dict[str, tuple[int, int, int]]) -> None:
    errors, stds, rejected_fits = campaigns(Lab(axes=axes), 15, seed=3)

    assert rejected_fits == 0
    assert reaches_93_percent(np.abs(errors / stds) < 1.96)


def hung_twice(rng: np.random.Generator, *, apart: float) -> InertiaFit:
    """Fit six swings and a repeat on the first mount, off by the share `apart`."""
    lab = Lab().fitted(rng)[1]
    first = lab.swings[0]
    return lab.fitted(*lab.swings, replace(first, value=first.value * (1 + apart)))


@pytest.mark.parametrize("count", [10, slow(40)])
def test_a_body_that_is_hung_anew_swings_a_little_differently_and_contradicts_nothing(count: int) -> None:
    rng = np.random.default_rng(5)
    fits = [hung_twice(rng, apart=rng.normal(0, 3e-4)) for _ in range(count)]

    assert not any(map(rejected, fits))
    assert np.mean(np.abs([scores(fit) for fit in fits]) < 1.96) > 0.9


@pytest.mark.parametrize("count", [10, slow(60)])
def test_bodies_that_take_another_place_in_their_mount_each_time_contradict_nothing(count: int) -> None:
    """Each of three swings about a mount has all of the mount's errors anew, or half of their variance."""
    for anew in (0.5, 1.0):
        rng = np.random.default_rng(7)
        fits = [Lab(hung_times=3, anew=anew).fitted(rng)[0] for _ in range(count)]

        assert sum(map(rejected, fits)) <= 1
        assert reaches_93_percent(np.abs([scores(fit) for fit in fits]) < 1.96)
        assert all("hangings" in fit.budget for fit in fits)


def test_a_repeat_that_differs_too_far_contradicts_and_its_mount_is_suspected() -> None:
    fit = hung_twice(np.random.default_rng(5), apart=0.03)

    assert "inertia-swings-contradict" in codes(fit.findings)
    assert fit.suspects == ("x",)


def test_an_exchange_that_no_body_allows_is_rejected() -> None:
    fit, _ = Lab(exchanged=("x", "z")).fitted(np.random.default_rng(1))

    assert [finding.severity for finding in fit.findings if finding.code == "inertia-not-a-body"] == ["rejection"]


@pytest.mark.parametrize("axes", [SIX, slow(EIGHT)], ids=["six", "eight"])
def test_few_exchanges_of_two_swings_lead_to_another_possible_body(axes: dict[str, tuple[int, int, int]]) -> None:
    fits = [Lab(axes=axes, exchanged=pair).fitted(np.random.default_rng(1))[0] for pair in combinations(axes, 2)]

    # Eight accept only x and y, which are almost alike.
    assert sum(not rejected(fit) for fit in fits) <= {6: 8, 8: 1}[len(axes)]


def refused(fit: InertiaFit) -> bool:
    """Return whether the swings contradict any body, or the matrix any quadrocopter."""
    matrix, std = fit.matrix_kg_m2.tolist(), fit.std_kg_m2.tolist()
    return rejected(fit) or bool(implausible("inertia.matrix_kg_m2", matrix, std=std))


@pytest.mark.parametrize("seed", range(3))
def test_a_quadrocopter_refuses_all_exchanges_of_six_swings_but_those_that_turn_x_into_y(seed: int) -> None:
    fits = {pair: Lab(exchanged=pair).fitted(np.random.default_rng(seed))[0] for pair in combinations(SIX, 2)}
    accepted = [pair for pair, fit in fits.items() if not refused(fit)]
    moments = [np.linalg.eigvalsh(fits[pair].matrix_kg_m2) for pair in accepted]

    assert set(accepted) <= {("x", "y"), ("xz", "yz")}
    # Six swings fit every labelling exactly, and the bodies differ no more than two vehicles do.
    assert all(fits[pair].chi_squared == 0 for pair in accepted)
    assert moments == [pytest.approx(np.linalg.eigvalsh(TRUTH), rel=0.02)] * len(accepted)


@pytest.mark.parametrize("count", [25, slow(200)])
def test_no_sound_quadrocopter_is_refused_for_its_products(count: int) -> None:
    rng = np.random.default_rng(9)
    fits = []
    for _ in range(count):
        moments = rng.uniform((15e-6, 15e-6, 27e-6), (18e-6, 18e-6, 31e-6))
        correlation = np.eye(3)
        correlation[np.triu_indices(3, 1)] = rng.uniform(-0.1, 0.1, 3)  # the thesis has up to 0.093
        correlation += np.triu(correlation, 1).T
        fits.append(Lab(inertia_kg_m2=correlation * np.sqrt(np.outer(moments, moments))).fitted(rng)[0])

    assert not [fit for fit in fits if refused(fit) and not rejected(fit)]
    assert sum(map(refused, fits)) < 0.02 * len(fits)  # by chance, about one in a hundred contradicts a body


def test_repeated_swings_find_the_exchange_of_two_that_are_almost_alike() -> None:
    right = Lab().swings(np.random.default_rng(1))
    by_axis = {swing.axis: swing for swing in right}
    wrong = [replace(by_axis[{"x": "y", "y": "x"}.get(swing.axis, swing.axis)], axis=swing.axis) for swing in right]
    fit = Lab().fitted(np.random.default_rng(1))[1].fitted(*right, *wrong)

    assert "inertia-swings-contradict" in codes(fit.findings)


def test_the_eighth_swing_names_the_one_whose_distance_is_wrong() -> None:
    lab = Lab(axes=EIGHT).fitted(np.random.default_rng(4))[1]
    off = [replace(swing, value=1.2 * swing.value) if swing.axis == "z" else swing for swing in lab.swings]

    assert "z" in lab.fitted(*off).suspects


def test_two_distances_of_one_axis_that_differ_are_rejected() -> None:
    axes = {**SIX, "far": (1, 0, 0)}  # its axis is 63 mm from the centre of mass, that of x 23 mm
    sound, stiff = (Lab(axes=axes, stiffness_nm=one).fitted(np.random.default_rng(5))[0] for one in (0.0, 4e-4))

    assert "inertia-distances-differ" not in codes(sound.findings)
    assert "inertia-distances-differ" in codes(stiff.findings)


def test_a_mass_in_grams_leaves_no_matrix() -> None:
    lab = Lab().fitted(np.random.default_rng(6))[1]
    heavy = lab._replace(body=replace(lab.body, mass_kg=0.0028, mass_std_kg=3e-3)).fitted(*lab.swings)

    assert "inertia-below-uncertainty" in codes(heavy.findings)


@pytest.mark.slow
def test_the_table_of_imperfect_labs() -> None:
    far, tilted = {**STATED, "centre_m": 5e-4}, {**STATED, "tilt_rad": math.radians(1)}
    labs = {
        "sound, six": Lab(),
        "sound, eight": Lab(axes=EIGHT),
        "centre of mass 0.5 mm off, six": Lab(spread=far),
        "centre of mass 0.5 mm off, eight": Lab(axes=EIGHT, spread=far),
        "axes 1 degree off, six": Lab(spread=tilted),
        "axes 1 degree off, eight": Lab(axes=EIGHT, spread=tilted),
        "mass 0.1 g off": Lab(mass_off_kg=1e-4),
        "fixture of 1.2 g neglected": Lab(fixture_kg=1.2e-3),
        "fixture of 0.5 g neglected": Lab(fixture_kg=5e-4),
    }
    rows = {}
    for name, lab in labs.items():
        errors, stds, rejected_fits = campaigns(lab, 1000, seed=20261122)
        rows[name] = Row(name, errors / np.mean(np.diag(TRUTH)), stds / np.mean(np.diag(TRUTH)), rejected=rejected_fits)
    print(*rows.values(), sep="\n")

    for name in ("sound, six", "sound, eight"):
        assert rows[name].rejected < 20
        assert 0.93 <= rows[name].hits / rows[name].error.size <= 0.97
