"""`cfid export TARGET --from NAME`: the numbers of a published set, in any folder, with their source in the file."""

import json
from pathlib import Path

import numpy as np
import pytest

from cfid.export.derived import Derived
from cfid.export.vehicle import collect_published
from cfid.published import PublishedSet, published_set, published_sets
from tests.export import thesis_vehicle as thesis
from tests.export.reading import TARGETS, drone, export, macros, xml
from tests.export.test_numbers import TURNED
from tests.export.test_refusals import head
from tests.lab import ROOT, Cfid
from tests.published.test_sets import HEAD

THESIS = collect_published(published_set("thesis"))
LAG_S, MOMENT_M = thesis.TIME_CONSTANT_S, thesis.TORQUE_POLY[0]
DRAG_N_S_PER_M = [4 * thesis.HOVER_SPEED_RAD_S * drag for drag in (9.1785e-7, 9.1785e-7, 10.311e-7)]
MINE = f"""{HEAD}
[[quantities]]
key = "mass_kg"
value = 29.5
std = 0.1
unit = "g"
"""


# The thesis' numbers


def test_mujoco_has_the_thesis_numbers_turned() -> None:
    model = xml("mujoco", THESIS)
    inertial = next(model.iter("inertial")).attrib
    motors, drag = list(model.iter("general"))[:4], list(model.iter("general"))[4:]
    order = ("xx", "yy", "zz", "xy", "xz", "yz")

    assert inertial["mass"] == "0.028"
    assert dict(zip(order, map(float, inertial["fullinertia"].split()), strict=True)) == TURNED
    assert [float(motor.attrib["gear"].split()[-1]) for motor in motors] == [-MOMENT_M, MOMENT_M] * 2
    assert {motor.attrib["ctrlrange"] for motor in motors} == {"0 0.15"}  # section 3.3.1
    assert [float(motor.attrib["dynprm"]) for motor in motors] == pytest.approx([LAG_S] * 4, rel=1e-9)
    assert [-float(e.attrib["biasprm"].split()[-1]) for e in drag] == pytest.approx(DRAG_N_S_PER_M, rel=1e-9)
    assert [float(word) for word in next(model.iter("geom")).attrib["size"].split()] == [0.0, 0.0, 0.05]


def test_gazebo_has_the_thesis_numbers() -> None:
    plugins = [e for e in xml("gazebo", THESIS).iter("plugin") if e.find("motorNumber") is not None]
    full_rad_s = thesis.SPEED_POLY[0] * 65535 + thesis.SPEED_POLY[1]
    expected = {
        "motorConstant": thesis.K_N_S2, "momentConstant": MOMENT_M, "rotorDragCoefficient": 9.1785e-7,
        "timeConstantUp": LAG_S, "timeConstantDown": LAG_S, "maxRotVelocity": full_rad_s,
    }  # fmt: skip

    assert len(plugins) == 4
    for plugin in plugins:
        assert {key: float(plugin.findtext(key, "nan")) for key in expected} == pytest.approx(expected, rel=1e-9)


def test_the_firmwares_header_has_the_thesis_numbers() -> None:
    found = macros(export("firmware", THESIS))

    assert (found["CF_MASS"], found["ARM_LENGTH"], found["THRUST2TORQUE"]) == (0.028, 0.046, 0.005964552)
    assert {name: found[f"CFID_INERTIA_{name.upper()}"] for name in TURNED} == TURNED
    assert [found[f"DRAG_B_{axis}"] for axis in "XYZ"] == pytest.approx(np.divide(DRAG_N_S_PER_M, 0.028), rel=1e-9)
    assert "VMOTOR2THRUST0" not in found  # the thesis measured no voltage


def test_a_set_and_a_campaign_of_the_same_numbers_are_one_vehicle() -> None:
    published, campaign = Derived(THESIS), Derived(thesis.vehicle("dynamics.rising", "dynamics.falling"))

    assert published.inertia_kg_m2 == campaign.inertia_kg_m2
    assert published.motors == campaign.motors
    assert published.hover_command == campaign.hover_command
    assert published.hover_speed_rad_s == pytest.approx(campaign.hover_speed_rad_s, rel=1e-12)
    assert published.lags_s == campaign.lags_s
    assert published.drag_n_s_per_m == pytest.approx(campaign.drag_n_s_per_m, rel=1e-12)


def test_the_firmwares_own_numbers_go_round() -> None:
    found = macros(export("firmware", collect_published(published_set("firmware"))))

    assert (found["CF_MASS"], found["THRUST_MAX"]) == (0.029, 0.12)
    assert found["THRUST2TORQUE"] == pytest.approx(0.007350862856566459, rel=1e-9)
    assert found["THRUST_MIN"] == pytest.approx(0.012817578393224994, rel=1e-9)  # as it ships it
    assert found["VMOTOR2THRUST3"] == pytest.approx(0.005960923942142, rel=1e-9)


# What a file states


@pytest.mark.parametrize("published", published_sets().values(), ids=lambda published: published.name)
def test_a_head_states_the_set_its_source_and_that_nothing_was_measured(published: PublishedSet) -> None:
    vehicle = collect_published(published)
    for name in (name for name, target in TARGETS.items() if target.comment and not target.missing(vehicle)):
        lines = head(name, vehicle)
        text = " ".join(lines)
        assert len(lines) <= 12
        assert f"published set {published.name}" in text
        assert "Nothing was measured here, and the source states no uncertainties" in text
        assert published.source[:40] in text
        assert "NOT MEASURED" not in text
        assert "campaign" not in text
        assert "centre_of_mass_m" in text.partition("ASSUMED: ")[2].partition(".")[0]


