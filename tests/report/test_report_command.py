"""`cfid report` makes one file in the requested format, and replaces only unchanged files that cfid made."""

import json
import os
from pathlib import Path

import pytest

from cfid.errors import ConfigError
from cfid.report.sealed import MARK, write_report
from tests.lab import Cfid, new_campaign
from tests.report.fits_by_hand import put_appendix_a

TEXT = f"<!-- {MARK} -->\nwhat was measured\n"


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
    assert json.loads(cfid("report", "--json").stdout)["file"] == str(campaign / "report.html")


def test_the_name_of_the_file_states_its_format(cfid: Cfid, campaign: Path) -> None:
    begins = {"sheet.tex": "%", "of.json": "{", ".json": "{", "page.html": "<!DOCTYPE html>", "page": "<!DOCTYPE"}
    for name, begin in begins.items():
        assert cfid("report", "--out", name).returncode == 0
        assert (campaign / name).read_text().startswith(begin)
    assert cfid("report", "--out", "new/also.tex", "--format", "json").returncode == 0
    assert json.loads((campaign / "new" / "also.tex").read_text())["about"]["vehicle"] == "Crazyflie 2.0"
    assert cfid("report", "--out", "report.pdf").returncode == 2
    assert not (campaign / "report.pdf").exists()


def test_nothing_that_a_campaign_keeps_is_replaced_whatever_is_forced(cfid: Cfid, campaign: Path) -> None:
    """With --force, a report replaced a recording, and through a link rig.toml; one among fits counted as a fit."""
    (campaign / "runs/one").mkdir(parents=True, exist_ok=True)
    for file in ("fits/a.json", "runs/one/encoder.csv", "runs/one/run.toml"):
        (campaign / file).write_text("measured")
    (campaign / "link").symlink_to("rig.toml")
    (campaign / "linked").symlink_to("fits")
    before = {path: path.read_bytes() for path in sorted(campaign.rglob("*")) if path.is_file()}
    for name in ("rig.toml", "link", "fits/a.json", "runs/one/encoder.csv", "linked/deeper/report.json"):
        assert cfid("report", "--format", "md", "--out", name, "--force").returncode == 2, name

    assert {path: path.read_bytes() for path in sorted(campaign.rglob("*")) if path.is_file()} == before


def test_without_a_campaign_or_a_place_for_the_file_there_is_no_report(cfid: Cfid, tmp_path: Path) -> None:
    assert cfid("report", folder=tmp_path).returncode == 2
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").write_text("")
    os.mkfifo(tmp_path / "pipe.md")
    for path in (tmp_path / "file" / "report.md", tmp_path, tmp_path / "pipe.md"):
        for force in (False, True):
            with pytest.raises(ConfigError):
                write_report(path, TEXT, force=force)
    assert (tmp_path / "pipe.md").is_fifo()


def test_equal_reports_make_equal_files_and_replace_each_other(tmp_path: Path) -> None:
    for name in ("a.md", "b.md"):
        write_report(tmp_path / name, TEXT)
    assert (tmp_path / "a.md").read_bytes() == (tmp_path / "b.md").read_bytes()

    write_report(tmp_path / "a.md", TEXT + "campaign \udcff\n")  # a folder's name that is not UTF-8
    assert (tmp_path / "a.md").read_text().endswith("campaign ?\n")


@pytest.mark.parametrize("content", ["mine\n", "", TEXT, "edited"])
def test_a_file_that_cfid_did_not_make_or_that_was_edited_stays_unless_forced(tmp_path: Path, content: str) -> None:
    path = tmp_path / "report.md"
    if content == "edited":
        write_report(path, TEXT)
        content = path.read_text() + "my remark\n"
    path.write_text(content)

    with pytest.raises(ConfigError):
        write_report(path, TEXT)
    assert path.read_text() == content
    write_report(path, TEXT, force=True)
    assert "remark" not in path.read_text()
