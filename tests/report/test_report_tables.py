"""Figures of merit become tables that fit a page."""

import pytest

from cfid.report.tables import quality_tables


def test_parts_of_an_uncertainty_are_a_row_a_quantity_the_largest_first() -> None:
    parts = {"fit": [1.0, None], "gain": [2.0, 3.0], "arm": [0.7, 0.0], "talk": [0.5, 0.0], "yaw": [0.001, 0.0]}
    (table,) = quality_tables({"common_causes": {"motor.torque_poly": parts}})

    assert table.columns == ("quantity", "parts")
    assert table.rows == (("motor.torque_poly", "gain 85 %, fit 9 %, arm 4 %, others 2 %"),)


@pytest.mark.parametrize(
    "edited",
    [
        {"a": {"fit": [1.0], "gain": [1.0, 2.0]}}, {"a": {"fit": "much"}}, {"a": 1},
        {"a": {"fit": [1e308]}}, {"a": {"fit": [10**400]}}, {"a": {"fit": [float("nan")]}},
    ],
)  # fmt: skip
def test_an_edited_budget_is_shown_as_it_is(edited: object) -> None:
    assert list(quality_tables({"common_causes": edited}))
