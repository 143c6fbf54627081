"""The registry of quantities has one row per key, which gives the unit, the shape and the order of a value."""

import pytest

from cfid.experiments import EXPERIMENTS
from cfid.quantities.registry import QUANTITIES, Shape, find, registered, unit_of
from cfid.quantities.values import coefficient_units, evaluate, numbers, shape_error

SYMMETRIC = [[1.0, 4.0, 5.0], [4.0, 2.0, 6.0], [5.0, 6.0, 3.0]]


def test_a_key_has_one_row() -> None:
    keys = [quantity.key for quantity in QUANTITIES]

    assert len(set(keys)) == len(keys)
    assert {quantity.section for quantity in QUANTITIES} == {*EXPERIMENTS, "", "set", "tf verify"}
    assert all(quantity.given_by and quantity.title for quantity in QUANTITIES)


@pytest.mark.parametrize(
    ("key", "row"),
    [
        ("tf.delay_s", "tf.delay_s"),
        ("tf.series.2026-11-21 a.delay_s", "tf.series.<series>.delay_s"),
        ("inertia.axis_kg_m2.roll", "inertia.axis_kg_m2.<axis>"),
        ("recording.samples", "recording.[<device>.]samples"),
        ("recording.loadcell.samples", "recording.[<device>.]samples"),
        ("recording.commands.mean.vbat_v", "recording.[<device>.]mean.<column>"),
    ],
)
def test_a_key_finds_its_row(key: str, row: str) -> None:
    assert registered(key).key == row


@pytest.mark.parametrize("key", ["", "thing", "tf.delay", "inertia.axis_kg_m2", "inertia.axis_kg_m2.", "tf.series.s"])
def test_another_key_has_no_row(key: str) -> None:
    assert find(key) is None


def test_a_name_ends_with_the_unit_that_the_registry_has() -> None:
    found = {quantity.key: unit_of(f"noted {quantity.key}") for quantity in QUANTITIES}  # the end alone decides
    known = {key: unit for key, unit in found.items() if unit}

    assert len(known) > 30
    assert known == {key: registered(key).unit for key in known}


@pytest.mark.parametrize(
    ("key", "unit"),
    [
        ("motor.torque_poly", "Nm(N)"),
        ("wall_mm", "mm"),
        ("wind_mps", "m/s"),
        ("turn_rad_per_s", "rad/s"),
        ("wind_m_per_s", ""),
        ("thing", ""),
        ("recording.commands.mean.vbat_v", "V"),
        ("drag.complex.normalised.k1", ""),
    ],
)
def test_a_unit_is_the_registrys_or_what_a_name_ends_with(key: str, unit: str) -> None:
    assert unit_of(key) == unit


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("tf.numerator", [1.0], ""),
        ("tf.numerator", [], "should be a list of coefficients"),
        ("motor.thrust_speed_poly", [1.0, 2.0], "should be a list of 3 numbers"),
        ("drag.complex.k1", 1.0, "should be a list of 3 numbers"),
        ("rotor.speed_rad_s", [1.0, None], ""),
        ("rotor.speed_rad_s", [[1.0]], "should be a number or a list of numbers"),
        ("motor.table", [], "should be a list of rows"),
        ("motor.table", [{"cmd": 1}, 2], "should be made of numbers"),
        ("inertia.axis_kg_m2.roll", True, "should be made of numbers"),
        ("inertia.axis_kg_m2.roll", [1.0], "should be a number"),
        ("noted_by_hand", {"any": "thing"}, ""),
    ],
)
def test_a_value_has_the_shape_of_its_key(key: str, value: object, expected: str) -> None:
    assert shape_error(key, value, None) == expected


def test_a_deviation_is_shaped_as_its_value() -> None:
    assert shape_error("tf.lags_s", [1.0, 2.0], [0.1, None]) == ""
    assert shape_error("tf.lags_s", [1.0, 2.0], 0.1) == "and its std should have the same shape"


def named(key: str, value: object, std: object = None) -> list[tuple[str, float | None, float | None]]:
    return [(one.name, one.value, one.std) for one in numbers(key, value, std)]


def test_numbers_come_one_by_one_and_those_of_a_symmetric_matrix_once() -> None:
    assert named("a_m", 1.0, 0.1) == [("a_m", 1.0, 0.1)]
    assert named("a_m", [1.0, None], [0.1, 0.2]) == [("a_m [0]", 1.0, 0.1), ("a_m [1]", None, 0.2)]
    assert [one.place for one in numbers("a_m", SYMMETRIC, None)] == ["xx", "yy", "zz", "xy", "xz", "yz"]
    assert [value for _, value, _ in named("a_m", SYMMETRIC)] == [1, 2, 3, 4, 5, 6]
    askew = [[1.0, 2.0, 3.0], *SYMMETRIC[1:]]
    assert [name for name, _, _ in named("a_m", askew, askew)][:4] == ["a_m xx", "a_m xy", "a_m xz", "a_m yx"]
    assert [value for _, value, _ in named("a_m", askew)] == [std for _, _, std in named("a_m", askew, askew)]
    assert named("a_m", [[1.0], [2.0]]) == [("a_m [0] [0]", 1.0, None), ("a_m [1] [0]", 2.0, None)]
    assert named("a_m", [{"m": 1.0}]) == named("a_m", "text") == []


def test_a_polynomial_knows_its_order() -> None:
    assert evaluate("motor.thrust_poly", [1.0, 2.0, 3.0], 10.0) == 123.0
    assert evaluate("motor.thrust_voltage_poly", [1.0, 2.0, 3.0, 0.0], 10.0) == 321.0
    assert coefficient_units("motor.thrust_poly", 3) == ["N/cmd^2", "N/cmd", "N"]
    assert coefficient_units("motor.thrust_voltage_poly", 4) == ["N", "N/V", "N/V^2", "N/V^3"]
    assert coefficient_units("motor.torque_poly", 4) == ["N m/N^3", "m/N", "m", "N m"]
    assert coefficient_units("tf.numerator", 2) == ["N", "N"]
    assert all(one.of and one.over for one in QUANTITIES if one.shape is Shape.POLYNOMIAL)
