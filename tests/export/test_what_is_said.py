"""Comments of every export name origins, uncertainties, rotations, and missing or rejected values; none is guessed."""

import ast
import json
import shlex
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from cfid.errors import CfidError, ConfigError, DataError
from cfid.export.catalogue import TARGETS, target_named
from cfid.export.target import caveats, text_of
from cfid.export.vehicle import SOURCES, collect
from cfid.export.wording import HASH, XML, commented, identifier, number
from cfid.records.rig_file import load_rig, new_rig_text, thesis_rig
from tests.export import thesis_vehicle as thesis
from tests.export.reading import attributes, export, macros, python, toml, xml
from tests.export.thesis_vehicle import section, sections, vehicle, with_value
from tests.lab import ROOT, values_of

EVERY = list(TARGETS)
COMMENTED = [name for name, target in TARGETS.items() if target.comment]
TURNED = [name for name in COMMENTED if "inertia" in (*TARGETS[name].needs, *TARGETS[name].uses)]
FORMS: dict[str, Callable[[str], Any]] = {
    "h": macros,
    "toml": tomllib.loads,
    "urdf": ET.fromstring,
    "xml": ET.fromstring,
    "sdf": ET.fromstring,
    "py": ast.parse,
    "yaml": str,
    "json": json.loads,
    "proto": str,
    "22000_gz_crazyflie": lambda text: shlex.split(text, comments=True),
}


def words(text: str) -> str:
    return " ".join(text.replace("#", " ").replace("//", " ").split())


# Origins


@pytest.mark.parametrize("name", COMMENTED)
def test_every_file_says_by_which_fit_of_which_run_and_when(name: str) -> None:
    text = words(export(name, vehicle()))

    assert "mass_kg = 0.028 +- 3e-05 kg rig.toml" in text
    assert "method thesis; 2015-08-31 12:30 UTC; cfid 9.8.7; from run_1" in text or name == "crazyswarm2"


@pytest.mark.parametrize("name", TURNED)
def test_every_file_with_directions_says_how_it_was_turned_and_that_copies_of_the_thesis_were_not(name: str) -> None:
    text = words(export(name, vehicle()))

    assert "forward = y, left = -x, up = z" in text
    assert "R = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]" in text
    assert "16.57e-6 as Ixx, 16.66e-6 as Iyy) were never turned" in text
    assert "+- [[4e-08, 2e-08, 5e-08], [2e-08, 1e-08, 3e-08], [5e-08, 3e-08, 6e-08]]" in text


def test_a_frame_that_is_the_targets_own_is_said_to_need_no_turn() -> None:
    text = export("mujoco", vehicle(frame={"forward": "x", "left": "y", "up": "z"}))

    assert "so nothing was turned" in text
    assert "R = " not in text


def test_a_file_of_scalars_does_not_claim_to_have_been_turned() -> None:
    assert "nothing was turned" in export("system-id", vehicle())


@pytest.mark.parametrize("name", COMMENTED)
def test_a_file_lists_no_quantity_that_it_does_not_take(name: str) -> None:
    text = export(name, vehicle()).partition("this format has no place for")[0]

    assert "dynamics.rising" not in text or "tf.time_constant_s" not in text or name == "system-id"


@pytest.mark.parametrize("name", [name for name in EVERY if name != "firmware"])
def test_every_quantity_is_taken_or_named_as_one_that_has_no_place(name: str) -> None:
    target = TARGETS[name]
    taken = {part for need in (*target.needs, *target.uses) for part in need.replace("|", "+").split("+")}

    assert taken | set(target.no_place) == set(SOURCES)
    assert not taken & set(target.no_place)


def test_what_has_no_place_is_listed_where_it_was_measured() -> None:
    listed = words(export("rotorpy", vehicle())).partition("this format has no place for")[2]

    assert "motor.thrust_voltage_poly" in listed
    assert "rotor_inertia_kg_m2" not in listed
    assert "vehicle.json (`cfid export json`)" in listed


def test_what_diagonal_inertia_leaves_out_is_in_the_file() -> None:
    left_out = export("gym-pybullet-drones", vehicle()).partition("measured and left out:")[2]

    assert left_out.startswith(' ixy="-8.30806e-07" ixz="1.800197e-06" iyz="-7.18277e-07" kg m^2')


