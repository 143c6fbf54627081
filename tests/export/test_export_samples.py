"""`cfid export samples` draws possible vehicles from the uncertainties, and every file has the same numbers."""

import csv
import json
import re
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.export import crazyflow, rotorpy
from cfid.export.possible import impossible
from cfid.export.samples import FILES, with_values
from cfid.records.covariances import covariance_between, shaped_as
from cfid.records.parameters import Parameter, Section
from cfid.records.rig_file import new_rig_text
from cfid.records.run import DeviceRecord, Label
from cfid.records.run_writer import create_run
from tests.export.thesis_vehicle import INERTIA_KG_M2, section, sections, vehicle
from tests.lab import Cfid, keep, keep_instead, sections_at

STD = {  # standard uncertainties, in the unit of each number
    "motor.thrust_poly": [5e-13, 3e-8, 3e-4],
    "motor.speed_poly": [2e-4, 5.0],
    "motor.torque_poly": [3e-5, 2e-6],
    "motor.thrust_voltage_poly": [5e-5, 2e-4, 1e-4, 3e-5],
    "motor.thrust_per_speed_squared_n_s2": 2e-10,
    "motor.thrust_speed_poly": [2e-10, 0.0, 0.0],
    "dynamics.rising": [0.2, 1e-4],
    "dynamics.falling": [0.1, 5e-5],
    "drag.simple_kg_per_rad": [2e-8, 2e-8, 3e-8],
    "tf.time_constant_s": 1e-3,
}
BODY = 1e-8  # standard uncertainty of each entry of the inertia matrix


def uncertain(section: Section, std: Mapping[str, Any] = STD) -> Section:
    """Return a section whose parameters have standard uncertainties, and the inertia a covariance."""
    parameters = {
        key: replace(found, std=std.get(key, found.std)) if key in std else found
        for key, found in section.parameters.items()
    }
    inertia = "inertia.matrix_kg_m2"
    if inertia not in parameters:
        return replace(section, parameters=parameters)
    parameters[inertia] = replace(parameters[inertia], std=[[BODY] * 3] * 3)
    covariance = BODY**2 * (0.5 * np.eye(6) + 0.5 * np.ones((6, 6)))
    block = covariance_between({inertia: INERTIA_KG_M2}, covariance)
    return replace(section, parameters=parameters, covariance=block)


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    """A campaign with the thesis' numbers and with uncertainties, in the folder where `cfid` runs."""
    (tmp_path / "rig.toml").write_text(new_rig_text())
    for name, found in sections().items():
        keep(tmp_path, name, uncertain(found))
    return tmp_path


def read_csv(path: Path) -> tuple[list[str], np.ndarray[Any, np.dtype[np.float64]]]:
    head, *rows = csv.reader(line for line in path.read_text().splitlines() if not line.startswith("#"))
    return head, np.array(rows, dtype=np.float64)


def test_every_vehicle_that_is_delivered_is_possible_and_the_rejected_share_is_printed(
    cfid: Cfid, campaign: Path
) -> None:
    wide = {**STD, "motor.thrust_poly": [5e-13, 6e-7, 3e-4]}  # wide enough that a few maps fall
    keep_instead(campaign, "thrust", uncertain(sections()["thrust"], wide))
    said = cfid("export", "samples", "--n", "300", "--seed", "3")
    assert said.returncode == 0, said.stderr
    head, rows = read_csv(campaign / "exports" / "samples.csv")
    found = re.search(
        r"300 vehicles; (\d+\.\d) % of (\d+) draws rejected: motor\.thrust_poly does not rise", said.stdout
    )
    assert found is not None
    assert 0 < float(found[1]) < 50
    assert int(found[2]) % 300 == 0
    known = {key: p.value for s in sections_at(campaign).values() for key, p in s.parameters.items()}
    known = {"mass_kg": 0.028, "centre_of_mass_m": [0.0] * 3, "gravity_mps2": 9.81, **known}
    assert len(rows) == 300
    for row in rows:
        values = {
            key: shaped_as(key, [row[i] for i, name in enumerate(head) if name.split(" ")[0] == key], value)
            for key, value in known.items()
            if key != "motor.command_of_thrust" and any(name.split(" ")[0] == key for name in head)
        }
        assert impossible(values) == ""


