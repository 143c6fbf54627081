"""Figures of the inertia matrix's budget, of its swings, and of the test body."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from uncertainties import ufloat

from cfid.inertia import figures as inertia_figures
from cfid.inertia.comparison import BodyComparison
from cfid.inertia.matrix import InertiaFit, fit_inertia
from cfid.records.rig_file import thesis_rig
from cfid.swing.body import MountedSwing, Surroundings, SwungBody, axis_inertias, numbers
from cfid.units import MM

Look = Callable[[Figure], Any]
THESIS = {"x": 3.119770, "y": 3.128159, "z": 7.004148, "xy": 4.940333, "xz": 4.600706, "yz": 4.713093}  # table 2.3


def _fit(axes: list[str], *, std: float = 4e-3, scatter: float = 0.0) -> InertiaFit:
    rig = thesis_rig()
    noise = scatter * np.random.default_rng(4).standard_normal(len(axes))
    swings = [
        MountedSwing(axis=axis, value=1e-5 * THESIS[axis] * (1 + off), std=1e-5 * THESIS[axis] * std, known=True)
        for axis, off in zip(axes, noise, strict=True)
    ]
    body = SwungBody(
        mass_kg=rig.vehicle.mass_kg,
        mass_std_kg=rig.vehicle.mass_std_kg,
        centre_m=MM * np.array(rig.vehicle.centre_of_mass_mm),
        centre_std_m=MM * np.array(rig.vehicle.centre_of_mass_std_mm),
        mounts=rig.mounts,
    )
    return fit_inertia(axis_inertias(swings, body, Surroundings(gravity_mps2=9.81, gravity_std_mps2=0.003)))


def test_the_parts_of_a_bar_add_up_to_the_entrys_standard_uncertainty(look: Look) -> None:
    fit = _fit(list(THESIS))
    page = look(inertia_figures.budget_figure(fit, axes=list(THESIS)))
    tops = np.zeros(6)
    for bar in page.panel("(a)").patches:
        place = round(bar.get_x() + bar.get_width() / 2)
        tops[place] = max(tops[place], bar.get_y() + bar.get_height())
    assert tops == pytest.approx(1e6 * fit.std_kg_m2[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
    assert page.overlapping() == []


def test_a_mounts_curve_is_zero_at_its_best_distance_and_meets_its_swing(look: Look) -> None:
    fit = _fit(list(THESIS))
    panel = look(inertia_figures.budget_figure(fit, axes=list(THESIS))).panel("(c)")
    curves = [line for line in panel.get_lines() if len(line.get_xdata()) == 200]
    inertias, distances = numbers(fit.axes.about_centre_kg_m2), numbers(fit.axes.distance_m)
    for i, curve in enumerate(curves):
        distance, sensitivity = curve.get_data()
        falling = (sensitivity[::-1], distance[::-1])
        inertia, mass, at_m = inertias[i], fit.axes.body.mass_kg, distances[i]
        assert np.interp(0.0, *falling) == pytest.approx(1e3 * np.sqrt(inertia / mass), rel=1e-3)
        slope = np.interp(1e3 * at_m, distance, sensitivity)
        assert slope == pytest.approx(1e3 * (inertia / at_m - mass * at_m), abs=1e-4)


def test_swings_that_contradict_each_other_are_marked_in_red(look: Look) -> None:
    axes = [axis for axis in THESIS for _ in range(3)]
    fit = _fit(axes, std=1e-3, scatter=0.05)
    assert [finding.code for finding in fit.findings] == ["inertia-swings-contradict"]
    assert "Rejected" in look(inertia_figures.budget_figure(fit, axes=axes)).red()


def test_the_test_bodys_difference_keeps_its_sign(look: Look) -> None:
    comparisons = [
        BodyComparison(axis, 6.4e-6, ufloat(6.4e-6 * factor, 1e-7)) for axis, factor in (("x", 0.98), ("z", 1.03))
    ]
    page = look(inertia_figures.testbody_figure(comparisons))
    written = [text.get_text() for text in page.texts()]
    assert any(text.startswith("−2.00 %") for text in written)
    assert any(text.startswith("+3.00 %") for text in written)
    assert page.overlapping() == []
