"""A campaign of version 0.1 becomes one of the present version, and its old files stay."""

import json
from pathlib import Path

from cfid.records.fits import Fit, list_fits
from cfid.records.parameters import load_sections
from tests.campaigns import Cfid

PARAMETERS = """
[thrust]
method = "default"
found = 2026-11-21T08:30:12Z
cfid_version = "0.1.0"
believed = true
sources = [{ path = "x.csv", sha256 = "ab" }]
[thrust.parameters."motor.max_thrust_n"]
value = 0.15
std = 0.001
unit = "N"
"""
FIT = {
    "name": "thrust",
    "command": "fit thrust",
    "section": {
        "method": "default",
        "found": "2026-11-21T08:30:12Z",
        "cfid_version": "0.1.0",
        "believed": False,
        "sources": [{"path": "x.csv", "sha256": "ab"}],
        "parameters": {"motor.max_thrust_n": {"value": 0.15, "std": 0.001, "unit": "N"}},
    },
    "quality": {"rms": 0.5},
    "warnings": ["the map ends there."],
    "doubts": ["too little."],
    "lines": ["k is 2e-8"],
    "figures": ["figures/thrust.svg"],
}


def campaign_of_0_1(cfid: Cfid, folder: Path) -> Path:
    assert cfid("new", folder).returncode == 0
    (folder / "parameters.toml").write_text(PARAMETERS)
    (folder / "fits").mkdir()
    (folder / "fits" / "2026-11-21_083012_thrust.json").write_text(json.dumps(FIT))
    return folder


def test_every_value_survives_and_the_old_files_stay(cfid: Cfid, tmp_path: Path) -> None:
    folder = campaign_of_0_1(cfid, tmp_path / "old")
    before = load_sections(folder / "parameters.toml"), list_fits(folder / "fits")
    assert cfid("upgrade", folder).returncode == 0

    assert (load_sections(folder / "parameters.toml"), list_fits(folder / "fits")) == before
    assert (folder / "parameters.toml").read_text().startswith("format = 2")
    (fit,) = list_fits(folder / "fits")
    assert isinstance(fit, Fit)
    assert [(finding.severity, finding.text) for finding in fit.findings] == [
        ("rejection", "too little."),
        ("warning", "the map ends there."),
    ]
    kept = folder / "before-upgrade"
    assert (kept / "parameters.toml").read_text() == PARAMETERS
    assert json.loads((kept / "fits" / "2026-11-21_083012_thrust.json").read_text()) == FIT


def test_what_is_of_today_stays_as_it_is(cfid: Cfid, tmp_path: Path) -> None:
    folder = campaign_of_0_1(cfid, tmp_path / "old")
    cfid("upgrade", folder)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    again = cfid("upgrade", folder)

    assert again.stdout.startswith("nothing to do")
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_nothing_is_written_when_one_file_cannot_be_read(cfid: Cfid, tmp_path: Path) -> None:
    folder = campaign_of_0_1(cfid, tmp_path / "old")
    (folder / "fits" / "broken.json").write_text("{")
    ended = cfid("upgrade", folder)

    assert ended.returncode == 4
    assert "broken.json" in ended.stderr
    assert (folder / "parameters.toml").read_text() == PARAMETERS
    assert not (folder / "before-upgrade").exists()


def test_old_files_that_were_kept_are_not_written_over(cfid: Cfid, tmp_path: Path) -> None:
    folder = campaign_of_0_1(cfid, tmp_path / "old")
    cfid("upgrade", folder)
    edited = f"# edited\n{PARAMETERS}"
    (folder / "parameters.toml").write_text(edited)
    ended = cfid("upgrade", folder)

    assert ended.returncode == 2
    assert "exists already" in ended.stderr
    assert (folder / "parameters.toml").read_text() == edited
    assert (folder / "before-upgrade" / "parameters.toml").read_text() == PARAMETERS


def test_an_upgrade_that_failed_after_the_old_file_was_kept_goes_on(cfid: Cfid, tmp_path: Path) -> None:
    folder = campaign_of_0_1(cfid, tmp_path / "old")
    cfid("upgrade", folder)
    (folder / "parameters.toml").write_text(PARAMETERS)

    assert cfid("upgrade", folder).returncode == 0
    assert (folder / "before-upgrade" / "parameters.toml").read_text() == PARAMETERS
