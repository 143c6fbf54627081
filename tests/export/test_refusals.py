"""A target refuses what it cannot express truly; a file states at its head what is marked and what it leaves out."""

import json
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from typing import Any

import pytest

from cfid.errors import DataError
from cfid.export.render import commented, identifier, number
from cfid.export.target import caveats, need_keys, refuse
from cfid.export.vehicle import EXPORTED, ExportVehicle, collect
from cfid.records.rig_file import Rig, thesis_rig
from tests.export.reading import TARGETS, export
from tests.export.thesis_vehicle import flown_sections, section, sections, vehicle, with_value
from tests.lab import values_of

COMMENTED = [name for name, target in TARGETS.items() if target.comment]
K = "motor.thrust_per_speed_squared_n_s2"


def head(name: str, known: ExportVehicle) -> list[str]:
    """Return the comments at the head of an export, without the signs that begin them."""
    sign = TARGETS[name].comment
    lines = [line for line in export(name, known).splitlines() if not line.startswith(("<?xml", "#!", "#VRML"))]
    if sign == "<!--":
        end = next(i for i, line in enumerate(lines) if line.endswith("-->"))
        return [line.removeprefix("<!--").removesuffix("-->").strip() for line in lines[: end + 1]]
    ends = (i for i, line in enumerate(lines) if not line.startswith(f"{sign} "))
    return [line.removeprefix(sign).strip() for line in lines[: next(ends)]]


def marks(name: str, known: ExportVehicle) -> dict[str, list[str]]:
    """Return the keys of each mark of a target's quantities."""
    found: dict[str, list[str]] = {}
    for caveat, keys in caveats(TARGETS[name], known).items():
        found.setdefault(caveat.mark, []).extend(keys)
    return found


def with_table(most: int) -> ExportVehicle:
    """Return a vehicle whose thrust was measured at commands from 2000 to `most`."""
    table = [{"cmd": 2000.0, "thrust_n": 0.01}, {"cmd": float(most), "thrust_n": 0.1}]
    thrust = section({**sections()["thrust"].parameters, "motor.table": table})
    return collect(thesis_rig(), values_of({**sections(), "thrust": thrust}))


def rig_with(**vehicle: Any) -> Rig:
    rig = thesis_rig()
    return rig.model_copy(update={"vehicle": rig.vehicle.model_copy(update=vehicle)})


def test_an_unknown_part_of_a_value_is_as_if_nothing_was_measured() -> None:
    unknown = section({"dynamics.rising": [7.0, 0.0], "dynamics.falling": [float("nan")] * 2})

    assert collect(thesis_rig(), values_of(sections() | {"dynamics": unknown})).find("dynamics.falling") is None


# Values that make no sense


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("firmware", K, 0.0),
        ("firmware", K, -2e-8),
        ("mujoco", "motor.torque_poly", [-0.006, 1e-5]),
        ("gazebo", "motor.speed_poly", [0.0, -3.0]),
        ("firmware", "motor.thrust_voltage_poly", [0.1, 0.2]),
        ("system-id", "motor.thrust_voltage_poly", [0.1, 0.2]),
        ("system-id", "motor.max_thrust_n", 5.0),  # at no voltage
        ("rotorpy", "dynamics.rising", [7.0, -0.002]),  # would run away
        ("safe-control-gym", "mass_kg", 0.1),  # no command hovers it
    ],
)
def test_a_value_that_no_target_can_mean_is_refused(name: str, key: str, value: Any) -> None:
    with pytest.raises(DataError):
        export(name, with_value(vehicle(), key, value))


def test_a_delay_may_be_negative() -> None:
    delayed = sections() | {"tf identify": section({"tf.delay_s": -0.027, "tf.time_constant_s": 0.07})}

    found = json.loads(export("json", collect(thesis_rig(), values_of(delayed))))
    assert found["quantities"]["tf.delay_s"]["value"] == -0.027