def test_a_file_says_what_hovering_should_take_by_both_ways_to_the_speed() -> None:
    off = with_value(vehicle(), "thrust_per_speed_squared", thesis.K_N_S2 / 1.21)
    text = words(export("rotorpy", off))

    assert "0.06867 N per motor, command 37287 of 65535" in text
    assert "rotor speed 1900.8 rad/s (18152 rpm) by motor.speed_poly" in text
    assert "rotor speed 2090.9 rad/s (19967 rpm) by motor.thrust_per_speed_squared_n_s2" in text


# Rejected values


@pytest.mark.parametrize("name", [name for name in EVERY if "inertia" in TARGETS[name].needs])
def test_what_its_fit_rejected_is_marked(name: str) -> None:
    marked = words(export(name, vehicle(rejected="inertia")))

    assert marked.count("REJECTED by") == 1
    assert marked.index("inertia.matrix_kg_m2") < marked.index("REJECTED by")
    assert "REJECTED by" not in export(name, vehicle())


def test_an_accepted_fit_goes_before_a_newer_one_that_is_not() -> None:
    old = section({"motor.thrust_per_speed_squared_n_s2": 2e-8})
    new = section({"motor.thrust_per_speed_squared_n_s2": 3e-8}, rejected="too little.")
    new = replace(new, found=new.found.replace(year=2026))
    newer = replace(new, accepted=True, rejected={})

    assert collect(thesis_rig(), values_of({"thrust": old, "speed": new}))["thrust_per_speed_squared"] == 2e-8
    assert collect(thesis_rig(), values_of({"thrust": old, "speed": newer}))["thrust_per_speed_squared"] == 3e-8


@pytest.mark.parametrize(("most", "marked"), [(45000, True), (62258, True), (62259, False), (65535, False)])
def test_a_thrust_beyond_the_measured_commands_is_marked(most: int, marked: bool) -> None:
    table = [{"cmd": 2000.0, "thrust_n": 0.01}, {"cmd": float(most), "thrust_n": 0.1}]
    thrust = section({**sections()["thrust"].parameters, "motor.table": table})
    known = collect(thesis_rig(), values_of({**sections(), "thrust": thrust}))

    text = export("firmware", known)
    assert (f"EXTRAPOLATED at the full command: {most} of 65535" in text) == marked
    assert any("EXTRAPOLATED" in said for said in caveats(TARGETS["firmware"], known)) == marked


@pytest.mark.parametrize(("most", "marked"), [(45000, True), (65535, False)])
def test_a_speed_map_of_a_log_is_marked_beyond_the_commands_of_its_rotors(most: int, marked: bool) -> None:
    lag = {"time_constant_s": 0.05, "std_s": 0.001, "delay_s": 0.0, "accepted": True}
    rotors = [
        {"rotor": 1, "cmd_from": 20000.0, "cmd_to": float(most), "rising": True, **lag},
        {"rotor": 1, "cmd_from": float(most), "cmd_to": 20000.0, "rising": False, **lag},
    ]
    dynamics = section({"motor.speed_poly": [0.02, 400.0], "dynamics.time_constant_s": rotors})
    others = {name: one for name, one in sections().items() if "motor.speed_poly" not in one.parameters}

    known = collect(thesis_rig(), values_of({**others, "dynamics": dynamics}))

    quantity = known.quantities["speed_of_command"]
    assert quantity.commands == (20000.0, float(most))
    assert (f"EXTRAPOLATED at the full command: {most} of 65535" in quantity.caveat) == marked


@pytest.mark.parametrize(("most", "marked"), [(37000, True), (37500, False)])
def test_hovering_beyond_the_measured_commands_is_marked(most: int, marked: bool) -> None:
    table = [{"cmd": 2000.0, "thrust_n": 0.01}, {"cmd": float(most), "thrust_n": 0.1}]
    thrust = section({**sections()["thrust"].parameters, "motor.table": table})
    known = collect(thesis_rig(), values_of({**sections(), "thrust": thrust}))

    sentence = f"EXTRAPOLATED: hovering's command 37287; 2000 to {most} were measured."
    assert (sentence in words(export("safe-control-gym", known))) == marked
    assert (sentence in caveats(TARGETS["safe-control-gym"], known)) == marked


@pytest.mark.parametrize("name", [name for name in EVERY if "inertia" in TARGETS[name].needs])
def test_what_was_recorded_on_a_simulated_rig_is_marked(name: str) -> None:
    of_no_vehicle = collect(thesis_rig(), values_of(sections()), simulated={"2026-11-21_083012_swing_x"})

    text = words(export(name, of_no_vehicle))
    assert "made of SIMULATED recordings" in text
    assert text.count("SIMULATED: no vehicle was measured") == 1
    assert "SIMULATED" not in export(name, vehicle())


