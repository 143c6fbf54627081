"""Several measurements of one quantity: which of them count, whether they agree, and how they drift."""

import math
from typing import Any

import numpy as np
import pytest

from cfid.records.campaign import Campaign
from cfid.report.repeats import Reading, compared
from cfid.report.texts import repeat_grid
from tests.report.fits_by_hand import number, put, report_of


def put_torque(campaign: Campaign, slope: float, sources: str, *, std: float | None = 0.1, **more: Any) -> None:
    """Keep a fit of sources with names of one letter, a minute after the fit of an earlier letter."""
    parameter = number([slope], "Nm(N)", None if std is None else [std])
    put(campaign, "torque", {"motor.torque_poly": parameter}, sources=list(sources), minutes=ord(sources[-1]), **more)


def slope_of(campaign: Campaign) -> dict[str, Any]:
    (repeat,) = report_of(campaign)["repeats"]
    (quantity,) = repeat["quantities"]
    return dict(quantity)


def test_fits_of_the_same_recordings_are_one_measurement_and_the_latest_counts(campaign: Campaign) -> None:
    put_torque(campaign, 5.0, "a")
    put_torque(campaign, 6.0, "a")
    report = report_of(campaign)

    assert report["repeats"] == []
    assert [experiment["parameters"][0]["value"] for experiment in report["experiments"]] == [6.0]
    assert len(report["experiments"][0]["notes"]) == 1


def test_readings_within_their_uncertainties_agree(campaign: Campaign) -> None:
    put_torque(campaign, 6.0, "a")
    put_torque(campaign, 6.1, "b")
    quantity = slope_of(campaign)

    assert quantity["chi_squared"] == pytest.approx(0.5)
    assert quantity["freedom"] == 1
    assert quantity["probability"] == pytest.approx(0.4795, abs=1e-4)
    assert quantity["agrees"]
    assert quantity["mean"] == pytest.approx(6.05)
    assert quantity["mean_std"] == pytest.approx(0.1)  # errors that both may share do not average out
    assert quantity["drift"] == pytest.approx(0.1)
    assert quantity["drift_std"] == pytest.approx(0.1 * 2**0.5)


def test_a_gain_that_readings_share_hides_no_difference_between_them(campaign: Campaign) -> None:
    gain = {"gain of Tz": {"motor.torque_poly": [0.6]}}
    put_torque(campaign, 6.0, "a", std=math.hypot(0.1, 0.6), common=gain)
    put_torque(campaign, 6.5, "b", std=math.hypot(0.1, 0.6), common=gain)
    quantity = slope_of(campaign)

    assert quantity["agrees"] is False
    assert quantity["chi_squared"] == pytest.approx(0.5**2 / 0.02)
    assert quantity["drift_std"] == pytest.approx(0.1 * 2**0.5)
    assert quantity["mean_std"] > 0.6
    assert repeat_grid(report_of(campaign)["repeats"][0]).rows[0][1] == "no"


def test_the_gains_of_two_instruments_count_in_a_difference(campaign: Campaign) -> None:
    for slope, cell in ((6.0, "a"), (6.5, "b")):
        common = {f"gain of cell {cell}": {"motor.torque_poly": [0.6]}}
        put_torque(campaign, slope, cell, std=math.hypot(0.1, 0.6), common=common)

    assert slope_of(campaign)["agrees"]


def test_the_mean_is_weighted_by_the_uncertainties(campaign: Campaign) -> None:
    put_torque(campaign, 6.0, "a", std=0.1)
    put_torque(campaign, 7.0, "b", std=0.3)

    assert slope_of(campaign)["mean"] == pytest.approx((6.0 * 9 + 7.0) / 10)


def test_readings_without_uncertainties_are_not_tested(campaign: Campaign) -> None:
    put_torque(campaign, 6.0, "a")
    put_torque(campaign, 6.1, "b", std=None)
    quantity = slope_of(campaign)

    assert (quantity["probability"], quantity["agrees"], quantity["mean"]) == (None, None, None)


def test_a_reading_that_was_rejected_is_shown_and_left_out(campaign: Campaign) -> None:
    put_torque(campaign, 6.0, "a")
    put_torque(campaign, 6.1, "b")
    put_torque(campaign, 9.0, "c", rejected="too little.")
    grid = repeat_grid(report_of(campaign)["repeats"][0])

    assert slope_of(campaign)["mean"] == pytest.approx(6.05)
    assert grid.rows[0][5] == "9.00 ± 0.10"
    assert grid.head[5].endswith(", rejected")


@pytest.mark.parametrize(("second", "is_shared"), [("bc", True), ("cd", False)])
def test_recordings_that_two_fits_share_are_stated(campaign: Campaign, second: str, is_shared: bool) -> None:
    put_torque(campaign, 6.0, "ab")
    put_torque(campaign, 6.1, second)

    assert bool(report_of(campaign)["repeats"][0]["shared"]) is is_shared


def test_how_a_swing_was_released_is_no_quantity_that_repeats(campaign: Campaign) -> None:
    for minutes, source in enumerate("ab"):
        parameters = {
            "swing.axis_inertia_kg_m2": number(3.1e-5 + 1e-8 * minutes, "kg m^2"),
            "swing.start_angle_rad": number(1.0 + minutes, "rad"),
        }
        put(campaign, "swing x", parameters, sources=[source], minutes=minutes)
    (repeat,) = report_of(campaign)["repeats"]

    assert [quantity["quantity"] for quantity in repeat["quantities"]] == ["swing.axis_inertia_kg_m2"]


def test_readings_with_true_uncertainties_disagree_once_in_a_hundred() -> None:
    stds = (0.1, 0.2, 0.3)
    draws = np.random.default_rng(1).normal(6.0, stds, size=(4000, 3)).tolist()
    disagree = [
        not compared([Reading(x, std, True) for x, std in zip(row, stds, strict=True)])["agrees"] for row in draws
    ]

    assert np.mean(disagree) == pytest.approx(0.01, abs=0.004)