def test_a_vehicle_too_heavy_to_hover_is_marked_where_hovering_does_not_matter() -> None:
    heavy = collect(rig_with(mass_kg=0.1), values_of(sections()))

    assert marks("mujoco", heavy)["NO HOVERING"] == ["motor.thrust_poly"]
    assert "NO HOVERING: motor.thrust_poly." in " ".join(head("mujoco", heavy))


# Rejected, outdated, implausible


@pytest.mark.parametrize("name", ["mujoco", "gazebo", "crazyflow"])
def test_what_its_fit_rejected_needs_force_and_is_marked(name: str) -> None:
    known, values = vehicle(rejected="inertia"), values_of({})
    with pytest.raises(DataError, match=r"inertia\.matrix_kg_m2"):
        refuse(TARGETS[name], known, values)
    refuse(TARGETS[name], known, values, force=True)
    refuse(TARGETS[name], vehicle(), values)

    assert marks(name, known)["REJECTED"] == ["inertia.matrix_kg_m2"]
    assert TARGETS[name].comment == "" or "REJECTED: inertia.matrix_kg_m2." in " ".join(head(name, known))


@pytest.mark.parametrize(
    ("rig", "key", "value"),
    [
        ({}, "inertia.matrix_kg_m2", [[0.0] * 3] * 3),
        ({"platform": "other"}, "inertia.matrix_kg_m2", [[0.0] * 3] * 3),
        ({}, "inertia.matrix_kg_m2", [[16.6e-6, 0.0, 0.0], [0.0, 16.7e-6, 0.0], [0.0, 0.0, 9e-5]]),  # no body's
        ({}, "arm_m", 46.0),
        ({"mass_kg": 28.0}, "mass_kg", None),
        ({"centre_of_mass_mm": (70.0, 0.0, 17.4)}, "centre_of_mass_m", None),
    ],
)
def test_what_is_implausible_needs_force_and_is_marked(rig: dict[str, Any], key: str, value: Any) -> None:
    kept = sections() if value is None else sections() | {"set": section({key: value})}
    known = collect(rig_with(**rig), values_of(kept))

    for name in ("firmware", "mujoco", "json"):
        with pytest.raises(DataError, match=key.removesuffix("_m")):
            refuse(TARGETS[name], known, values_of(kept))
        assert key in marks(name, known)["IMPLAUSIBLE"]


@pytest.mark.parametrize("force", [False, True])
def test_what_was_rejected_and_not_kept_is_refused_by_the_targets_that_could_use_it(force: bool) -> None:
    cubic = "motor.thrust_voltage_poly"
    whole = sections()["thrust"]
    kept = {key: parameter for key, parameter in whole.parameters.items() if key != cubic}
    values = values_of(sections() | {"thrust": replace(whole, parameters=kept, rejected={cubic: "It folds."})})
    known = collect(thesis_rig(), values)

    for name in ("firmware", "system-id"):
        with pytest.raises(DataError, match=rf"{cubic} was rejected: It folds\."):
            refuse(TARGETS[name], known, values, force=force)
    refuse(TARGETS["crazyflow"], known, values, force=force)


def test_moments_of_a_rejected_flight_stand_for_none() -> None:
    flown = flown_sections()
    rejected = replace(flown["flight"], rejected={"flight.inertia_kg_m2.yaw": "nothing turned it."})
    assert collect(thesis_rig(), values_of(flown | {"flight": rejected})).find("inertia.matrix_kg_m2") is None


# Marks


def test_what_flights_do_not_show_is_marked_as_assumed() -> None:
    known = collect(thesis_rig(), values_of(flown_sections()))
    assert marks("rotorpy", known)["ASSUMED"] == ["inertia.matrix_kg_m2", "drag.simple_kg_per_rad"]
    assert "No place in this format" in " ".join(head("gazebo", known))
    assert TARGETS["gazebo"].no_place(known)[-2:] == [
        "flight.moment_per_velocity_ns.roll",
        "flight.moment_per_velocity_ns.pitch",
    ]
    assert "rotor_inertia_kg_m2" in TARGETS["mujoco"].no_place(known)


