"""rig.toml: the thesis' rig is a preset, and every invalid key is refused with the names of the file and the key."""

import math
import re
import tomllib
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfid.errors import ConfigError
from cfid.recordings.wrench import turn_about_z
from cfid.records.campaign import find_campaign
from cfid.records.rig_file import (
    NONE_STATED,
    LoadCellMount,
    Mount,
    Preset,
    Rig,
    RigFacts,
    Tachometer,
    VehicleData,
    WindStand,
    change_rig,
    load_rig,
    new_rig_text,
    thesis_rig,
)
from cfid.records.run import amend_run, read_run
from cfid.units import MM
from tests.lab import Cfid, made_run, new_campaign

# The distances that the thesis' appendix C.1.7 calculates, to the micrometre.
DISTANCES_MM = {"x": 22.855, "y": 22.855, "z": 38.163, "xy": 33.784, "xz": 28.267, "yz": 28.267}


def preset(folder: Path, old: str = "", new: str = "") -> Path:
    text = new_rig_text()
    assert old in text
    path = folder / "rig.toml"
    path.write_text(text.replace(old, new, 1))
    return path


def distance_mm(vehicle: VehicleData, mount: Mount) -> float:
    direction = np.array(mount.distance_direction or mount.direction) / math.hypot(
        *(mount.distance_direction or mount.direction)
    )
    arm = MM * np.array(vehicle.centre_of_mass_mm) - np.array(mount.point_m)
    return float(np.linalg.norm(np.cross(arm, direction)) / MM)


# The preset


def test_the_preset_has_the_distances_of_the_thesis(tmp_path: Path) -> None:
    for rig in (load_rig(preset(tmp_path)), thesis_rig()):
        distances = {name: distance_mm(rig.vehicle, mount) for name, mount in rig.mounts.items()}
        assert distances == pytest.approx(DISTANCES_MM, abs=5e-4)


def test_the_preset_points_each_mount_the_way_its_cube_can_turn(tmp_path: Path) -> None:
    rig = load_rig(preset(tmp_path))
    assert {name: mount.direction for name, mount in rig.mounts.items()} == {
        "x": (1, 0, 0),
        "y": (0, 1, 0),
        "z": (0, 0, 1),
        "xy": (-1, 1, 0),
        "xz": (1, 0, 1),
        "yz": (0, 1, 1),
    }
    assert all(mount.distance_direction is None for mount in rig.mounts.values())


def test_the_thesis_rig_differs_in_the_two_directions_of_xy_and_in_the_line(tmp_path: Path) -> None:
    ours, thesis = load_rig(preset(tmp_path)), thesis_rig()
    assert thesis.mounts["xy"].direction == (1, 1, 0)
    assert thesis.mounts["xy"].distance_direction == (-1, 1, 0)
    restored = thesis.mounts["xy"].model_copy(update={"direction": (-1, 1, 0), "distance_direction": None})
    assert thesis.friction is not None
    assert thesis.friction.line_mm == 0
    mounts = thesis.mounts | {"xy": restored}
    assert thesis.model_copy(update={"mounts": mounts, "friction": ours.friction}) == ours


@given(yaw=st.floats(-720, 720), x=st.floats(-100, 100), y=st.floats(-100, 100), z=st.floats(-100, 100))
def test_a_point_turned_by_its_yaw_keeps_its_distance_from_the_z_axis(yaw: float, x: float, y: float, z: float) -> None:
    mount = Mount(point_mm=(x, y, z), point_yaw_deg=yaw, direction=(0, 0, 1))
    turned = mount.point_m
    assert math.hypot(*turned[:2]) == pytest.approx(MM * math.hypot(x, y), abs=1e-12)
    assert turned[2] == MM * z
    axes = np.array(mount.point_axes)
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.array([x, y, z]) @ axes * MM == pytest.approx(np.array(turned), abs=1e-12)


# Invalid values