def test_all_files_hold_the_same_vehicles_as_their_own_exports_write_them(cfid: Cfid, campaign: Path) -> None:
    said = cfid("export", "samples", "--n", "20", "--seed", "7", "--out", "drawn")
    assert said.returncode == 0, said.stderr
    folder = campaign / "drawn"
    head, rows = read_csv(folder / "samples.csv")
    with np.load(folder / "samples.npz") as file:
        packed = dict(file)
    drones = json.loads((folder / "samples_crazyflow.json").read_text())["drones"]
    names: dict[str, Any] = {}
    exec((folder / "samples_rotorpy.py").read_text(), names)

    assert packed["names"].tolist() == head
    assert np.array_equal(packed["values"], rows)
    assert packed["covariance"].shape == (len(head), len(head))
    assert (len(drones), len(names["QUADS"]), len(rows)) == (20, 20, 20)
    for row, drone, quad in zip(rows, drones, names["QUADS"], strict=True):
        number = dict(zip(head, row, strict=True))
        assert drone["mass"] == pytest.approx(number["mass_kg"])
        assert quad["mass"] == pytest.approx(number["mass_kg"])
        assert quad["k_eta"] == pytest.approx(number["motor.thrust_per_speed_squared_n_s2"])
        # The thesis' x axis points to the right, so its yy is the moment about the axis that points forward.
        assert quad["Ixx"] == drone["J"][0][0] == pytest.approx(number["inertia.matrix_kg_m2 yy"])
    assert len({drone["mass"] for drone in drones}) == 20


def test_the_centre_of_mass_and_gravity_are_drawn_too(cfid: Cfid, campaign: Path) -> None:
    rig = campaign / "rig.toml"
    text = re.sub(r"^centre_of_mass_std_mm = .*$", "", rig.read_text(), flags=re.MULTILINE)
    text = re.sub(r"^gravity_std_mps2 = .*$", "", text, flags=re.MULTILINE)
    text = re.sub(
        r"^centre_of_mass_mm = .*$", r"\g<0>\ncentre_of_mass_std_mm = [0.5, 0.4, 0.3]", text, count=1, flags=re.M
    )
    text = re.sub(r"^gravity_mps2 = .*$", r"\g<0>\ngravity_std_mps2 = 0.002", text, flags=re.M)
    rig.write_text(text)
    said = cfid("export", "samples", "--n", "400", "--seed", "3")
    assert said.returncode == 0, said.stderr

    head, rows = read_csv(campaign / "exports" / "samples.csv")
    names = [*(f"centre_of_mass_m [{i}]" for i in range(3)), "gravity_mps2"]
    spread = [rows[:, head.index(name)].std() for name in names]
    assert spread == pytest.approx([5e-4, 4e-4, 3e-4, 2e-3], rel=0.15)
    drones = json.loads((campaign / "exports" / FILES["crazyflow"]).read_text())["drones"]
    assert len({drone["mixing_matrix"][0][0] for drone in drones}) == 400
    assert not re.search(
        r"(no uncertainty|no covariance) is k\w+ of [^:]*(centre|gravity)", " ".join(said.stderr.split())
    )


def test_an_arm_of_rig_toml_is_drawn_with_its_uncertainty(cfid: Cfid, campaign: Path) -> None:
    for path in (campaign / "fits").glob("*_set.json"):
        path.unlink()
    rig = campaign / "rig.toml"
    rig.write_text(re.sub(r"^arm_std_mm = .*$", "arm_std_mm = 0.4", rig.read_text(), flags=re.MULTILINE))
    said = cfid("export", "samples", "--n", "400", "--seed", "3")
    assert said.returncode == 0, said.stderr

    head, rows = read_csv(campaign / "exports" / "samples.csv")
    arm_m = rows[:, head.index("arm_m")]
    assert arm_m.mean() == pytest.approx(0.046, abs=1e-4)
    assert arm_m.std() == pytest.approx(4e-4, rel=0.15)


def test_a_gravity_without_an_uncertainty_is_listed_as_constant(cfid: Cfid, campaign: Path) -> None:
    rig = campaign / "rig.toml"
    rig.write_text(re.sub(r"^gravity_std_mps2 = .*$", "", rig.read_text(), flags=re.MULTILINE))
    words = " ".join(cfid("export", "samples", "--n", "5").stderr.split())

    assert "no uncertainty is known of gravity_mps2: the same in every vehicle" in words


def test_a_drawn_vehicle_is_rendered_by_the_targets_themselves() -> None:
    known = vehicle()
    other = with_values(known, {"motor.thrust_poly": [3e-11, 1e-6, 0.0], "mass_kg": 0.03})

    assert with_values(known, {})["mass"] == known["mass"]
    assert tomllib.loads(crazyflow.TARGET.write(other)) != tomllib.loads(crazyflow.TARGET.write(known))
    assert "0.03," in rotorpy.TARGET.write(other)


def test_the_same_seed_draws_the_same_vehicles_and_nothing_is_overwritten(cfid: Cfid, campaign: Path) -> None:
    for seed, folder in (("1", "a"), ("1", "b"), ("2", "c")):
        assert cfid("export", "samples", "--n", "5", "--seed", seed, "--out", folder).returncode == 0
    tables = [(campaign / folder / "samples.csv").read_text() for folder in "abc"]
    assert tables[0] == tables[1]
    assert tables[0] != tables[2]

    again = cfid("export", "samples", "--n", "6", "--out", "a")
    assert again.returncode == 2
    assert "exists already" in again.stderr
    assert (campaign / "a" / "samples.csv").read_text() == tables[0]


