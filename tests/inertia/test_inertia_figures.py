"""Figures of the inertia matrix's budget, of its swings, and of the test body."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from uncertainties import ufloat

from cfid.inertia import figures as inertia_figures
from cfid.inertia.comparison import BodyComparison
from cfid.inertia.matrix import fit_inertia
from cfid.swing.body import MountedSwing, axis_inertias
from tests.inertia.test_inertia_matrix import SITE, thesis_body

Look = Callable[[Figure], Any]
THESIS = {"x": 3.119770, "y": 3.128159, "z": 7.004148, "xy": 4.940333, "xz": 4.600706, "yz": 4.713093}  # table 2.3


def test_the_parts_of_a_bar_add_up_to_the_entrys_standard_uncertainty(look: Look) -> None:
    swings = [
        MountedSwing(axis=axis, value=1e-5 * value, std=4e-8 * value, known=True) for axis, value in THESIS.items()
    ]
    fit = fit_inertia(axis_inertias(swings, thesis_body(), SITE))
    page = look(inertia_figures.budget_figure(fit, axes=list(THESIS)))
    tops = np.zeros(6)
    for bar in page.panel("(a)").patches:
        place = round(bar.get_x() + bar.get_width() / 2)
        tops[place] = max(tops[place], bar.get_y() + bar.get_height())
    assert tops == pytest.approx(1e6 * fit.std_kg_m2[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
    assert page.overlapping() == []


def test_the_test_bodys_difference_keeps_its_sign(look: Look) -> None:
    comparisons = [
        BodyComparison(axis, 6.4e-6, ufloat(6.4e-6 * factor, 1e-7)) for axis, factor in (("x", 0.98), ("z", 1.03))
    ]
    page = look(inertia_figures.testbody_figure(comparisons))
    written = [text.get_text() for text in page.texts()]
    assert any(text.startswith("−2.00 %") for text in written)
    assert any(text.startswith("+3.00 %") for text in written)
    assert page.overlapping() == []
