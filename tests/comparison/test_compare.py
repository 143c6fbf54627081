"""Published values beside a campaign's: in one unit and frame, excluded by its uncertainty, the worst first."""

import json
from pathlib import Path

import pytest

from cfid.comparison.claims import Claim, Comparison, comparisons_of, comparisons_with, worst_first
from cfid.published import published_sets
from cfid.records.campaign import Campaign
from tests.export.thesis_vehicle import INERTIA_KG_M2
from tests.lab import ROOT, Cfid, new_campaign
from tests.report.fits_by_hand import APPENDIX_A, number, put, put_appendix_a

THESIS = "Crazyflie 2.0"


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    return new_campaign(tmp_path)


def compared(campaign: Campaign | None, quantity: str) -> Comparison:
    found = comparisons_of(None, "other") if campaign is None else comparisons_with(campaign, campaign.values())
    return next(each for each in found if each.quantity == quantity)


def claim_of(comparison: Comparison, who: str) -> Claim:
    return next(claim for claim in comparison.claims if claim.who == who)


def test_every_published_value_names_its_source() -> None:
    for comparison in comparisons_of(None, "other"):
        assert len(comparison.claims) > 1
        assert all(claim.source and claim.vehicle for claim in comparison.claims)


def test_the_thesis_vehicle_is_the_thesis_vehicle(campaign: Campaign) -> None:
    put_appendix_a(campaign)
    agreeing = 0
    for comparison in comparisons_with(campaign, campaign.values()):
        if comparison.own is not None and any(claim.who == "thesis" for claim in comparison.claims):
            thesis = claim_of(comparison, "thesis")
            assert thesis.value == pytest.approx(comparison.own.value, rel=1e-3), comparison.quantity
            assert not comparison.excluded(thesis)
            agreeing += 1
    assert agreeing >= 15


def test_a_value_is_excluded_by_the_uncertainty_of_both() -> None:
    own = Claim(1.0, 0.03, "mine")
    exact, stated, near = Claim(1.10, None, "a"), Claim(1.10, 0.05, "b"), Claim(1.05, None, "c")
    comparison = Comparison(quantity="mass", unit="kg", own=own, claims=(near, stated, exact))
    assert [comparison.excluded(claim) for claim in (exact, stated, near)] == [True, False, False]
    assert comparison.deviations(stated) == pytest.approx(0.1 / (0.03**2 + 0.05**2) ** 0.5)
    assert [claim.who for _, claim in worst_first([comparison])] == ["a", "b", "c"]


def test_a_rejected_value_excludes_nothing(campaign: Campaign) -> None:
    put_appendix_a(campaign)
    assert compared(campaign, "torque over thrust").own is not None
    for path in campaign.fits_folder.glob("*_torque.json"):
        path.unlink()
    put(campaign, "torque", APPENDIX_A["torque"], rejected="too little.")
    assert compared(campaign, "torque over thrust").own is None


def test_an_implausible_value_excludes_nothing(campaign: Campaign) -> None:
    put(campaign, "speed", {"motor.thrust_per_speed_squared_n_s2": number(3.6e-6, "N s^2/rad^2")})
    assert compared(campaign, "thrust over squared speed").own is None


def test_the_thesis_matrix_is_turned_from_its_pitch_axis() -> None:
    roll, pitch = (compared(None, f"moment about {axis}") for axis in ("roll", "pitch"))
    assert claim_of(roll, "thesis").value == pytest.approx(16.655602e-6)
    assert claim_of(pitch, "thesis").value == pytest.approx(16.571710e-6)
    assert claim_of(compared(None, "product roll-pitch"), "thesis").value == pytest.approx(-0.830806e-6)
    assert "not turned" in claim_of(roll, "Bitcraze Gazebo model").remark


def test_a_matrix_in_a_frame_with_x_forward_is_not_turned(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path, ('forward = "y"', 'forward = "x"'), ('left = "-x"', 'left = "y"'))
    put(campaign, "inertia", {"inertia.matrix_kg_m2": number(INERTIA_KG_M2, "kg m^2")})
    own = compared(campaign, "moment about roll").own
    assert own is not None
    assert own[:2] == pytest.approx((16.571710e-6, 16.571710e-8))


def test_a_map_is_not_continued_beyond_the_commands_it_was_measured_at(campaign: Campaign) -> None:
    for most, is_known in ((30000, False), (40000, True)):
        table = number([{"cmd": command, "thrust_n": 0.01} for command in (10000, most)], "as named", None)
        put(campaign, "thrust", {**APPENDIX_A["thrust"], "motor.table": table}, minutes=most)
        assert (compared(campaign, "thrust at half command").own is not None) is is_known


def test_drag_per_velocity_is_that_of_the_speeds_that_hover_and_not_one_term_of_six(campaign: Campaign) -> None:
    drag = {key: value for key, value in APPENDIX_A["drag"].items() if key.startswith("drag.complex")}
    put(campaign, "drag", drag)
    assert compared(campaign, "drag forward").own is None
    put_appendix_a(campaign)
    own = compared(campaign, "drag forward").own
    assert own is not None
    assert own.value == pytest.approx(9.1785e-7 * 4 * 1897, rel=0.02)


def test_a_variant_of_a_set_is_a_claim_of_its_own_where_it_differs() -> None:
    times = compared(None, "time constant")
    assert claim_of(times, "thesis").value == pytest.approx(0.0646555886)
    assert claim_of(times, "thesis (3.15)").value == pytest.approx(0.0774917148)


def test_vehicles_of_another_platform_are_left_out_unless_asked_for(campaign: Campaign, cfid: Cfid) -> None:
    brushless = {each.vehicle for each in published_sets().values() if each.platform == "cf21bl"}
    for words, expected in (((), False), (("--vehicle", "all"), True)):
        done = cfid("--json", "compare", "--no-figures", *words, folder=campaign.folder)
        assert done.returncode == 0, done.stderr
        claims = json.loads(done.stdout)["quality"]["claims"]
        assert any(claim["vehicle"] in brushless for claim in claims) is expected


def test_sets_are_compared_with_each_other_without_a_campaign(cfid: Cfid, tmp_path: Path) -> None:
    done = cfid("compare", "--out", "figures")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "figures" / "compare.svg").stat().st_size > 10_000
    row = next(line for line in done.stdout.splitlines() if line.startswith("torque over thrust"))
    assert "0.03391" in row


@pytest.mark.parametrize("vehicle", ["cf21bl", "cf2"])
def test_the_page_of_published_sets_has_what_the_command_prints(cfid: Cfid, vehicle: str) -> None:
    page = (ROOT / "docs" / "reference" / "published-sets.md").read_text()
    printed = page.partition(f"--vehicle {vehicle}`")[2].partition("```text\n")[2].partition("```")[0]
    assert printed == cfid("compare", "--vehicle", vehicle, "--no-figures").stdout
