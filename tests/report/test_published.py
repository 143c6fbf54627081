"""Published values, each with its source, in one unit and frame, next to the values of this campaign."""

from pathlib import Path
from typing import Any

import pytest

from cfid.records.campaign import Campaign
from cfid.report.texts import comparison_grid, comparison_notes, sources_of
from tests.export.thesis_vehicle import INERTIA_KG_M2
from tests.lab import new_campaign
from tests.report.fits_by_hand import APPENDIX_A, number, put, put_appendix_a, report_of

COPIED = {"Bitcraze Gazebo model", "Bitcraze firmware (Brescianini)", "Bitcraze firmware (Lee)"}


def comparison(campaign: Campaign, title: str) -> dict[str, Any]:
    return next(each for each in report_of(campaign)["comparisons"] if each["title"].startswith(title))


def test_every_published_number_names_its_source(campaign: Campaign) -> None:
    for each in report_of(campaign)["comparisons"]:
        assert each["others"]
        assert all(row["source"] and len(row["values"]) == len(each["columns"]) for row in each["others"])


def test_the_thesis_vehicle_is_the_thesis_vehicle(campaign: Campaign) -> None:
    assert [comparison(campaign, title)["yours"] is None for title in ("Mass", "Inertia")] == [False, True]
    put_appendix_a(campaign)
    for title in ("Mass", "Inertia", "Thrust of the command", "Rotor speed", "Torque", "Drag per rotor"):
        each = comparison(campaign, title)
        assert each["others"][0]["values"] == pytest.approx(each["yours"]["values"]), title
    stds = comparison(campaign, "Inertia")["yours_std"]
    assert stds == pytest.approx([abs(value) / 100 for value in comparison(campaign, "Inertia")["yours"]["values"]])


@pytest.mark.parametrize(
    ("section", "title"),
    [
        ("inertia", "Inertia"),
        ("torque", "Torque"),
        ("speed", "Drag per velocity"),
    ],
)
def test_rejected_values_are_marked(campaign: Campaign, section: str, title: str) -> None:
    put_appendix_a(campaign)
    accepted = comparison_notes(comparison(campaign, title))
    for path in campaign.fits_folder.glob(f"*_{section}.json"):
        path.unlink()
    put(campaign, section, APPENDIX_A[section], rejected="too little.")
    rejected = comparison_notes(comparison(campaign, title))

    assert "REJECTED" not in " ".join(accepted)
    assert f"REJECTED by its fit, and kept nevertheless ({section})" in " ".join(rejected)


def test_the_thesis_matrix_is_turned_from_its_pitch_axis_and_its_copies_are_marked(campaign: Campaign) -> None:
    inertia = comparison(campaign, "Inertia")
    rows = {row["who"]: row for row in inertia["others"]}

    assert inertia["columns"] == ["roll", "pitch", "yaw", "roll-pitch", "roll-yaw", "pitch-yaw"]
    assert rows["thesis"]["values"] == pytest.approx(
        (16.655602e-6, 16.571710e-6, 29.261652e-6, -0.830806e-6, 1.800197e-6, -0.718277e-6)
    )
    assert rows["Bitcraze Gazebo model"]["values"][0] == 16.571710e-6
    assert rows["RotorPy"]["values"][3:] == [None] * 3
    assert {who for who, row in rows.items() if "not turned" in row["note"]} == COPIED


def test_a_matrix_in_a_frame_with_x_forward_is_not_turned(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path, ('forward = "y"', 'forward = "x"'), ('left = "-x"', 'left = "y"'))
    put(campaign, "inertia", {"inertia.matrix_kg_m2": number(INERTIA_KG_M2, "kg m^2")})

    assert comparison(campaign, "Inertia")["yours"]["values"][:3] == [16.571710e-6, 16.655602e-6, 29.261652e-6]


def test_a_map_is_not_continued_beyond_the_commands_it_was_measured_at(campaign: Campaign) -> None:
    table = number([{"cmd": command, "thrust_n": 0.01} for command in (10000, 40000)], "as named", None)
    put(campaign, "thrust", {**APPENDIX_A["thrust"], "motor.table": table})
    yours = comparison(campaign, "Thrust of the command")["yours"]

    assert [value is None for value in yours["values"]] == [False, False, True, True]


def test_others_are_stated_in_per_cent_of_yours_or_as_a_multiple(campaign: Campaign) -> None:
    put_appendix_a(campaign)
    torque = comparison(campaign, "Torque")
    cells = {row[0]: row[2] for row in comparison_grid(torque, sources_of((torque,))).rows}

    assert cells["this campaign"] == "5.965 ± 0.060"
    assert cells["thesis"] == "5.965 (0.0 %)"
    assert cells["RotorPy"] == "33.91 (5.7 times)"


def test_drag_per_velocity_needs_the_speeds_that_hover(campaign: Campaign) -> None:
    put(campaign, "drag", APPENDIX_A["drag"])
    assert comparison(campaign, "Drag per velocity")["yours"] is None

    put_appendix_a(campaign)
    yours = comparison(campaign, "Drag per velocity")["yours"]
    assert yours["values"][0] == pytest.approx(-9.1785e-7 * 4 * 1897, rel=0.01)

    put(campaign, "thrust", {"motor.thrust_poly": number([1e-6, 0.0], "N(cmd)")}, minutes=1)  # too weak to hover
    assert comparison(campaign, "Drag per velocity")["yours"] is None