FAULTS = {
    "a mass of zero": ("mass_kg = 0.0280", "mass_kg = 0", "vehicle.mass_kg: should be greater than 0, not 0."),
    "a mass that is no number": ("mass_kg = 0.0280", "mass_kg = nan", "vehicle.mass_kg: "),
    "a mass in words": ("mass_kg = 0.0280", 'mass_kg = "0.028"', "vehicle.mass_kg: "),
    "a missing mass": ("mass_kg = 0.0280", "# none", "vehicle.mass_kg is missing."),
    "a mass in grams": ("mass_kg = 0.0280", "mass_kg = 28.0", "vehicle: mass_kg is implausible, 28.0 kg: grams?"),
    "a centre in metres": ("17.425]", "0.017425]", "vehicle: centre_of_mass_mm is 0.017425 mm at most"),
    "a mount in metres": (
        "point_mm = [0.0, 32.25, 18.95]",
        "point_mm = [0.0, 0.03225, 0.01895]",
        "mounts.x.point_mm: ",
    ),
    "gravity in centimetres": ("gravity_mps2 = 9.81", "gravity_mps2 = 981", "site.gravity_mps2: "),
    "an arm in metres": ("arm_mm = 46.0", "arm_mm = 0.046", "loadcell.arm_mm = 0.046 is implausible: 30 to 70 mm"),
    "an uncertainty in metres": ("std_mm = [0.1, 0.1, 0.1]", "std_mm = [1e-4, 1e-4, 1e-4]", "std_mm.0: "),
    "a misspelt key": ("mass_kg = 0.0280", "mas_kg = 0.028", "vehicle.mas_kg: there is no such key."),
    "a negative deviation": ("mass_std_kg = 0.00003", "mass_std_kg = -1", "vehicle.mass_std_kg: "),
    "a vector of two": ("[0.0, 0.0, 17.425]", "[0.0, 17.425]", "vehicle.centre_of_mass_mm.2 is missing."),
    "a direction of zero": ("[1, 0, 0]", "[0, 0, 0]", "mounts.x.direction: "),
    "a mount that is a number": ("[mounts.x]", "[mounts]\nx = 3\n[mounts.q]", "mounts.x: should be a table, not 3."),
    "a left-handed frame": ('left = "-x"', 'left = "x"', "vehicle.body_frame: "),
    "an unknown word": ('"rls-13bit-in-22"\n', '"22 bits"\n', "encoder.counts_per_turn: "),
    "a flat box": ("[49.8, 59.75, 4.8]", "[49.8, 59.75, 0]", "testbody.cuboids.1.size_mm.2: "),
    "no number of markers": ("markers = 2", "markers = 0", "tachometer.markers: "),
    "a decimal comma": ("mass_kg = 0.0280", "mass_kg = 0,0280", "invalid TOML"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_refused_by_file_and_key_is(tmp_path: Path, fault: str) -> None:
    old, new, expected = FAULTS[fault]
    path = preset(tmp_path, old, new)
    with pytest.raises(ConfigError) as caught:
        load_rig(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert expected in str(caught.value)


@pytest.mark.parametrize("content", [b"", "name = 'Käfer'".encode("latin-1"), b"a = " + b"[" * 5000])
def test_a_file_that_is_no_rig_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "rig.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=re.escape(str(path))):
        load_rig(path)


@pytest.mark.parametrize("change", [lambda t: "\ufeff" + t, lambda t: t.replace("\n", "\r\n")], ids=["BOM", "CRLF"])
def test_a_file_from_another_editor_is_read(tmp_path: Path, change: Callable[[str], str]) -> None:
    path = tmp_path / "rig.toml"
    path.write_bytes(change(new_rig_text()).encode())
    assert load_rig(path) == load_rig(preset(tmp_path))


RIG = new_rig_text().encode()


@given(at=st.integers(0, len(RIG) - 1), junk=st.binary(max_size=3), length=st.integers(0, 30))
def test_a_rig_damaged_anywhere_is_a_rig_or_refused_with_its_name(
    tmp_path_factory: pytest.TempPathFactory, at: int, junk: bytes, length: int
) -> None:
    path = tmp_path_factory.mktemp("damaged") / "rig.toml"
    path.write_bytes(RIG[:at] + junk + RIG[at + length :])
    try:
        mass_kg = load_rig(path).vehicle.mass_kg
        message = f"{path}: "
    except ConfigError as error:
        mass_kg, message = 1.0, str(error)
    assert message.startswith(f"{path}: ")
    assert 0 < mass_kg < math.inf


# Finding the campaign


def test_a_campaign_is_found_in_the_folder_that_was_named_or_above(tmp_path: Path) -> None:
    assert find_campaign(None, start=tmp_path) is None
    preset(tmp_path)
    below = tmp_path / "runs" / "some" / "run"
    below.mkdir(parents=True)
    for found in (find_campaign(tmp_path, start=Path("/")), find_campaign(None, start=below)):
        assert found is not None
        assert found.folder == tmp_path
        assert found.runs_folder == tmp_path / "runs"
        assert found.parameters_file == tmp_path / "parameters.toml"


def test_a_folder_that_was_named_and_holds_no_rig_is_a_configuration_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"rig\.toml"):
        find_campaign(tmp_path, start=tmp_path)
    (tmp_path / "rig.toml").mkdir()
    with pytest.raises(ConfigError, match=r"rig\.toml"):
        find_campaign(tmp_path, start=tmp_path)
    assert find_campaign(None, start=tmp_path) is None


def test_a_campaign_of_the_thesis_has_the_rig_of_its_calculation(cfid: Cfid, tmp_path: Path) -> None:
    assert cfid("new", "lab", "--kind", "thesis").returncode == 0
    written, thesis = load_rig(tmp_path / "lab" / "rig.toml"), thesis_rig()

    assert (written.mounts, written.friction) == (thesis.mounts, thesis.friction)


# Numbers as people write them


def rig_of(folder: Path, text: str) -> Rig:
    (folder / "rig.toml").write_text(text)
    return load_rig(folder / "rig.toml")


def test_a_value_with_its_uncertainty_is_the_same_as_both_keys(tmp_path: Path) -> None:
    mounts = '[mounts.x]\ndirection = [1, 0, 0]\npoint_mm = "0 -32.25  18.95 +- 0.1"\n'
    people = rig_of(
        tmp_path,
        '[vehicle]\nmass_g = "28.1 ± 0.03"\ncentre_of_mass_mm = "0, -0.5, 17.425±0.1"\n'
        f'[site]\ngravity_mps2 = "9.81 +/- 0.003"\n[loadcell]\nyaw_deg = "-45 ± .5"\n{mounts}',
    )
    plain = rig_of(
        tmp_path,
        "[vehicle]\nmass_kg = 0.0281\nmass_std_kg = 0.00003\ncentre_of_mass_mm = [0, -0.5, 17.425]\n"
        "centre_of_mass_std_mm = [0.1, 0.1, 0.1]\n[site]\ngravity_mps2 = 9.81\ngravity_std_mps2 = 0.003\n"
        "[loadcell]\nyaw_deg = -45\nyaw_std_deg = 0.5\n[mounts.x]\ndirection = [1, 0, 0]\n"
        "point_mm = [0, -32.25, 18.95]\npoint_std_mm = [0.1, 0.1, 0.1]\n",
    )

    assert people == plain


@given(grams=st.decimals(20, 60, places=3))
def test_grams_become_the_kilograms_that_a_person_would_write(
    tmp_path_factory: pytest.TempPathFactory, grams: Decimal
) -> None:
    text = f"[vehicle]\nmass_g = {grams}\ncentre_of_mass_mm = [0, 0, 0]\n"
    assert rig_of(tmp_path_factory.mktemp("rig"), text).vehicle.mass_kg == float(grams / 1000)


@pytest.mark.parametrize(
    ("line", "key"),
    [
        ('mass_g = "28.0 ± ?."', "vehicle.mass_g"),
        ('mass_g = "28.0 ± 0.03 g"', "vehicle.mass_g"),
        ('mass_g = "28,0"', "vehicle.mass_g"),
        ('mass_g = "nan ± 1"', "vehicle.mass_kg"),
        ('mass_g = "28.0 ± -0.03"', "vehicle.mass_std_kg"),
        ('mass_g = "28.0 ± 0.03"\nmass_std_kg = 0.00003', "vehicle.mass_std_kg is stated twice"),
        ("mass_kg = 0.028\nmass_g = 28.0", "vehicle.mass_kg is stated twice"),
        ('mass_kg = 0.028\nname_mm = "3 ± 1"', "vehicle.name_mm: there is no such key"),
    ],
)
def test_a_number_in_another_form_is_refused_by_its_key(tmp_path: Path, line: str, key: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(key)):
        rig_of(tmp_path, f"[vehicle]\n{line}\ncentre_of_mass_mm = [0, 0, 0]\n")


@pytest.mark.parametrize("kind", ["rig", "owner"])
def test_a_new_campaign_names_each_number_that_nobody_measured(tmp_path: Path, kind: Preset) -> None:
    text = new_rig_text(kind=kind)
    with pytest.raises(ConfigError, match=r"still to measure: vehicle\.mass_g, .*mounts\.xy"):
        rig_of(tmp_path, text)
    weighed = text.replace('mass_g = "? ± 0.03"', "mass_g = 28.0").replace('mm = "?, ?, ? ± 0.1"  ', "mm = [0, 0, 9]")
    rig = rig_of(tmp_path, weighed)

    assert (rig.vehicle.mass_kg, rig.mounts, rig.friction, rig.loadcell.arm_mm) == (0.028, {}, None, None)
    assert "mounts.xy" in rig.unknown("mounts.xy")
    assert "mounts.xy" not in rig.unknown("mounts.x")
    assert "mounts.xz, mounts.yz" in rig.unknown()


def test_a_number_set_by_the_program_replaces_the_one_that_a_person_wrote(tmp_path: Path) -> None:
    rig_of(tmp_path, '[vehicle]\nmass_g = "28.1 ± 0.03"  # three times\ncentre_of_mass_mm = [0, 0, 0]\n')
    change_rig(tmp_path, "vehicle", {"mass_kg": 0.0283})
    vehicle = load_rig(tmp_path / "rig.toml").vehicle

    assert (vehicle.mass_kg, vehicle.mass_std_kg) == (0.0283, 0.00003)
    assert "# three times" in (tmp_path / "rig.toml").read_text()


# Facts of a rig that runs keep


LEAST = "[vehicle]\nmass_kg = 0.028\ncentre_of_mass_mm = [0, 0, 0]\n"
DIAGONAL = math.sqrt(0.5)


def facts_of(folder: Path, text: str) -> RigFacts:
    (folder / "rig.toml").write_text(LEAST + text)
    return load_rig(folder / "rig.toml").facts


# The frames


def test_in_the_thesis_wind_the_cells_x_axis_lies_45_degrees_left_of_the_nose() -> None:
    x, y, z = turn_about_z(np.eye(3), yaw_deg=45.0)

    assert tuple(x) == pytest.approx((DIAGONAL, DIAGONAL, 0))
    assert tuple(y) == pytest.approx((-DIAGONAL, DIAGONAL, 0))
    assert tuple(z) == (0, 0, 1)


def test_at_the_thesis_sines_motor_1_front_right_lies_on_the_cells_x_axis_and_motor_4_on_y() -> None:
    x, y, _ = turn_about_z(np.eye(3), yaw_deg=-45.0)

    assert tuple(x) == pytest.approx((DIAGONAL, -DIAGONAL, 0))
    assert tuple(y) == pytest.approx((DIAGONAL, DIAGONAL, 0))


# rig.toml


def test_the_preset_states_both_mounts_of_the_thesis(tmp_path: Path) -> None:
    new_campaign(tmp_path)
    facts = load_rig(tmp_path / "rig.toml").facts

    assert (facts.loadcell.yaw_deg, facts.yaw_in_wind_deg) == (-45.0, 45.0)
    assert facts.wind.azimuth_deg == pytest.approx(math.degrees(0.4967), abs=0.005)
    assert (facts.loadcell.arm_mm, facts.loadcell.flip_fz, facts.tachometer.markers) == (46.0, False, 2)


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("[loadcell]\nyaw_deg = nan", "loadcell.yaw_deg"),
        ("[loadcell]\nflip_fz = 1", "loadcell.flip_fz"),
        ("[tachometer]\nmarkers = 1.5", "tachometer.markers"),
        ("[wind]\nazimuth_rad = 0.4967", "wind.azimuth_rad"),
    ],
)
def test_an_invalid_fact_is_named(tmp_path: Path, text: str, key: str) -> None:
    with pytest.raises(ConfigError, match=key):
        facts_of(tmp_path, text)


