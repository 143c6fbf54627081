"""Fits with edited figures of merit: entries that are no number or table are left out, and no report fails."""

import json
from pathlib import Path
from typing import Any

import pytest

from cfid.records.campaign import Campaign
from cfid.records.fits import Fit, list_fits
from cfid.report.formats.render import rendered
from tests.report.fits_by_hand import APPENDIX_A, new_campaign, number, put, report_of

EDITS: tuple[Any, ...] = (
    None, True, "x", [], {}, [[]], [{}, 1], [1, {}], [{"a": {}}, None], {"a": 1}, {"a": {"b": [1]}},
    {"a": {"clock_skew": 5}}, {"a": {"clock_skew": ["x", 1]}}, {"a": {"clock_skew": [None, 1e308, 1e308]}},
    [[1, 2, 3], [1, 2, 3], [1, 2, "x"]], 10**400,
    [{"known_kg_m2": 1}], ["known_kg_m2"], [[[[[[[[1]]]]]]]],
)  # fmt: skip
KEYS = ("verification_gain", "verification_gain_std", "series", "swings", "shape", "windows", "budget_kg_m2")


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    campaign = new_campaign(tmp_path)
    for name in ("thrust", "tf", "inertia"):
        put(campaign, name, APPENDIX_A[name], sources=[name], quality=dict.fromkeys(KEYS, 1.0))
    put(campaign, "latency", {"latency.clock_skew": number(1e-6, "1")}, sources=["l"], command="tf latency")
    return campaign


def edit(campaign: Campaign, quality: Any) -> list[Fit]:
    """Write a quality into all fits, and return the readable fits."""
    for path in campaign.fits_folder.glob("*.json"):
        path.write_text(json.dumps(json.loads(path.read_text()) | {"quality": quality}))
    return [fit for fit in list_fits(campaign.fits_folder) if isinstance(fit, Fit)]


@pytest.mark.parametrize("value", EDITS, ids=lambda value: repr(value)[:30])
def test_an_edited_quality_breaks_no_report(campaign: Campaign, value: Any) -> None:
    fits = edit(campaign, {**dict.fromkeys(KEYS, value), "verification_gain_std": 0.1})

    assert len(fits) == 4
    assert "16.57" in rendered(report_of(campaign), "md", campaign.folder)


@pytest.mark.parametrize("value", [None, "x", 1, [1]])
def test_a_quality_that_is_no_table_makes_the_fit_unreadable(campaign: Campaign, value: Any) -> None:
    assert edit(campaign, value) == []
    assert all("quality" in sentence for sentence in report_of(campaign).unreadable)
