"""`cfid export` on the command line: places of files, protected files, messages, exit codes, JSON."""

import json
import re
import tomllib
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from cfid.export.catalogue import TARGETS
from cfid.records.campaign import open_campaign
from cfid.records.covariances import Covariance
from cfid.records.rig_file import new_rig_text
from cfid.records.run import DeviceRecord, Label, amend_run
from cfid.records.run_writer import create_run
from tests.export.thesis_vehicle import section, sections
from tests.lab import Cfid, keep, keep_instead


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    """A campaign with the thesis' numbers, in the folder where `cfid` runs."""
    (tmp_path / "rig.toml").write_text(new_rig_text())
    for name, found in sections().items():
        keep(tmp_path, name, found)
    open_campaign(tmp_path).write_parameters()
    return tmp_path


def test_a_file_is_written_into_the_campaign_and_its_path_is_all_of_stdout(cfid: Cfid, campaign: Path) -> None:
    ended = cfid("export", "crazyflow")

    path = campaign / "exports" / "crazyflow_params.toml"
    assert (ended.returncode, Path(ended.stdout.strip()).resolve()) == (0, path.resolve())
    assert tomllib.loads(path.read_text())["cf2x_L250"]["mass"] == 0.028
    assert "rotor_inertia_kg_m2" in ended.stderr


def test_a_dash_is_stdout_and_nothing_but_the_file(cfid: Cfid, campaign: Path) -> None:
    ended = cfid("export", "crazyflow", "--out", "-")

    assert tomllib.loads(ended.stdout)["cf2x_L250"]["mass"] == 0.028
    assert not (campaign / "exports").exists()


def test_a_file_goes_where_it_is_told(cfid: Cfid, campaign: Path) -> None:
    assert cfid("export", "mujoco", "--out", "a/b.xml").returncode == 0
    assert (campaign / "a" / "b.xml").read_text().startswith("<!--")


def test_a_file_that_is_there_is_overwritten_by_force_alone(cfid: Cfid, campaign: Path) -> None:
    (campaign / "mine.h").write_text("mine")
    ended = cfid("export", "firmware", "--out", "mine.h")

    assert (ended.returncode, ended.stdout, (campaign / "mine.h").read_text()) == (2, "", "mine")
    assert "--force" in ended.stderr
    assert cfid("export", "firmware", "--out", "mine.h", "--force").returncode == 0
    assert "CF_MASS" in (campaign / "mine.h").read_text()


@pytest.mark.parametrize("name", ["rig.toml", "parameters.toml", "a-link"])
def test_what_a_campaign_keeps_is_overwritten_by_no_force(cfid: Cfid, campaign: Path, name: str) -> None:
    (campaign / "a-link").symlink_to("rig.toml")
    before = (campaign / name).read_bytes()
    ended = cfid("export", "firmware", "--out", name, "--force")

    assert ended.returncode == 2
    assert "nothing replaces what a campaign keeps" in ended.stderr
    assert (campaign / name).read_bytes() == before


