"""Stored fits: each is complete, in a separate file, and can be read back."""

import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.errors import ConfigError, DataError
from cfid.findings import rejection, warning
from cfid.records.covariances import Covariance, covariance_between, names_of, numbers_of, shaped_as
from cfid.records.fits import Fit, is_withdrawn, keep_fit, list_fits, path_of, withdraw
from cfid.records.parameters import Parameter, Section, Source
from tests.lab import keep

FIT = Fit(
    name="inertia",
    command="fit inertia",
    section=Section(
        method="default",
        found=datetime(2026, 11, 21, 8, 30, 12, tzinfo=UTC),
        cfid_version="0.1.0",
        accepted=True,
        sources=(Source("runs/a/encoder.csv", "0" * 64),),
        parameters={"inertia.matrix_kg_m2": Parameter(value=np.eye(3), std=0.1 * np.eye(3), unit="kg m^2")},
    ),
    quality={"rms": 0.5, "windows": [[1.0, None]]},
    findings=(warning("a-code", "one", "inertia.*"), rejection("b-code", "two")),
    figures=("figures/inertia.svg",),
)


def content(fit: Fit) -> dict[str, Any]:
    """Return what a fit states, without its place among others and without its arrays."""
    return {**vars(fit), "section": replace(fit.section, parameters={}), "number": 0, "stem": ""}


def kept(folder: Path, fit: Fit) -> Path:
    return path_of(folder, keep_fit(folder, fit))


def test_a_fit_comes_back_as_it_was_kept(tmp_path: Path) -> None:
    keep_fit(tmp_path / "fits", FIT)
    (found,) = list_fits(tmp_path / "fits")

    assert isinstance(found, Fit)
    assert found.section.parameters["inertia.matrix_kg_m2"].value == np.eye(3).tolist()
    assert content(found) == content(FIT)


def test_fits_are_in_the_order_of_their_numbers_whatever_the_clock_said_and_broken_ones_are_named(
    tmp_path: Path,
) -> None:
    before = replace(FIT, section=replace(FIT.section, found=datetime(2025, 11, 22, tzinfo=UTC)))
    broken = kept(tmp_path, FIT)
    broken.write_text(broken.read_text()[:100])
    keep_fit(tmp_path, FIT)
    keep_fit(tmp_path, before)
    first, last, fault = list_fits(tmp_path)

    assert isinstance(first, Fit)
    assert isinstance(last, Fit)
    assert (first.number, last.number, last.section.found < first.section.found) == (2, 3, True)
    assert isinstance(fault, DataError)
    assert "0001_inertia.json: invalid: " in str(fault)


def test_a_withdrawn_fit_stays_and_its_number_is_not_given_again(tmp_path: Path) -> None:
    fit = keep_fit(tmp_path, FIT)
    before = path_of(tmp_path, fit).read_bytes()
    withdraw(tmp_path, fit)

    assert is_withdrawn(tmp_path, fit)
    assert path_of(tmp_path, fit).read_bytes() == before
    with pytest.raises(ConfigError, match="0001_inertia: was withdrawn before"):
        withdraw(tmp_path, fit)
    path_of(tmp_path, fit).unlink()
    assert keep_fit(tmp_path, FIT).number == 2


def test_a_fit_of_a_file_whose_name_is_no_utf_8_stays_readable(tmp_path: Path) -> None:
    odd = replace(FIT, section=replace(FIT.section, sources=(Source("/x/a\udcff.csv", "0" * 64),)))
    keep_fit(tmp_path, odd)
    (found,) = list_fits(tmp_path)

    assert isinstance(found, Fit)
    assert found.section.sources[0].path == "/x/a?.csv"


def test_a_fit_of_version_0_2_is_read_and_comes_before_numbered_ones(tmp_path: Path) -> None:
    keep_fit(tmp_path, FIT)
    content = json.loads(kept(tmp_path, FIT).read_text())
    del content["number"], content["revision"]
    (tmp_path / "2026-11-21_083012_inertia.json").write_text(json.dumps(content | {"format": 3}))
    first = list_fits(tmp_path)[0]

    assert isinstance(first, Fit)
    assert (first.stem, first.number, first.revision) == ("2026-11-21_083012_inertia", 0, 1)


@pytest.mark.parametrize("number", ["4", 4.0, True, None, 2, 5])
def test_a_format_that_is_not_read_is_refused_by_name(number: object, tmp_path: Path) -> None:
    path = kept(tmp_path, FIT)
    path.write_text(json.dumps(json.loads(path.read_text()) | {"format": number}))
    (fault,) = list_fits(tmp_path)

    assert isinstance(fault, DataError)
    assert str(path) in str(fault)
    assert ("newer cfid" in str(fault)) == (number == 5)


# Covariances, common causes and rejections


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
