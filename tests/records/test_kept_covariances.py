"""What a fit keeps besides values: covariances, common causes and rejections."""

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from cfid.errors import DataError
from cfid.records.covariances import Covariance, covariance_between, names_of, numbers_of, shaped_as
from cfid.records.fits import Fit, list_fits
from cfid.records.parameters import Parameter, Section
from tests.lab import keep

MATRIX = [[1.0, 4.0, 5.0], [4.0, 2.0, 6.0], [5.0, 6.0, 3.0]]
WHOLE = Section(
    method="default",
    found=datetime(2026, 11, 22, 8, 30, tzinfo=UTC),
    cfid_version="0.2.0",
    accepted=True,
    sources=(),
    parameters={
        "motor.torque_poly": Parameter(value=[6e-3, 1e-5], std=[1e-5, 2e-6], unit="Nm(N)"),
        "motor.max_thrust_n": Parameter(value=0.15, std=1e-3, unit="N"),
    },
    covariance=(
        Covariance(
            ("motor.torque_poly", "motor.max_thrust_n"),
            ((1e-10, -1e-11, 0.0), (-1e-11, 4e-12, 1e-10), (0.0, 1e-10, 1e-6)),
        ),
    ),
    common={"arm": {"motor.torque_poly": [1e-6, 0.0]}},
    rejected={"motor.thrust_voltage_poly": "it does not rise."},
)


def test_covariances_causes_and_rejections_are_read_back(tmp_path: Path) -> None:
    keep(tmp_path, "torque", WHOLE)
    (fit,) = list_fits(tmp_path / "fits")

    assert isinstance(fit, Fit)
    assert fit.section == WHOLE


def with_covariance(matrix: Any, of: tuple[str, ...] = ("motor.torque_poly",)) -> Section:
    return replace(WHOLE, covariance=(Covariance(of, matrix),))


@pytest.mark.parametrize(
    ("section", "expected"),
    [
        (
            replace(WHOLE, covariance=(), parameters={"inertia.matrix_kg_m2": Parameter(value=1.0)}),
            "inertia.matrix_kg_m2: should be a matrix of 3 times 3 numbers",
        ),
        (
            replace(WHOLE, covariance=(), parameters={"motor.max_thrust_n": Parameter(value=1.0, unit="gf")}),
            "motor.max_thrust_n: its unit is 'gf', and has to be 'N'",
        ),
        (replace(WHOLE, found=WHOLE.found.replace(tzinfo=None)), "found: should have a time zone"),
        (with_covariance(((1.0,),)), "matrix: should have 2 rows of 2 numbers"),
        (with_covariance(((1.0, 2.0), (2.0, 1.0))), "row 1, column 2 is impossible in a covariance matrix"),
        (with_covariance(((-1.0, 0.0), (0.0, 1.0))), "row 1 should have finite numbers"),
        (with_covariance(((1.0,),), of=("motor.speed_poly",)), "of: there is no motor.speed_poly"),
        (replace(WHOLE, common={"arm": {"arm_m": [1.0]}}), "common.arm: there is no arm_m"),
    ],
)
def test_what_was_edited_into_nonsense_is_named(tmp_path: Path, section: Section, expected: str) -> None:
    keep(tmp_path, "torque", section)
    (fault,) = list_fits(tmp_path / "fits")
    assert isinstance(fault, DataError)
    assert expected in str(fault)


def test_numbers_of_a_parameter_stand_in_one_order_and_come_back() -> None:
    inertia, other = "inertia.matrix_kg_m2", "drag.cross_coupling_kg_per_rad"

    assert numbers_of(inertia, MATRIX) == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert names_of(inertia, MATRIX)[3:] == [f"{inertia} xy", f"{inertia} xz", f"{inertia} yz"]
    assert numbers_of(other, MATRIX) == [1.0, 4.0, 5.0, 4.0, 2.0, 6.0, 5.0, 6.0, 3.0]
    assert names_of(other, MATRIX)[5] == f"{other} [1] [2]"
    for key, value in ((inertia, MATRIX), (other, MATRIX), ("a", [1.0, 2.0]), ("b", 3.0)):
        assert shaped_as(key, numbers_of(key, value), value) == value


def test_a_covariance_that_is_not_known_is_not_kept() -> None:
    assert covariance_between({"a": 1.0}, [[float("nan")]]) == ()
    assert covariance_between({"a": 1.0}, [[0.0]]) == ()
    assert covariance_between({"a": 1.0}, [[2.0]]) == (Covariance(("a",), ((2.0,),)),)