def test_what_lies_beyond_the_measured_commands_is_marked() -> None:
    thrusts = {most: marks("firmware", with_table(most)).get("EXTRAPOLATED", []) for most in (62258, 62259)}
    hovering = {most: marks("crazyswarm2", with_table(most)).get("EXTRAPOLATED", []) for most in (37000, 37500)}

    assert {most: "motor.max_thrust_n" in keys for most, keys in thrusts.items()} == {62258: True, 62259: False}
    assert {most: "hovering" in keys for most, keys in hovering.items()} == {37000: True, 37500: False}


def test_a_speed_map_of_a_log_is_marked_beyond_the_commands_of_its_rotors() -> None:
    for most, marked in ((45000.0, True), (65535.0, False)):
        rotors = [{"rotor": 1, "cmd_from": 20000.0, "cmd_to": most, "rising": True, "time_constant_s": 0.05}]
        dynamics = section({"motor.speed_poly": [0.02, 400.0], "dynamics.time_constant_s": rotors})
        quantity = collect(thesis_rig(), values_of({"dynamics": dynamics})).quantities["motor.speed_poly"]

        assert quantity.commands == (20000.0, most)
        assert quantity.is_marked("EXTRAPOLATED") == marked


def test_the_arm_of_rig_toml_gives_way_to_one_set_by_hand() -> None:
    cell = thesis_rig().loadcell.model_copy(update={"arm_mm": 46.3})
    measured = rig_with(mass_kg=0.0281).model_copy(update={"loadcell": cell})
    stated, by_hand = (collect(measured, values_of(kept)).quantities for kept in ({}, sections()))

    assert stated["mass_kg"].caveats == stated["arm_m"].caveats == ()
    assert stated["arm_m"].value == pytest.approx(0.0463)
    assert (by_hand["arm_m"].value, by_hand["arm_m"].std) == (0.046, 1e-4)


# The head


@pytest.mark.parametrize("name", COMMENTED)
def test_a_head_names_what_the_file_leaves_out(name: str) -> None:
    known = vehicle("drag.simple_kg_per_rad", "drag.cross_coupling_kg_per_rad")
    target, text = TARGETS[name], " ".join(head(name, known))
    lacking, _, no_place = text.partition("No place in this format: ")

    expressed = {key for key in EXPORTED if key in target.keys}
    for key in (key for key in EXPORTED if known.find(key)):
        assert (key in no_place.partition(". ")[0].split(", ")) == (key not in expressed), key
    for use in target.not_measured(known):
        assert need_keys(use) in lacking.partition("NOT MEASURED: ")[2]
    assert "campaign thesis, values of 2015-08-31" in text
    assert "`cfid parameters`" in text


def test_a_head_states_axes_and_what_hovering_takes_by_both_ways_to_the_speed() -> None:
    off = with_value(vehicle(), K, vehicle().quantities[K].value / 1.21)
    text = " ".join(head("rotorpy", off))

    assert "forward y, left -x, up z" in text
    assert [float(n) for n in re.findall(r"([\d.]+) (?:N a motor|of 65535|rad/s)", text)] == [
        0.06867,
        37287,
        1900.8,
        2090.9,
    ]
    assert "forward y" not in " ".join(head("system-id", vehicle()))  # scalars have no direction


# Texts


def test_comments_numbers_and_names_are_safe() -> None:
    assert ET.fromstring(commented(["a --> b", "c ---- d -"], "<!--") + "<x/>").tag == "x"
    assert commented(["a\nb", "c \\"], "#") == "# a?b\n# c\n"
    assert [number(x) for x in (1e-5, 5, -0.0, 1.6655602e-05, 1e20)] == [
        "1.0e-05", "5.0", "0.0", "1.6655602e-05", "1.0e+20",
    ]  # fmt: skip
    assert [identifier(name) for name in ("Crazyflie 2.1+", "é", "a/b")] == ["Crazyflie_2_1", "vehicle", "a_b"]
