"""`cfid report` makes one file from a campaign in the requested format, and replaces only files that cfid made."""

import json
from pathlib import Path

import pytest

from cfid.records.campaign import open_campaign
from tests.lab import Cfid
from tests.report.fits_by_hand import new_campaign, put_appendix_a


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    put_appendix_a(new_campaign(tmp_path))
    return tmp_path


def test_the_report_is_a_page_in_the_campaign_folder_and_replaces_itself(cfid: Cfid, campaign: Path) -> None:
    for _ in range(2):
        ended = cfid("report")
        assert ended.returncode == 0, ended.stderr

    assert ended.stdout.strip() == str(campaign / "report.html")
    assert (campaign / "report.html").read_text().startswith("<!DOCTYPE html>")


def test_a_file_that_cfid_did_not_make_stays_unless_force_is_said(cfid: Cfid, campaign: Path) -> None:
    (campaign / "report.md").write_text("mine")
    ended = cfid("report", "--format", "md")

    assert ended.returncode == 2
    assert "not an unchanged report of cfid" in ended.stderr
    assert (campaign / "report.md").read_text() == "mine"
    assert cfid("report", "--format", "md", "--force").returncode == 0
    assert "16.57" in (campaign / "report.md").read_text()


def test_the_name_of_the_file_tells_its_format(cfid: Cfid, campaign: Path) -> None:
    begins = {"sheet.tex": "%", "of.json": "{", ".json": "{", "page.html": "<!DOCTYPE html>", "page": "<!DOCTYPE"}
    for name, begin in begins.items():
        assert cfid("report", "--out", name).returncode == 0
        assert (campaign / name).read_text().startswith(begin)
    assert cfid("report", "--out", "also.tex", "--format", "json").returncode == 0
    assert (campaign / "also.tex").read_text().startswith("{")
    other = cfid("report", "--out", "report.pdf")
    assert (other.returncode, "should end in .html, .md, .json, .tex" in other.stderr) == (2, True)
    assert not (campaign / "report.pdf").exists()


@pytest.mark.parametrize(
    "words",
    [
        ("report", "--out", "fits/report.json"),
        ("report", "--out", "fits/deeper/report.json"),
        ("report", "--out", "other/../linked/report.json"),
        ("export", "json", "--out", "fits/vehicle.json", "--force"),
        ("export", "samples", "--out", "fits/deeper", "--force"),
        ("fleet", ".", "--out", "fits/table.csv"),
        ("convert", "a.csv", "--to", "parquet", "--out", "fits/a.parquet"),
    ],
)
def test_nothing_else_lies_among_fits(cfid: Cfid, campaign: Path, words: tuple[str, ...]) -> None:
    """`cfid status` called such a file a fit to delete."""
    for name in ("fits", "other"):
        (campaign / name).mkdir(exist_ok=True)
    (campaign / "linked").symlink_to("fits")
    (campaign / "a.csv").write_text("t,phi_deg\n0,1\n0.1,2\n0.2,1\n")
    before = sorted((campaign / "fits").rglob("*"))
    ended = cfid(*words)

    assert (ended.returncode, "takes the campaign's fits alone" in " ".join(ended.stderr.split())) == (2, True)
    assert sorted((campaign / "fits").rglob("*")) == before


def test_fits_that_lie_elsewhere_stay_apart_too(cfid: Cfid, campaign: Path, tmp_path: Path) -> None:
    (campaign / "fits").rename(tmp_path / "disk")
    (campaign / "fits").symlink_to(tmp_path / "disk")
    before = sorted((tmp_path / "disk").iterdir())

    assert cfid("report", "--out", "fits/report.html").returncode == 2
    assert sorted((tmp_path / "disk").iterdir()) == before


@pytest.mark.parametrize("name", ["rig.toml", "link", "parameters.toml", "fits/a.json", "runs/one/encoder.csv"])
def test_nothing_that_a_campaign_keeps_is_replaced_whatever_is_forced(cfid: Cfid, campaign: Path, name: str) -> None:
    """With --force, a report replaced a recording, and through a link rig.toml."""
    for folder in ("fits", "runs/one"):
        (campaign / folder).mkdir(parents=True, exist_ok=True)
    for file in ("fits/a.json", "runs/one/encoder.csv", "runs/one/run.toml"):
        (campaign / file).write_text("measured")
    (campaign / "link").symlink_to("rig.toml")
    open_campaign(campaign).write_parameters()
    before = (campaign / name).read_bytes()
    ended = cfid("report", "--format", "md", "--out", name, "--force")

    assert ended.returncode == 2
    assert "nothing replaces what a campaign keeps" in " ".join(ended.stderr.split())
    assert (campaign / name).read_bytes() == before


def test_json_goes_where_it_is_told(cfid: Cfid, campaign: Path, tmp_path: Path) -> None:
    out = tmp_path / "elsewhere" / "of-today.json"
    assert cfid("report", "--format", "json", "--out", out, "--campaign", campaign).returncode == 0

    assert json.loads(out.read_text())["about"]["vehicle"] == "Crazyflie 2.0"


def test_without_a_campaign_there_is_no_report(cfid: Cfid, tmp_path: Path) -> None:
    ended = cfid("report", folder=tmp_path)

    assert ended.returncode == 2
    assert "cfid new" in ended.stderr


def test_a_fit_that_cannot_be_read_is_told_and_the_rest_reported(cfid: Cfid, campaign: Path) -> None:
    (campaign / "fits" / "2026-11-21_130000_thrust.json").write_text("{")
    ended = cfid("report")

    assert ended.returncode == 0
    assert "thrust.json: invalid: " in ended.stderr
    assert "What could not be read" in (campaign / "report.html").read_text()