@pytest.mark.parametrize("value", [0.0, -2e-8])
def test_a_coefficient_that_is_not_above_zero_is_refused(value: float) -> None:
    with pytest.raises(DataError, match=r"motor\.thrust_per_speed_squared_n_s2 is .* needs it above zero"):
        export("firmware", with_value(vehicle(), "thrust_per_speed_squared", value))


def test_a_delay_may_be_negative() -> None:
    delayed = sections() | {"tf identify": section({"tf.delay_s": -0.027, "tf.time_constant_s": 0.07})}

    found = json.loads(export("json", collect(thesis_rig(), values_of(delayed))))
    assert found["quantities"]["tf.delay_s"]["value"] == -0.027


@pytest.mark.parametrize(
    ("name", "quantity", "value", "said"),
    [
        ("mujoco", "torque_of_thrust", [-0.006, 1e-5], r"slope of motor\.torque_poly at hovering is -0\.006"),
        ("gazebo", "speed_of_command", [0.0, -3.0], r"motor\.speed_poly at the full command is -3"),
        ("firmware", "thrust_of_voltage", [0.1, 0.2], r"motor\.thrust_voltage_poly has 2 numbers"),
        ("system-id", "thrust_of_voltage", [0.1, 0.2], r"motor\.thrust_voltage_poly has 2 numbers"),
    ],
)
def test_a_map_that_no_target_can_mean_is_refused(name: str, quantity: str, value: list[float], said: str) -> None:
    with pytest.raises(DataError, match=said):
        export(name, with_value(vehicle(), quantity, value))


def test_a_rotor_that_runs_away_has_no_lag() -> None:
    with pytest.raises(DataError, match="make no lag at hovering"):
        export("rotorpy", with_value(vehicle(), "rising", [7.0, -0.002]))


# Missing values


@pytest.mark.parametrize(
    ("name", "need"), [(name, need) for name, target in TARGETS.items() for need in target.needs if need != "mass"]
)
def test_a_target_that_cannot_do_without_names_the_key_and_the_fit(name: str, need: str) -> None:
    keys = [key for part in need.replace("+", "|").split("|") for key in SOURCES[part].keys]

    with pytest.raises(DataError) as caught:
        export(name, vehicle(*keys))

    assert caught.value.exit_code == 4
    assert keys[0] in str(caught.value)
    assert "`cfid " in str(caught.value)


def test_a_campaign_that_measured_nothing_still_has_its_mass_and_arm_for_the_firmware() -> None:
    text = text_of(TARGETS["firmware"], collect(thesis_rig(), values_of({})))

    assert macros(text) == {"CF_MASS": 0.028, "ARM_LENGTH": 0.046}
    assert "NOT MEASURED" in text
    assert "inertia.matrix_kg_m2 (`cfid fit inertia`)" in text


def test_an_unknown_part_of_a_value_is_as_if_nothing_was_measured() -> None:
    found = {**sections(), "dynamics": section({"dynamics.rising": [7.0, 0.0], "dynamics.falling": [float("nan")] * 2})}

    assert "falling" not in collect(thesis_rig(), values_of(found))


def test_drag_that_was_not_measured_is_marked_or_left_out(tmp_path_factory: pytest.TempPathFactory) -> None:
    none = vehicle("drag.simple_kg_per_rad", "drag.cross_coupling_kg_per_rad")

    # RotorPy's controllers and the gyms' parsers fail without these values.
    assert python("rotorpy", none, tmp_path_factory.mktemp("rotorpy"))["k_d"] == 0
    assert '"k_d": 0.0,  # kg/rad: NOT MEASURED' in export("rotorpy", none)
    assert attributes(xml("gym-pybullet-drones", none).find("properties"))["drag_coeff_xy"] == 0
    assert "prop_radius, drag_coeff_xy, drag_coeff_z, dw_coeff_1" in export("gym-pybullet-drones", none)
    assert "drag_x" not in export("mujoco", none).partition("<mujoco")[2]
    assert "DRAG_B_X" not in macros(export("firmware", none))
    assert toml("crazyflow", none)["cf2x_L250"]["drag_matrix"] == [[0.0] * 3] * 3
    assert "NOT MEASURED: zero switches drag off" in export("crazyflow", none)
    # Gazebo would use its own default drag if the file had none.
    assert {e.text for e in xml("gazebo", none).iter("rotorDragCoefficient")} == {"0.0"}
    for name in ("rotorpy", "gym-pybullet-drones", "firmware", "crazyflow", "gazebo"):
        assert "drag.simple_kg_per_rad" in export(name, none).split("NOT MEASURED", 1)[1]


