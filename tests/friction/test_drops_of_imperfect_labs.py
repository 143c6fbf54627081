"""Dropped weights as an imperfect lab records them: a line in layers, exchanged weights, the thickness of a line.

The plant is a separate integrator: (I + m r^2) w' = m g r(turns) - M_c - c w.
"""

import math
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import cfid.friction
from cfid.friction.drops import Drop, measure_drop
from cfid.friction.estimation import COULOMB, VISCOUS, fit_friction
from cfid.recordings.angle import AngleRecord
from cfid.records.rig_file import FrictionRig, thesis_rig
from cfid.records.run import Label
from tests.recordings.made import made_angle

Array = npt.NDArray[np.float64]

RADIUS_M, GRAVITY = 0.002, 9.81
DRY_NM, VISCOUS_NMS, SETUP_KG_M2 = 3.2e-4, 1.1e-6, 1.5e-7
GRAMS = (20.0, 20.0, 30.0, 30.0, 40.0, 40.0, 50.0, 50.0)
SCATTER = 0.03  # of dry friction, from drop to drop


@cache
def fallen(grams: float, dry_nm: float, layered: float) -> tuple[Array, Array]:
    """Return times and angles of a fall of 90 turns after 0.5 s; the radius changes by a share `layered` per turn."""
    mass, step = grams / 1000, 1e-3
    angle, speed, angles = 0.0, 0.0, [0.0] * 500
    while angle < 180 * math.pi and len(angles) < 15000:
        radius = RADIUS_M * (1 + layered * angle / (2 * math.pi))
        torque = mass * GRAVITY * radius - dry_nm - VISCOUS_NMS * speed
        speed += step * torque / (SETUP_KG_M2 + mass * radius**2)
        angle += step * speed
        angles.append(angle)
    counts = np.floor(8192 / (2 * math.pi) * np.array(angles))
    return step * np.arange(float(len(angles))), 2 * math.pi / 8192 * counts


def drops(seed: int, layered: float = 0.0, grams: tuple[float, ...] = GRAMS, **setup: float) -> list[Drop]:
    """Return the drops of a campaign whose labels state `grams`."""
    rng = np.random.default_rng(seed)
    known: dict[str, Any] = {"radius_m": RADIUS_M, "gravity_mps2": GRAVITY, **setup}
    falls = [fallen(one, DRY_NM * (1 + SCATTER * rng.normal()), layered) for one in GRAMS]
    return [measure_drop(*fall, weight_kg=one / 1000, **known) for fall, one in zip(falls, grams, strict=True)]


def codes(found: list[Drop]) -> set[str]:
    fit = fit_friction(found, radius_m=RADIUS_M, radius_std_m=1e-5, gravity_mps2=GRAVITY)
    return {finding.code for finding in fit.findings if finding.severity == "rejection"}


@pytest.mark.parametrize("seed", range(3))
def test_a_line_wound_side_by_side_is_not_rejected(seed: int) -> None:
    assert codes(drops(seed)) == set()


def test_a_line_wound_in_layers_is_rejected() -> None:
    found = codes(drops(1, -0.004))  # a line of 0.2 mm, side by side over 5 mm, then a layer lower

    assert found & {"friction-radius-changes", "friction-never-settled"}


@pytest.mark.parametrize("exchanged", [(20, 50), (30, 40), (20, 30)])
def test_exchanged_weights_are_rejected(exchanged: tuple[float, float]) -> None:
    other = {exchanged[0]: exchanged[1], exchanged[1]: exchanged[0]}

    assert "friction-weights-out-of-order" in codes(drops(1, grams=tuple(other.get(one, one) for one in GRAMS)))


def record(grams: float) -> AngleRecord:
    return made_angle(*fallen(grams, DRY_NM, 0.0), name=f"{grams:g}", label=Label(weight_g=grams))


def findings(axis: FrictionRig) -> set[str]:
    rig = thesis_rig().model_copy(update={"friction": axis})
    result = cfid.friction.fit([record(grams) for grams in (20.0, 30.0, 40.0)], rig=rig)
    return {finding.code for finding in result.findings}


def test_the_lines_thickness_is_asked_for_and_added() -> None:
    bare, with_line = FrictionRig(radius_mm=1.9), FrictionRig(radius_mm=1.9, line_mm=0.2, line_std_mm=0.04)

    assert (with_line.lever_mm, with_line.lever_std_mm) == pytest.approx((2.0, 0.02))
    assert "friction-line-unknown" in findings(bare)
    assert "friction-line-unknown" not in findings(with_line)
    rig = thesis_rig().model_copy(update={"friction": with_line})
    quantities = cfid.friction.fit([record(grams) for grams in (20.0, 30.0, 40.0)], rig=rig).quantities
    assert quantities[COULOMB].value == pytest.approx(DRY_NM, rel=0.01)
    assert quantities[VISCOUS].value == pytest.approx(VISCOUS_NMS, rel=0.01)


@pytest.mark.parametrize("line_mm", [0.2, 0.0, None])
def test_a_radius_that_is_given_is_that_of_the_lines_middle_and_that_is_said(line_mm: float | None) -> None:
    rig = thesis_rig().model_copy(update={"friction": FrictionRig(radius_mm=1.9, line_mm=line_mm)})
    result = cfid.friction.fit([record(grams) for grams in (20.0, 30.0, 40.0)], rig=rig, radius_m=RADIUS_M)
    assert result.quantities[COULOMB].value == pytest.approx(DRY_NM, rel=0.01)
    assert ("friction-line-not-added" in [one.code for one in result.findings]) == bool(line_mm)


def test_a_radius_in_metres_is_rejected_with_its_unit() -> None:
    assert "implausible-input" in findings(FrictionRig(radius_mm=0.002, line_mm=0.0))
