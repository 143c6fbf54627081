"""Several measurements of one quantity: which of them count, whether they agree, and how they drift."""

import math
from pathlib import Path

import numpy as np
import pytest

from cfid.records.campaign import Campaign
from cfid.report.formats.grids import repeat_grid
from cfid.report.repeats import Repeat, RepeatReading, compared
from tests.report.fits_by_hand import new_campaign, number, put, report_of


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    return new_campaign(tmp_path)


def torque(slope: float, std: float | None = 0.1) -> dict[str, object]:
    return {"motor.torque_poly": number([slope], "Nm(N)", None if std is None else [std])}


def put_torque(campaign: Campaign, slope: float, source: str, minutes: int, **more: object) -> None:
    std = more.pop("std", 0.1)
    put(campaign, "torque", torque(slope, std), sources=[source], minutes=minutes, **more)  # type: ignore[arg-type]


def slope_of(campaign: Campaign) -> Repeat:
    (fit,) = report_of(campaign).repeats
    (quantity,) = fit.quantities
    return quantity


def test_fits_of_the_same_recordings_are_one_measurement_and_the_latest_counts(campaign: Campaign) -> None:
    put_torque(campaign, 5.0, "a", 0)
    put_torque(campaign, 6.0, "a", 1)
    report = report_of(campaign)

    assert report.repeats == ()
    assert [one.parameters[0].value for one in report.experiments] == [6.0]
    assert report.experiments[0].notes == ("Another fit of the same recordings is not shown: this one counts.",)


def test_readings_within_their_deviations_agree(campaign: Campaign) -> None:
    put_torque(campaign, 6.0, "a", 0)
    put_torque(campaign, 6.1, "b", 1)
    quantity = slope_of(campaign)

    assert quantity.chi_squared == pytest.approx(0.5)
    assert quantity.freedom == 1
    assert quantity.probability == pytest.approx(0.4795, abs=1e-4)
    assert quantity.agrees
    assert quantity.mean == pytest.approx(6.05)
    assert quantity.mean_std == pytest.approx(0.1)  # errors that both may share do not average out
    assert quantity.drift == pytest.approx(0.1)
    assert quantity.drift_std == pytest.approx(0.1 * 2**0.5)


def test_the_scale_that_readings_share_hides_no_difference_between_them(campaign: Campaign) -> None:
    gain = {"gain of Tz": {"motor.torque_poly": [0.6]}}
    put_torque(campaign, 6.0, "a", 0, std=math.hypot(0.1, 0.6), common=gain)
    put_torque(campaign, 6.5, "b", 1, std=math.hypot(0.1, 0.6), common=gain)
    quantity = slope_of(campaign)

    assert quantity.agrees is False
    assert quantity.chi_squared == pytest.approx(0.5**2 / 0.02)
    assert quantity.drift_std == pytest.approx(0.1 * 2**0.5)
    assert quantity.mean_std is not None
    assert quantity.mean_std > 0.6


def test_the_scales_of_two_instruments_count_in_a_difference(campaign: Campaign) -> None:
    for place, cell in enumerate(("first", "second")):
        std, common = math.hypot(0.1, 0.6), {f"gain of the {cell} cell": {"motor.torque_poly": [0.6]}}
        put_torque(campaign, 6.0 + 0.5 * place, cell, place, std=std, common=common)

    assert slope_of(campaign).agrees


def test_readings_far_apart_do_not_agree(campaign: Campaign) -> None:
    put_torque(campaign, 6.0, "a", 0)
    put_torque(campaign, 6.5, "b", 1)

    assert slope_of(campaign).agrees is False
    assert repeat_grid(report_of(campaign).repeats[0]).rows[0][-1] == "no"


def test_the_mean_is_weighted_by_the_deviations(campaign: Campaign) -> None:
    put_torque(campaign, 6.0, "a", 0, std=0.1)
    put_torque(campaign, 7.0, "b", 1, std=0.3)

    assert slope_of(campaign).mean == pytest.approx((6.0 * 9 + 7.0) / 10)


def test_a_reading_that_was_rejected_is_shown_and_left_out(campaign: Campaign) -> None:
    put_torque(campaign, 6.0, "a", 0)
    put_torque(campaign, 6.1, "b", 1)
    put_torque(campaign, 9.0, "c", 2, rejected="too little.")
    (fit,) = report_of(campaign).repeats

    assert slope_of(campaign).mean == pytest.approx(6.05)
    assert "9.00 ± 0.10" in repeat_grid(fit).rows[0]
    assert "2026-11-21 12:02, rejected" in repeat_grid(fit).head


def test_readings_without_deviations_are_not_tested(campaign: Campaign) -> None:
    put_torque(campaign, 6.0, "a", 0)
    put_torque(campaign, 6.1, "b", 1, std=None)
    quantity = slope_of(campaign)

    assert quantity.probability is None
    assert quantity.agrees is None


def test_recordings_that_two_fits_share_are_told(campaign: Campaign) -> None:
    put(campaign, "torque", torque(6.0), sources=["a", "b"])  # type: ignore[arg-type]
    put(campaign, "torque", torque(6.1), sources=["b", "c"], minutes=1)  # type: ignore[arg-type]

    assert report_of(campaign).repeats[0].shared.startswith("A file is a source of more than one")


def test_how_a_swing_was_released_is_no_quantity_that_repeats(campaign: Campaign) -> None:
    for minutes, source in enumerate(("a", "b")):
        parameters = {
            "swing.axis_inertia_kg_m2": number(3.1e-5 + 1e-8 * minutes, "kg m^2"),
            "swing.start_angle_rad": number(1.0 + minutes, "rad"),
        }
        put(campaign, "swing x", parameters, sources=[source], minutes=minutes)
    (fit,) = report_of(campaign).repeats

    assert [quantity.quantity for quantity in fit.quantities] == ["swing.axis_inertia_kg_m2"]


def test_readings_with_true_deviations_disagree_once_in_a_hundred() -> None:
    rng = np.random.default_rng(1)
    draws = rng.normal(6.0, (0.1, 0.2, 0.3), size=(4000, 3))
    disagree = [
        not compared(
            "", "", tuple(RepeatReading(x, std, True) for x, std in zip(row, (0.1, 0.2, 0.3), strict=True))
        ).agrees
        for row in draws.tolist()
    ]

    assert np.mean(disagree) == pytest.approx(0.01, abs=0.004)