def test_what_nobody_measures_is_named_in_the_urdf() -> None:
    text = export("gym-pybullet-drones", vehicle())

    others = "max_speed_kmh, gnd_eff_coeff, prop_radius, dw_coeff_1, dw_coeff_2, dw_coeff_3"
    assert f"NOT MEASURED, the gym's own numbers or zero: {others}, and both cylinders" in text


def test_a_vehicle_too_heavy_to_hover_is_refused_where_hovering_matters() -> None:
    rig = thesis_rig()
    heavy = rig.model_copy(update={"vehicle": rig.vehicle.model_copy(update={"mass_kg": 0.1})})

    with pytest.raises(DataError, match=r"no command hovers 0\.1 kg"):
        text_of(TARGETS["safe-control-gym"], collect(heavy, values_of(sections())))
    assert "WARNING: no command hovers 0.1 kg" in text_of(TARGETS["mujoco"], collect(heavy, values_of(sections())))


def test_a_mass_that_nobody_changed_since_the_campaign_was_made_is_asked_about() -> None:
    rig = thesis_rig()
    weighed = rig.model_copy(update={"vehicle": rig.vehicle.model_copy(update={"mass_kg": 0.0281})})

    assert "which is the thesis' vehicle: was yours weighed?" in text_of(
        TARGETS["firmware"], collect(rig, values_of({}))
    )
    assert "was yours weighed?" not in text_of(TARGETS["firmware"], collect(weighed, values_of({})))


def test_the_arm_is_that_of_rig_toml_where_none_was_noted_by_hand() -> None:
    rig = thesis_rig()
    measured = rig.model_copy(update={"loadcell": rig.loadcell.model_copy(update={"arm_mm": 46.3})})
    of_preset, stated, noted = (
        collect(*known).quantities["arm"]
        for known in ((rig, values_of({})), (measured, values_of({})), (measured, values_of(sections())))
    )

    assert (of_preset.value, of_preset.std, of_preset.origin) == (pytest.approx(0.046), pytest.approx(2e-4), "rig.toml")
    assert "which is the thesis' vehicle: was yours measured?" in of_preset.caveat
    assert (stated.value, stated.caveat) == (pytest.approx(0.0463), "")
    assert (noted.value, noted.std) == (0.046, 1e-4)


# The body frame


def test_a_rig_that_does_not_say_where_forward_is_exports_nothing(tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("rig") / "rig.toml"
    before, _, after = new_rig_text().partition("[vehicle.body_frame]")
    path.write_text(before + after[after.index("[site]") :])

    with pytest.raises(ConfigError, match=r"vehicle\.body_frame is missing"):
        collect(load_rig(path), values_of(sections()))


# Names and forms


@pytest.mark.parametrize("name", EVERY)
def test_the_reference_tells_of_every_target_and_its_file(name: str) -> None:
    page = (ROOT / "docs" / "reference" / "exports.md").read_text()

    assert f"| `{name}` | `{TARGETS[name].file_name}` |" in page


@pytest.mark.parametrize("name", EVERY)
def test_a_vehicle_of_any_name_gives_a_file_that_is_read(name: str) -> None:
    strange = replace(vehicle(), name="my -- quad --> */ \n ]] \\")

    FORMS[TARGETS[name].file_name.rsplit(".")[-1]](export(name, strange))


def test_a_comment_never_ends_before_its_end() -> None:
    assert ET.fromstring(commented(["a --> b", "c ---- d -"], XML) + "<x/>").tag == "x"
    assert commented(["a\nb"], HASH) == "# a?b\n"


def test_numbers_have_a_point_so_that_yaml_takes_them_for_numbers() -> None:
    assert [number(x) for x in (1e-5, 5, -0.0, 1.6655602e-05, 1e20)] == [
        "1.0e-05",
        "5.0",
        "0.0",
        "1.6655602e-05",
        "1.0e+20",
    ]


def test_names_are_identifiers() -> None:
    assert [identifier(name) for name in ("Crazyflie 2.1+", "é", "a/b")] == ["Crazyflie_2_1", "vehicle", "a_b"]


def test_an_unknown_target_is_told_which_there_are() -> None:
    with pytest.raises(CfidError, match="crazyflow") as caught:
        target_named("crazyfly")
    assert caught.value.exit_code == 2