def test_where_over_half_of_the_draws_are_no_vehicle_nothing_is_written(cfid: Cfid, campaign: Path) -> None:
    wide = {**STD, "motor.torque_poly": [0.1, 2e-6]}
    keep_instead(campaign, "torque", uncertain(sections()["torque"], wide))
    lag = replace(
        sections()["tf identify"], parameters={"tf.time_constant_s": Parameter(value=0.06, std=0.5, unit="s")}
    )
    keep_instead(campaign, "tf identify", lag)
    said = cfid("export", "samples", "--n", "50")

    words = " ".join(said.stderr.split())
    assert said.returncode == 4
    assert re.search(
        r"samples: nothing was written. \d+ % of 200 draws are no possible vehicle \(limit 50 %\): ", words
    )
    assert "motor.torque_poly does not rise (" in words
    assert "tf.time_constant_s is not above zero (" in words
    assert not (campaign / "exports").exists()


def test_measured_values_that_no_vehicle_has_are_blamed_themselves(cfid: Cfid, campaign: Path) -> None:
    body = [[16.6e-6, 0.0, 0.0], [0.0, 16.7e-6, 0.0], [0.0, 0.0, 9e-5]]
    keep_instead(campaign, "inertia", section({"inertia.matrix_kg_m2": body}))
    said = cfid("export", "samples", "--n", "5", "--force")

    words = " ".join(said.stderr.split())
    assert said.returncode == 4
    assert "values themselves belong to no possible vehicle: inertia.matrix_kg_m2 is that of no possible body" in words
    assert "uncertainties are too large" not in words


REJECTED_TORQUE = replace(
    uncertain(sections()["torque"]), accepted=False, rejected={"motor.torque_poly": "the line leaves too much."}
)


def test_what_should_not_be_exported_is_not_drawn_from_either(cfid: Cfid, campaign: Path) -> None:
    keep_instead(campaign, "torque", REJECTED_TORQUE)
    assert cfid("export", "samples", "--n", "5").returncode == 4
    assert cfid("export", "samples", "--n", "5", "--force").returncode == 0


def test_every_file_is_marked_with_what_was_simulated_or_forced(cfid: Cfid, campaign: Path) -> None:
    writer = create_run(
        campaign / "runs",
        kind="swing",
        label=Label(axis="x"),
        devices={"encoder": DeviceRecord(file="encoder.csv", columns=("t", "phi"))},
        started=datetime(2026, 11, 21, 8, 30, tzinfo=UTC),
        cfid_version="0",
        simulated=True,
    )
    writer.close("complete")
    body = uncertain(section(sections()["inertia"].parameters, run=writer.folder.name))
    keep_instead(campaign, "inertia", body)
    keep_instead(campaign, "torque", REJECTED_TORQUE)
    assert cfid("set", "rotor_radius_m", "23.1", "--force").returncode == 0
    said = cfid("export", "samples", "--n", "5", "--force")
    assert said.returncode == 0, said.stderr

    folder = campaign / "exports"
    texts = {name: (folder / name).read_text() for name in ("samples.csv", "samples_rotorpy.py", FILES["crazyflow"])}
    with np.load(folder / "samples.npz") as file:
        texts["samples.npz"] = " ".join(file["about"].tolist())
    texts["screen"] = " ".join(said.stderr.split())
    for name, text in texts.items():
        assert "SIMULATED, no vehicle was measured: inertia.matrix_kg_m2." in text, name
        assert "IMPLAUSIBLE: rotor_radius_m is implausible, 23.1 m: millimetres?" in text, name
        assert "REJECTED by its fit: motor.torque_poly." in text, name


def test_what_a_target_lacks_leaves_its_list_out_and_says_so(cfid: Cfid, tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(new_rig_text())
    said = cfid("export", "samples", "--n", "5")

    assert said.returncode == 0
    assert "no list for crazyflow, which needs" in " ".join(said.stderr.split())
    assert sorted(path.name for path in (tmp_path / "exports").iterdir()) == ["samples.csv", "samples.npz"]


def test_numbers_and_seeds_go_with_samples_alone(cfid: Cfid, campaign: Path) -> None:
    said = cfid("export", "firmware", "--n", "5")

    assert said.returncode == 2
    assert "go with `cfid export samples`" in said.stderr


def test_samples_need_a_folder(cfid: Cfid, campaign: Path) -> None:
    said = cfid("export", "samples", "--n", "5", "--out", "-")
    assert (said.returncode, "--out must name a folder" in said.stderr) == (2, True)
    assert not (campaign / "-").exists()
    (campaign / "notes").write_text("by hand")
    for force in ([], ["--force"]):
        said = cfid("export", "samples", "--n", "5", "--out", "notes", *force)
        assert (said.returncode, "name a folder with --out" in said.stderr) == (2, True)