def test_what_is_missing_is_a_sentence_with_the_fit_and_no_file(cfid: Cfid, tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(new_rig_text())
    ended = cfid("export", "rotorpy")

    assert (ended.returncode, ended.stdout) == (4, "")
    assert "inertia.matrix_kg_m2 (`cfid fit inertia`)" in ended.stderr
    assert not (tmp_path / "exports").exists()


def test_what_was_rejected_is_exported_by_force_alone_and_marked(cfid: Cfid, campaign: Path) -> None:
    found = sections()["inertia"].parameters
    keep_instead(campaign, "inertia", section(found, rejected="too little."))
    refused = cfid("export", "crazyswarm2", "--out", "-")
    assert (refused.returncode, refused.stdout) == (4, "")
    assert "inertia.matrix_kg_m2 was rejected: too little. Use --force to write it" in " ".join(refused.stderr.split())

    ended = cfid("export", "crazyswarm2", "--out", "-", "--force")
    assert ended.returncode == 0
    assert "REJECTED by its fit" in ended.stdout
    assert "inertia.matrix_kg_m2 is rejected" in ended.stderr


def test_a_rig_without_a_body_frame_is_refused_by_key(cfid: Cfid, campaign: Path) -> None:
    before, _, after = new_rig_text().partition("[vehicle.body_frame]")
    (campaign / "rig.toml").write_text(before + after[after.index("[site]") :])
    ended = cfid("export", "firmware")

    assert (ended.returncode, "vehicle.body_frame is missing" in ended.stderr) == (2, True)


@pytest.mark.parametrize(
    ("words", "part"),
    [(("crazyfly",), "no such target"), (("mujoco", "--json"), "cfid export list"), ((), "TARGET")],
    ids=["an unknown target", "json of a file", "no target"],
)
def test_wrong_words_are_usage_errors(cfid: Cfid, campaign: Path, words: tuple[str, ...], part: str) -> None:
    ended = cfid("export", *words)

    assert (ended.returncode, ended.stdout) == (2, "")
    assert part in ended.stderr


def test_a_place_that_cannot_be_written_is_a_sentence(cfid: Cfid, campaign: Path) -> None:
    ended = cfid("export", "mujoco", "--out", "rig.toml/x.xml")

    assert ended.returncode == 2
    assert "cannot be written" in ended.stderr


def test_outside_a_campaign_there_is_nothing_to_export(cfid: Cfid) -> None:
    assert cfid("export", "list").returncode == 2


def test_the_json_has_the_covariances_of_numbers_that_depend_on_each_other(cfid: Cfid, campaign: Path) -> None:
    block = Covariance(("motor.max_thrust_n",), ((1.44e-6,),))
    keep_instead(campaign, "thrust", replace(sections()["thrust"], covariance=(block,)))
    found = json.loads(cfid("export", "json", "--out", "-").stdout)

    assert found["covariance"] == {"thrust": {"covariance": [{"of": ["motor.max_thrust_n"], "matrix": [[1.44e-6]]}]}}
    assert found["quantities"]["motor.max_thrust_n"]["std"] == 0.0012


def test_the_list_names_every_target_what_it_has_and_what_gives_the_rest(cfid: Cfid, tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(new_rig_text())
    ended = cfid("export", "list")

    assert ended.returncode == 0
    assert all(f"{name}: " in ended.stdout for name in TARGETS)
    assert "MISSING: inertia.matrix_kg_m2: `cfid fit inertia`" in ended.stdout
    assert "has: mass_kg" in ended.stdout


def test_the_list_as_json_is_one_object_with_needs_by_key(cfid: Cfid, campaign: Path) -> None:
    content = json.loads(cfid("export", "list", "--json").stdout)

    assert (content["command"], sorted(content)) == ("export list", ["command", "targets", "version"])
    rows = {row["target"]: row for row in content["targets"]}
    assert list(rows) == list(TARGETS)
    assert all(row["ready"] for row in rows.values())
    assert sorted(rows["mujoco"]) == ["about", "file", "needs", "ready", "rejected", "target", "uses"]
    lags = {"known": True, "keys": "dynamics.rising + dynamics.falling or tf.time_constant_s"}
    found = [need for need in rows["rotorpy"]["needs"] if "tf.time" in need["keys"]]
    assert [{key: need[key] for key in lags} for need in found] == [lags]


def test_the_list_says_what_is_not_ready(cfid: Cfid, tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(new_rig_text())
    rows = json.loads(cfid("export", "list", "--json").stdout)["targets"]

    assert [row["target"] for row in rows if row["ready"]] == ["firmware", "json"]


def test_what_a_hand_measured_is_taken(cfid: Cfid, campaign: Path) -> None:
    assert cfid("set", "arm_m", "0.05", "--std", "0.0001").returncode == 0
    assert cfid("set", "mass_kg", "0.0301").returncode == 0
    text = cfid("export", "firmware", "--out", "-").stdout

    assert "#define ARM_LENGTH 0.05f" in text
    assert "#define CF_MASS 0.0301f" in text


def test_numbers_of_a_simulated_or_excluded_run_are_said_to_be_so(cfid: Cfid, campaign: Path) -> None:
    writer = create_run(
        campaign / "runs",
        kind="swing",
        label=Label(axis="x"),
        devices={"encoder": DeviceRecord(file="encoder.csv", columns=("t", "phi"))},
        started=datetime(2026, 11, 21, 8, 30, tzinfo=UTC),
        cfid_version="0",
        simulated=True,
    )
    amend_run(writer.close("complete"), excluded="the cable touched")
    found = section(sections()["inertia"].parameters, run=writer.folder.name)
    keep_instead(campaign, "inertia", found)
    refused = cfid("export", "crazyswarm2", "--out", "-")
    assert (refused.returncode, refused.stdout) == (4, "")
    assert "inertia.matrix_kg_m2 is outdated. Fitted to runs that are now excluded" in " ".join(refused.stderr.split())
    ended = cfid("export", "crazyswarm2", "--out", "-", "--force")

    assert "SIMULATED, no vehicle was measured: inertia.matrix_kg_m2." in " ".join(ended.stderr.split())
    assert "made of SIMULATED recordings" in ended.stdout
    excluded = (
        f"Fitted to runs that are now excluded: {writer.folder.name} (the cable touched): fit again without them."
    )
    assert f"inertia.matrix_kg_m2: {excluded}" in " ".join(ended.stderr.split())
    assert excluded in ended.stdout


def test_a_mass_in_grams_and_an_arm_in_millimetres_are_refused_where_they_are_noted(cfid: Cfid, campaign: Path) -> None:
    before = {path.name: path.read_bytes() for path in campaign.iterdir() if path.is_file()}
    for words, expected in ((("mass_kg", "28"), "28.0 kg: grams?"), (("arm_m", "46"), "46.0 m: millimetres?")):
        ended = cfid("set", *words)
        assert ended.returncode == 2
        assert expected in ended.stderr
    assert {path.name: path.read_bytes() for path in campaign.iterdir() if path.is_file()} == before


def test_what_is_implausible_is_exported_by_force_alone_and_marked(cfid: Cfid, campaign: Path) -> None:
    assert cfid("set", "arm_m", "46", "--force").returncode == 0
    ended = cfid("export", "firmware")
    assert ended.returncode == 4
    assert "arm_m is implausible, 46.0 m: millimetres?" in " ".join(ended.stderr.split())
    assert not (campaign / "exports").exists()

    text = cfid("export", "firmware", "--out", "-", "--force").stdout
    assert "IMPLAUSIBLE: arm_m is implausible, 46.0 m" in text
    assert "#define ARM_LENGTH 46.0f" in text


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("gravity_mps2 = 981.0", "gravity_mps2 is implausible, 981.0 m/s^2: cm/s^2?"),
        ("centre_of_mass_mm = [70.0, 0.0, 17.4]", "x = 70.0 mm and y = 0.0 mm: beyond the rotors"),
    ],
)
def test_what_rig_toml_states_is_judged_as_well(cfid: Cfid, campaign: Path, line: str, expected: str) -> None:
    key, rig = line.partition(" ")[0], campaign / "rig.toml"
    rig.write_text(re.sub(rf"^{key} = .*$", line, rig.read_text(), count=1, flags=re.MULTILINE))
    refused = cfid("export", "mujoco", "--out", "-")
    assert (refused.returncode, refused.stdout) == (4, "")
    assert expected in " ".join(refused.stderr.split())

    forced = cfid("export", "mujoco", "--out", "-", "--force")
    assert forced.returncode == 0
    assert "IMPLAUSIBLE: " in forced.stdout
    assert expected in forced.stdout


def test_a_unit_that_contradicts_the_name_or_a_gravity_of_another_unit_is_not_noted(cfid: Cfid, campaign: Path) -> None:
    before = {path.name: path.read_bytes() for path in campaign.iterdir() if path.is_file()}
    for words, expected in (
        (("arm_m", "0.046", "--unit", "mm"), "arm_m is in m, as its name states, but --unit is mm"),
        (("mass_kg", "0.028", "--unit", "g"), "mass_kg is in kg, as its name states, but --unit is g"),
        (("gravity_mps2", "981"), "981.0 m/s^2: cm/s^2?"),
    ):
        ended = cfid("set", *words)
        assert ended.returncode == 2
        assert expected in " ".join(ended.stderr.split())
    assert {path.name: path.read_bytes() for path in campaign.iterdir() if path.is_file()} == before
    assert cfid("set", "arm_m", "0.046", "--unit", "m").returncode == 0


@pytest.mark.parametrize("target", ["mujoco", "rotorpy", "firmware"])
def test_a_body_that_cannot_be_is_exported_by_force_alone_and_marked(cfid: Cfid, campaign: Path, target: str) -> None:
    impossible = [[16.6e-6, 0.0, 0.0], [0.0, 16.7e-6, 0.0], [0.0, 0.0, 9e-5]]
    keep_instead(campaign, "inertia", section({"inertia.matrix_kg_m2": impossible}))
    refused = cfid("export", target, "--out", "-")
    assert (refused.returncode, refused.stdout) == (4, "")
    assert "inertia.matrix_kg_m2 is not that of a body" in " ".join(refused.stderr.split())

    assert (
        "IMPLAUSIBLE: inertia.matrix_kg_m2 is not that of a body"
        in cfid("export", target, "--out", "-", "--force").stdout
    )


@pytest.mark.parametrize("platform", ["cf2", "other"])
@pytest.mark.parametrize(
    "target", ["mujoco", "gym-pybullet-drones", "safe-control-gym", "firmware", "rotorpy", "samples"]
)
def test_an_inertia_of_zeros_is_refused(cfid: Cfid, campaign: Path, target: str, platform: str) -> None:
    rig = campaign / "rig.toml"
    rig.write_text(rig.read_text().replace('platform = "cf2"', f'platform = "{platform}"'))
    zeros = [[0.0] * 3] * 3
    keep_instead(campaign, "inertia", section({"inertia.matrix_kg_m2": zeros}))
    refused = cfid("export", target)
    assert (refused.returncode, refused.stdout) == (4, "")
    assert "inertia.matrix_kg_m2 is" in " ".join(refused.stderr.split())

    assert cfid("export", target, "--force").returncode in (0, 4)


def test_a_voltage_cubic_that_was_rejected_makes_no_header_and_says_why(cfid: Cfid, campaign: Path) -> None:
    whole = sections()["thrust"]
    cubic = "motor.thrust_voltage_poly"
    kept = {key: parameter for key, parameter in whole.parameters.items() if key != cubic}
    keep_instead(campaign, "thrust", replace(whole, parameters=kept, rejected={cubic: "It folds."}))
    for words in ((), ("--force",)):
        ended = cfid("export", "firmware", "--out", "-", *words)
        assert (ended.returncode, ended.stdout) == (4, "")
        assert "motor.thrust_voltage_poly was rejected: It folds." in " ".join(ended.stderr.split())
    assert cfid("export", "crazyflow", "--out", "-").returncode == 0  # crazyflow takes no such map


def test_force_makes_no_header_of_a_voltage_cubic_that_would_stop_the_motors(cfid: Cfid, campaign: Path) -> None:
    whole, cubic = sections()["thrust"], "motor.thrust_voltage_poly"
    kept = replace(whole.parameters[cubic], value=[0.0036, 0.0072, 0.0113, -0.00034])
    forced = replace(whole, parameters={**whole.parameters, cubic: kept}, rejected={cubic: "It folds."})
    keep_instead(campaign, "thrust", forced)
    for words in ((), ("--force",)):
        ended = cfid("export", "firmware", "--out", "-", *words)
        assert (ended.returncode, ended.stdout) == (4, "")
        assert "no header: motor.thrust_voltage_poly does not rise over all voltages" in " ".join(ended.stderr.split())
        assert "--force" not in ended.stderr


def test_a_voltage_cubic_may_be_noted_by_hand_if_the_firmware_can_invert_it(cfid: Cfid, campaign: Path) -> None:
    cubic = "motor.thrust_voltage_poly"
    ended = cfid("set", cubic, "0.0036,0.0072,0.0113,-0.0003")
    assert ended.returncode == 2
    assert "its motors stop. Nothing was changed." in " ".join(ended.stderr.split())

    assert cfid("set", cubic, "0.0067,0.0101,0.0103,0.0028").returncode == 0
    assert "#define VMOTOR2THRUST3 0.0028f" in cfid("export", "firmware", "--out", "-").stdout


@pytest.mark.parametrize("cubic", ["nan,0.01,0,0.001", "0,inf,0,0.001", "0,1,1e200,1"])
def test_a_voltage_cubic_that_single_precision_cannot_hold_is_not_noted(cfid: Cfid, campaign: Path, cubic: str) -> None:
    before = sorted(campaign.rglob("*"))
    ended = cfid("set", "motor.thrust_voltage_poly", "--", cubic)

    assert ended.returncode == 2
    assert "finite numbers in single precision. Nothing was changed." in " ".join(ended.stderr.split())
    assert sorted(campaign.rglob("*")) == before


@pytest.mark.parametrize("cubic", ["0,0.04,0,1e-30", "100,0.01,0,0.001"])
def test_a_voltage_cubic_that_no_header_could_have_is_not_noted(cfid: Cfid, campaign: Path, cubic: str) -> None:
    before = sorted(campaign.rglob("*"))
    ended = cfid("set", "motor.thrust_voltage_poly", "--", cubic)

    assert ended.returncode == 2
    assert "Nothing was changed." in ended.stderr
    assert sorted(campaign.rglob("*")) == before
