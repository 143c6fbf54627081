"""Published values, each with its source, in one unit and frame, next to the values of this campaign."""

from pathlib import Path

import pytest

from cfid.records.campaign import Campaign, find_campaign
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import new_rig_text
from cfid.report.comparison import PublishedComparison
from cfid.report.formats.grids import comparison_grid, comparison_notes, sources_of
from tests.report.fits_by_hand import APPENDIX_A, THESIS_MATRIX, new_campaign, number, put, put_appendix_a, report_of

COPIED = {"Bitcraze Gazebo model", "Bitcraze firmware (Brescianini)", "Bitcraze firmware (Lee)"}


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    return new_campaign(tmp_path)


def comparison(campaign: Campaign, title: str) -> PublishedComparison:
    return next(one for one in report_of(campaign).comparisons if one.title.startswith(title))


def test_every_published_number_names_its_source(campaign: Campaign) -> None:
    for one in report_of(campaign).comparisons:
        assert one.others
        for line in one.others:
            assert line.source
            assert len(line.values) == len(one.columns)


def test_the_thesis_vehicle_is_the_thesis_vehicle(campaign: Campaign) -> None:
    put_appendix_a(campaign)
    for title in ("Mass", "Inertia", "Thrust of the command", "Rotor speed", "Torque", "Drag per rotor"):
        one = comparison(campaign, title)
        assert one.yours is not None
        assert one.others[0].values == pytest.approx(one.yours.values), title


@pytest.mark.parametrize(
    ("section", "title"),
    [
        ("inertia", "Inertia"),
        ("thrust", "Thrust of the command"),
        ("torque", "Torque"),
        ("tf", "Time constant"),
        ("drag", "Drag per rotor"),
        ("speed", "Drag per velocity"),
    ],
)
def test_what_its_fit_rejected_is_marked_beside_the_published(campaign: Campaign, section: str, title: str) -> None:
    put_appendix_a(campaign)
    accepted = comparison(campaign, title)
    for path in campaign.fits_folder.glob(f"*_{section}.json"):
        path.unlink()
    put(campaign, section, APPENDIX_A[section], rejected="too little.")
    rejected = comparison(campaign, title)

    assert not any("REJECTED" in note for note in comparison_notes(accepted))
    assert any(f"REJECTED by its fit, and kept nevertheless ({section})" in note for note in comparison_notes(rejected))


def test_the_thesis_matrix_is_turned_from_its_pitch_axis_and_its_copies_are_marked(campaign: Campaign) -> None:
    inertia = comparison(campaign, "Inertia")
    lines = {line.who: line for line in inertia.others}

    assert inertia.columns == ("roll", "pitch", "yaw", "roll-pitch", "roll-yaw", "pitch-yaw")
    assert lines["thesis"].values == pytest.approx(
        (16.655602e-6, 16.571710e-6, 29.261652e-6, -0.830806e-6, 1.800197e-6, -0.718277e-6)
    )
    assert lines["Bitcraze Gazebo model"].values[0] == 16.571710e-6
    for who, line in lines.items():
        assert ("not turned" in line.note) == (who in COPIED)


def test_a_matrix_in_a_frame_with_x_forward_is_not_turned(tmp_path: Path) -> None:
    text = new_rig_text().replace('forward = "y"', 'forward = "x"').replace('left = "-x"', 'left = "y"')
    (tmp_path / RIG_FILE).write_text(text)
    campaign = find_campaign(tmp_path, start=tmp_path)
    assert campaign is not None
    put(campaign, "inertia", {"inertia.matrix_kg_m2": number(THESIS_MATRIX, "kg m^2")})
    yours = comparison(campaign, "Inertia").yours

    assert yours is not None
    assert yours.values[:3] == (16.571710e-6, 16.655602e-6, 29.261652e-6)


def test_a_map_is_not_continued_beyond_the_commands_it_was_measured_at(campaign: Campaign) -> None:
    table = number([{"cmd": command, "thrust_n": 0.01} for command in (10000, 40000)], "as named", None)
    put(campaign, "thrust", {**APPENDIX_A["thrust"], "motor.table": table})
    yours = comparison(campaign, "Thrust of the command").yours

    assert yours is not None
    assert [value is None for value in yours.values] == [False, False, True, True]


def test_what_this_campaign_lacks_has_no_line_of_its_own(campaign: Campaign) -> None:
    assert comparison(campaign, "Inertia").yours is None
    assert comparison(campaign, "Mass").yours is not None


def test_others_are_told_in_per_cent_of_yours_or_as_a_multiple(campaign: Campaign) -> None:
    put_appendix_a(campaign)
    torque = comparison(campaign, "Torque")
    cells = {row[0]: row[2] for row in comparison_grid(torque, sources_of((torque,))).rows}

    assert cells["this campaign"] == "5.965 ± 0.060"
    assert cells["thesis"] == "5.965 (0.0 %)"
    assert cells["RotorPy"] == "33.91 (5.7 times)"


def test_drag_per_velocity_needs_the_speeds_that_hover(campaign: Campaign) -> None:
    put(campaign, "drag", APPENDIX_A["drag"])
    assert comparison(campaign, "Drag per velocity").yours is None

    put_appendix_a(campaign)
    yours = comparison(campaign, "Drag per velocity").yours
    assert yours is not None
    assert yours.values[0] == pytest.approx(-9.1785e-7 * 4 * 1897, rel=0.01)


def test_a_vehicle_that_its_motors_cannot_carry_has_no_hover(campaign: Campaign) -> None:
    put_appendix_a(campaign)
    put(campaign, "thrust", {"motor.thrust_poly": number([1e-6, 0.0], "N(cmd)")}, minutes=1)
    assert comparison(campaign, "Drag per velocity").yours is None
