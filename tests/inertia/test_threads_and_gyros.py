"""Mounts on threads, and directions measured by a gyro: their effect on axis inertias and the matrix."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cfid.errors import ConfigError
from cfid.inertia.matrix import fit_inertia
from cfid.recordings.angle import AngleRecord
from cfid.recordings.gyro import Rates
from cfid.records.rig_file import Fixture, Mount, ThreadPair, load_rig, new_rig_text
from cfid.records.run import Label
from cfid.swing.body import MountedSwing, Surroundings, SwungBody, axis_inertias, contradicted_axes, numbers, threads_of
from tests.recordings.made import made_angle

TRUTH = 1e-6 * np.array([[16.4, -0.6, 0.5], [-0.6, 16.9, 1.1], [0.5, 1.1, 29.0]])
DIRECTIONS = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "xy": (1, 1, 0), "xz": (1, 0, 1), "yz": (0, 1, 1)}
MASS_KG, G = 0.028, 9.81
SITE = Surroundings(gravity_mps2=G, gravity_std_mps2=0.003)


def threads(**spread: float) -> ThreadPair:
    return ThreadPair(above_mm=80.0, below_mm=60.0, length_mm=400.0, **{"centre_std_mm": 0.0, **spread})


def body(mounts: dict[str, Mount]) -> SwungBody:
    still = np.zeros(3)
    return SwungBody(mass_kg=MASS_KG, mass_std_kg=0.0, centre_m=still, centre_std_m=still, mounts=mounts)


def on_threads(**spread: float) -> tuple[SwungBody, list[MountedSwing]]:
    """Return a body on threads in six directions, and its swings with exact W."""
    mounts = {name: Mount(direction=direction, threads=threads(**spread)) for name, direction in DIRECTIONS.items()}
    height = math.sqrt(0.4**2 - 0.01**2)
    swings = []
    for name, direction in DIRECTIONS.items():
        unit = np.array(direction) / np.linalg.norm(direction)
        frequency = MASS_KG * G * 0.04 * 0.03 / (height * float(unit @ TRUTH @ unit))
        swings.append(MountedSwing(axis=name, value=frequency, std=0.0))
    return body(mounts), swings


def test_six_directions_on_threads_give_the_matrix_whatever_the_fixture_and_the_centre_of_mass() -> None:
    hung, swings = on_threads()
    hung = replace(hung, centre_m=np.array([0.01, -0.02, 0.03]))
    around = replace(SITE, fixture=Fixture(mass_kg=0.002, distance_mm=2.0))

    fit = fit_inertia(axis_inertias(swings, hung, around))

    assert fit.matrix_kg_m2 == pytest.approx(TRUTH, rel=1e-9, abs=1e-14)
    assert np.all(numbers(fit.axes.distance_m) == 0)


def test_the_lengths_of_threads_are_a_line_of_the_budget() -> None:
    hung, swings = on_threads(above_std_mm=0.4, below_std_mm=0.3, length_std_mm=2.0)

    fit = fit_inertia(axis_inertias(swings, hung, SITE))
    relative = math.hypot(0.4 / 80, 0.3 / 60, 2.0 / 400 * 1.0)

    assert fit.budget["threads"][0, 0] / TRUTH[0, 0] == pytest.approx(relative, rel=0.02)


def test_a_centre_off_the_middle_of_the_threads_is_a_line_of_the_budget_that_contains_it() -> None:
    """By statics, the threads' loads balance about the centre of mass, and the arms above are in the same ratio."""
    errors_mm = np.random.default_rng(3).normal(0.0, 1.5, 400)
    to_one, to_other = 0.03 + 1e-3 * errors_mm, 0.03 - 1e-3 * errors_mm
    loads = to_other / 0.06, to_one / 0.06  # shares of the weight
    torque = sum(load * (0.08 / 0.06 * arm) * arm for load, arm in zip(loads, (to_one, to_other), strict=True))
    hung, swings = on_threads(centre_std_mm=1.5)
    fit = fit_inertia(axis_inertias(swings, hung, SITE))
    stated = fit.budget["threads"][0, 0] / TRUTH[0, 0]
    found = fit.matrix_kg_m2[0, 0] / TRUTH[0, 0] * (0.04 * 0.03) / torque - 1  # W is largest in the middle
    assert abs(np.mean(found)) < 0.2 * stated
    assert np.std(found) == pytest.approx(stated, rel=0.15)
    with pytest.raises(ValueError, match="centre_std_mm is more than an eighth"):
        threads(centre_std_mm=10.0)


def gyro_about(axis: tuple[float, float, float], mount: str = "x") -> AngleRecord:
    unit, nothing = np.array(axis) / np.linalg.norm(axis), np.zeros(2)
    return made_angle(nothing, nothing, label=Label(axis=mount), rates=Rates(nothing, unit, 0.0))


def mounted(std_deg: float) -> SwungBody:
    return body({"x": Mount(point_mm=(0, 30, 0), direction=(1, 0, 0), direction_std_deg=std_deg)})


def test_a_gyro_that_turned_about_another_mount_contradicts_the_label() -> None:
    sound = contradicted_axes(mounted(0.3), [gyro_about((-1, 0.02, 0))])  # a gyro does not determine the sign
    ((name, finding),) = contradicted_axes(mounted(0.3), [gyro_about((0, 1, 0))])

    assert (name, finding.severity) == ("x", "rejection")
    assert sound == []


def test_a_mount_needs_a_point_or_threads_that_reach(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(new_rig_text().replace("point_mm = [0.0, 33.75, 18.95]", "#"))
    with pytest.raises(ConfigError, match=r"mounts.xy: point_mm is required: a point on the axis, or threads"):
        load_rig(path)
    with pytest.raises(ValueError, match="do not reach"):
        ThreadPair(above_mm=100, below_mm=10, length_mm=40)


def test_threads_change_the_equation_by_their_ratios_and_an_axis_does_not() -> None:
    found = threads_of(Mount(direction=(0, 0, 1), threads=threads()), G)
    height = math.sqrt(0.4**2 - 0.01**2)

    assert found == pytest.approx((0.0012 / height**2, 0.0012 / (G * height)))
    assert threads_of(Mount(direction=(0, 0, 1), point_mm=(0, 1, 0)), G) == threads_of(None, G) == (0, 0)
