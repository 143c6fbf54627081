"""`cfid export` on the command line: places of files, protected files, exit codes, the list."""

import json
import os
from dataclasses import replace
from pathlib import Path

import pytest

from cfid.records.covariances import Covariance
from cfid.records.rig_file import new_rig_text
from cfid.records.run import amend_run
from tests.export.reading import TARGETS, macros
from tests.export.thesis_vehicle import section, sections
from tests.lab import ROOT, Cfid, keep_instead, made_run, new_campaign


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_file_is_written_into_the_campaign_and_its_path_is_all_of_stdout(cfid: Cfid, campaign: Path) -> None:
    ended = cfid("export", "crazyflow")

    path = campaign / "exports" / "crazyflow_drone.py"
    assert (ended.returncode, Path(ended.stdout.strip()).resolve()) == (0, path.resolve())
    assert '"mass": 0.028,' in path.read_text()
    assert f"campaign {campaign.name}," in path.read_text()
    assert "rotor_inertia_kg_m2" in ended.stderr  # not measured


def test_json_names_the_files_and_what_to_know_of_them(cfid: Cfid, campaign: Path) -> None:
    one, several = (
        json.loads(cfid("export", *words, "--json").stdout) for words in (("crazyflow",), ("samples", "--n", "5"))
    )

    assert [Path(path).name for path in one["files"]] == ["crazyflow_drone.py"]
    assert "rotor_inertia_kg_m2" in one["notes"][-1]
    assert (len(several["files"]), several["draws"], several["rejected"]) == (4, 200, {})


def test_out_is_a_file_or_stdout(cfid: Cfid, campaign: Path) -> None:
    assert '"mass": 0.028,' in cfid("export", "crazyflow", "--out", "-").stdout
    assert not (campaign / "exports").exists()
    assert cfid("export", "mujoco", "--out", "a/b.xml").returncode == 0
    assert (campaign / "a" / "b.xml").read_text().startswith("<!--")


def test_a_file_that_exists_is_overwritten_by_force_and_what_a_campaign_keeps_by_none(
    cfid: Cfid, campaign: Path
) -> None:
    (campaign / "mine.h").write_text("mine")
    (campaign / "a-link").symlink_to("rig.toml")
    before = files(campaign)
    for name, *force in (
        ("mine.h",), ("rig.toml", "--force"), ("parameters.toml", "--force"), ("a-link", "--force"),
        ("fits/vehicle.json", "--force"),
    ):  # fmt: skip
        ended = cfid("export", "firmware", "--out", name, *force)
        assert (ended.returncode, ended.stdout, files(campaign)) == (2, "", before), name

    assert cfid("export", "firmware", "--out", "mine.h", "--force").returncode == 0
    assert "CF_MASS" in (campaign / "mine.h").read_text()


@pytest.mark.skipif(os.name != "posix", reason="names and devices of Unix")
def test_nothing_is_written_where_no_file_can_be(cfid: Cfid, campaign: Path) -> None:
    (campaign / "folder").mkdir()
    (campaign / "loop").symlink_to("loop")
    os.mkfifo(campaign / "pipe")
    before = files(campaign)
    for place in ("folder", "/", "/dev/null", "pipe", "n" * 300, "rig.toml/file", "loop", "loop/file", "/proc/x"):
        for more in ((), ("--force",)):
            ended = cfid("export", "crazyflow", "--out", place, *more)
            assert (ended.returncode, place in ended.stderr) == (2, True), place
    assert cfid("export", "samples", "--n", "2", "--out", "n" * 300).returncode == 2

    assert files(campaign) == before


def test_what_is_missing_names_the_fit_and_writes_no_file(cfid: Cfid, tmp_path: Path) -> None:
    new_campaign(tmp_path)
    ended = cfid("export", "rotorpy")

    assert (ended.returncode, ended.stdout) == (4, "")
    assert "inertia.matrix_kg_m2 (`cfid fit inertia`)" in ended.stderr
    assert not (tmp_path / "exports").exists()


def test_what_was_rejected_is_exported_by_force_alone_and_marked(cfid: Cfid, campaign: Path) -> None:
    keep_instead(campaign, "inertia", section(sections()["inertia"].parameters, rejected="too little."))
    refused = cfid("export", "crazyswarm2", "--out", "-")
    assert (refused.returncode, refused.stdout) == (4, "")
    assert "--force" in refused.stderr

    ended = cfid("export", "crazyswarm2", "--out", "-", "--force")
    assert (ended.returncode, "REJECTED: inertia.matrix_kg_m2." in ended.stdout) == (0, True)
    assert "REJECTED: inertia.matrix_kg_m2: too little." in " ".join(ended.stderr.split())


