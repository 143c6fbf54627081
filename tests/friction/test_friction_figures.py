"""Figures of dropped weights: drops that settled, drops that did not, and the line through them."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from cfid.friction.drops import Drop
from cfid.friction.estimation import fit_friction
from cfid.friction.figures import drops_figure, friction_figure

Look = Callable[[Figure], Any]
MakeDrop = Callable[..., Drop]
RADIUS_M, GRAVITY_MPS2 = 2e-3, 9.81


def test_a_run_that_never_settled_is_marked_in_red_words(drop: MakeDrop, look: Look) -> None:
    steady, wavy = drop(0.03), drop(0.01, ripple=0.5)
    assert (steady.settled, wavy.settled) == (True, False)
    page = look(drops_figure([steady, wavy], labels=["30 g, a", "10 g, b_$1$"]))
    assert page.red().startswith("never settled")
    assert page.red().count("never settled") == 1
    assert page.overlapping() == []


def test_friction_is_a_line_through_the_speeds_that_falls_tend_to(drop: MakeDrop, look: Look) -> None:
    drops = [
        *(drop(weight, slower=slower) for weight, slower in ((0.02, 0.1), (0.03, 0.0), (0.05, 0.02))),
        drop(0.01, ripple=0.5),
    ]
    found = fit_friction(drops, radius_std_m=0.0, radius_m=RADIUS_M, gravity_mps2=GRAVITY_MPS2)
    page = look(friction_figure(drops, found, radius_m=RADIUS_M, gravity_mps2=GRAVITY_MPS2))
    lines = page.panel("(a)").get_lines()
    line = next(line for line in lines if len(line.get_xdata()) > 2)
    speed, torque = line.get_data()
    assert found.coulomb_nm is not None
    assert torque == pytest.approx(1e6 * (found.coulomb_nm + found.viscous_nms_per_rad * speed))
    points = [tuple(np.ravel(line.get_data())) for line in lines if len(line.get_xdata()) == 1]
    for each in drops[:3]:
        expected = (each.terminal_rad_per_s, 1e6 * each.weight_kg * GRAVITY_MPS2 * RADIUS_M)
        assert any(point == pytest.approx(expected) for point in points)
    assert "not used" in " ".join(text.get_text() for text in page.texts())
    assert page.overlapping() == []