def test_what_is_calculated_or_contradicts_itself_is_marked() -> None:
    quantities = THESIS.quantities

    assert quantities["motor.thrust_per_speed_squared_n_s2"].is_marked("CALCULATED")
    assert quantities["inertia.matrix_kg_m2"].is_marked("REMARK")
    assert quantities["mass_kg"].caveats == quantities["gravity_mps2"].caveats == ()
    assert "eq. 2.18" in quantities["inertia.matrix_kg_m2"].origin


# On the command line


def test_a_set_is_exported_to_the_current_folder_without_a_campaign(cfid: Cfid, tmp_path: Path) -> None:
    ended = cfid("export", "mujoco", "--from", "thesis")

    assert (ended.returncode, ended.stdout.strip()) == (0, "crazyflie_mujoco.xml")
    assert [path.name for path in tmp_path.iterdir()] == ["crazyflie_mujoco.xml"]
    assert cfid("export", "mujoco", "--from", "thesis").returncode == 0  # the same again
    (tmp_path / "crazyflie_mujoco.xml").write_text("mine")
    assert cfid("export", "mujoco", "--from", "thesis").returncode == 2
    assert cfid("export", "mujoco", "--from", "thesis", "--force").returncode == 0
    assert cfid("export", "crazyflow", "--from", "thesis", "--out", "a/b.py").returncode == 0
    assert drone(THESIS)["mass"] == 0.028
    assert '"mass": 0.028,' in (tmp_path / "a" / "b.py").read_text()


def test_what_a_set_lacks_is_refused_by_its_keys(cfid: Cfid, tmp_path: Path) -> None:
    ended = cfid("export", "mujoco", "--from", "landry")

    assert (ended.returncode, ended.stdout, list(tmp_path.iterdir())) == (4, "", [])
    assert "mass_kg; arm_m; motor.torque_poly; motor.max_thrust_n" in ended.stderr
    assert "cfid fit" not in ended.stderr


def test_a_list_shows_which_targets_a_set_fills(cfid: Cfid) -> None:
    of_thesis, of_firmware = (
        json.loads(cfid("export", "list", "--from", name, "--json").stdout)["targets"]
        for name in ("thesis", "firmware")
    )

    assert [row["target"] for row in of_thesis if not row["ready"]] == ["system-id"]  # no thrust over voltage
    ready = [row["target"] for row in of_firmware if row["ready"]]
    assert ready == ["crazyswarm2", "firmware", "json", "mujoco", "pyflyt-urdf", "system-id"]
    text = cfid("export", "list", "--from", "thesis").stdout
    assert "MISSING: motor.thrust_voltage_poly\n" in text


def test_json_has_the_source_of_each_number_and_no_uncertainty(cfid: Cfid) -> None:
    found = json.loads(cfid("export", "json", "--from", "thesis", "--out", "-").stdout)
    mass = found["quantities"]["mass_kg"]

    assert (mass["value"], mass["std"], found["name"]) == (0.028, None, "Crazyflie 2.0")
    assert "published set thesis: J. Förster" in mass["origin"]
    assert found["frames"]["campaign"] == {"forward": "y", "left": "-x", "up": "z"}


def test_a_file_of_ones_own_is_taken_with_its_uncertainties(cfid: Cfid, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(MINE)
    text = cfid("export", "firmware", "--from", "mine.toml", "--out", "-").stdout
    mass = json.loads(cfid("export", "json", "--from", "mine.toml", "--out", "-").stdout)["quantities"]["mass_kg"]

    assert macros(text) == {"CF_MASS": 0.0295}
    assert "the source states uncertainties of mass_kg alone: a notebook, page 3." in text
    assert (mass["value"], mass["std"]) == pytest.approx((0.0295, 1e-4))


def test_an_implausible_number_of_a_file_needs_force_and_is_marked(cfid: Cfid, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(MINE.replace('"g"', '"kg"'))
    assert cfid("export", "firmware", "--from", "mine.toml", "--out", "-").returncode == 4

    text = cfid("export", "firmware", "--from", "mine.toml", "--out", "-", "--force").stdout
    assert "IMPLAUSIBLE: mass_kg." in text


@pytest.mark.parametrize(
    "words",
    [
        ("mujoco", "--from", "nobody"),
        ("mujoco", "--from", "nobody.toml"),
        ("list", "--from", "broken.toml"),
        ("samples", "--from", "thesis"),
        ("nothing", "--from", "thesis"),
        ("mujoco", "--from", "thesis", "--n", "5"),
    ],
)
def test_wrong_words_are_usage_errors_and_write_nothing(cfid: Cfid, tmp_path: Path, words: tuple[str, ...]) -> None:
    (tmp_path / "broken.toml").write_text(MINE.replace("value = 29.5", "valu = 29.5"))
    ended = cfid("export", *words)

    assert (ended.returncode, ended.stdout) == (2, "")
    assert [path.name for path in tmp_path.iterdir()] == ["broken.toml"]


def test_the_reference_names_every_set() -> None:
    page = (ROOT / "docs" / "reference" / "exports.md").read_text()

    assert all(f"`{name}`" in page for name in published_sets())