def test_numbers_of_a_simulated_and_excluded_run_are_marked(cfid: Cfid, campaign: Path) -> None:
    run = made_run(campaign, "swing", {"encoder": {"t": [0.0], "phi": [0.0]}}, simulated=True)
    amend_run(run, excluded="the cable touched")
    kept = replace(section(sections()["inertia"].parameters, run=run.folder.name), simulated=True)
    keep_instead(campaign, "inertia", kept)
    assert cfid("export", "crazyswarm2", "--out", "-").returncode == 4

    text = cfid("export", "crazyswarm2", "--out", "-", "--force").stdout
    assert "OUTDATED: inertia.matrix_kg_m2. SIMULATED: inertia.matrix_kg_m2." in text


def test_no_force_makes_a_header_that_would_stop_the_motors(cfid: Cfid, campaign: Path) -> None:
    key = "motor.thrust_voltage_poly"
    parameters = {**sections()["thrust"].parameters, key: [0.0036, 0.0072, 0.0113, -0.00034]}
    keep_instead(campaign, "thrust", section(parameters))
    for words in ((), ("--force",)):
        ended = cfid("export", "firmware", *words)
        assert (ended.returncode, ended.stdout, (campaign / "exports").exists()) == (4, "", False)
        assert "--force" not in ended.stderr


def test_what_a_hand_measured_is_taken(cfid: Cfid, campaign: Path) -> None:
    for key, value in (
        ("arm_m", "0.05"),
        ("mass_kg", "0.0301"),
        ("motor.thrust_voltage_poly", "0.0067,0.0101,0.0103,0.0028"),
    ):
        assert cfid("set", key, value).returncode == 0
    found = macros(cfid("export", "firmware", "--out", "-").stdout)

    assert (found["ARM_LENGTH"], found["CF_MASS"], found["VMOTOR2THRUST3"]) == (0.05, 0.0301, 0.0028)


@pytest.mark.parametrize(
    "words",
    [("crazyfly",), ("mujoco", "--json", "--out", "-"), (), ("firmware", "--n", "5"), ("samples", "--out", "-")],
)
def test_wrong_words_are_usage_errors(cfid: Cfid, campaign: Path, words: tuple[str, ...]) -> None:
    before = files(campaign)
    ended = cfid("export", *words)

    assert (ended.returncode, ended.stdout) == (2, "")
    assert files(campaign) == before


def test_a_rig_without_a_body_frame_or_no_campaign_is_refused(cfid: Cfid, tmp_path: Path) -> None:
    assert cfid("export", "list").returncode == 2
    before, _, after = new_rig_text().partition("[vehicle.body_frame]")
    (tmp_path / "rig.toml").write_text(before + after[after.index("[site]") :])

    assert cfid("export", "firmware").returncode == 2


def test_the_list_names_every_target_what_it_has_and_what_gives_the_rest(cfid: Cfid, campaign: Path) -> None:
    (campaign / "empty").mkdir()
    new_campaign(campaign / "empty")
    text = cfid("export", "list", folder=campaign / "empty").stdout
    full, empty = (
        json.loads(cfid("export", "list", "--json", folder=folder).stdout) for folder in (campaign, campaign / "empty")
    )

    assert all(f"{name}: " in text for name in TARGETS)
    assert "MISSING: inertia.matrix_kg_m2: `cfid fit inertia`" in text
    assert [row["target"] for row in full["targets"] if row["ready"]] == list(TARGETS)
    assert [row["target"] for row in empty["targets"] if row["ready"]] == ["firmware", "json"]
    rows = {row["target"]: row for row in full["targets"]}
    lag = {"keys": "dynamics.rising + dynamics.falling or tf.time_constant_s", "known": True}
    assert lag.items() <= rows["rotorpy"]["needs"][-1].items()


def test_the_reference_lists_every_target_and_its_file() -> None:
    page = (ROOT / "docs" / "reference" / "exports.md").read_text()

    assert all(f"| `{name}` | `{target.file_name}` |" in page for name, target in TARGETS.items())


def test_the_json_has_the_covariances_of_numbers_that_depend_on_each_other(cfid: Cfid, campaign: Path) -> None:
    block = Covariance(("motor.max_thrust_n",), ((1.44e-6,),))
    keep_instead(campaign, "thrust", replace(sections()["thrust"], covariance=(block,)))
    found = json.loads(cfid("export", "json", "--out", "-").stdout)

    assert found["covariance"] == {"thrust": {"covariance": [{"of": ["motor.max_thrust_n"], "matrix": [[1.44e-6]]}]}}
    assert found["quantities"]["motor.max_thrust_n"]["std"] == 0.0012