# Runs


def test_a_run_keeps_the_stated_facts_through_its_end_and_later_notes(tmp_path: Path) -> None:
    stated = RigFacts(loadcell=LoadCellMount(yaw_deg=0.0, flip_fz=False), wind=WindStand(azimuth_deg=-10.5))
    run = made_run(tmp_path, "thrust", {"commands": {"t": [], "m1": []}}, facts=stated)
    amend_run(run, note="windy")

    assert read_run(run.folder).header.rig == run.header.rig == stated
    noted = tomllib.loads((run.folder / "run.toml").read_text())["rig"]
    assert noted == {"loadcell": {"yaw_deg": 0.0, "flip_fz": False}, "wind": {"azimuth_deg": -10.5}}


def test_stated_facts_replace_others_one_by_one() -> None:
    noted = RigFacts(loadcell=LoadCellMount(yaw_deg=30.0, arm_mm=46.0), tachometer=Tachometer(markers=2))
    given = RigFacts(loadcell=LoadCellMount(yaw_deg=0.0), wind=WindStand(azimuth_deg=5.0))

    assert given.over(noted) == RigFacts(
        loadcell=LoadCellMount(yaw_deg=0.0, arm_mm=46.0),
        tachometer=Tachometer(markers=2),
        wind=WindStand(azimuth_deg=5.0),
    )
    assert NONE_STATED.over(noted) == noted
