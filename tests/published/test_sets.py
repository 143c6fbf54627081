"""Published sets: units as printed are converted when read, formulas give what follows from them, faults are named."""

import itertools
import math
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.errors import ConfigError
from cfid.published import PublishedSet, published_set, published_sets
from cfid.quantities.registry import find
from cfid.quantities.values import evaluate, shape_error
from cfid.units import FULL_COMMAND
from tests.export import thesis_vehicle as thesis
from tests.export.test_firmware_inverse import SHIPPED
from tests.lab import ROOT

SETS = list(published_sets().values())
RPM = 2 * math.pi / 60
HEAD = """
name = "mine"
title = "Mine"
source = "a notebook, page 3"
vehicle = "a vehicle"
platform = "cf2"
method = "weighed"
frame = { forward = "x", left = "y", up = "z" }
"""


def set_of(folder: Path, *quantities: str, head: str = HEAD) -> PublishedSet:
    """Write a set's file, each quantity as the keys of its table, and read it."""
    path = folder / "mine.toml"
    path.write_text(head + "".join(f"[[quantities]]\n{text}\n" for text in quantities))
    return published_set(str(path))


# What cfid has


@pytest.mark.parametrize("published", SETS, ids=lambda published: published.name)
def test_every_set_has_registered_quantities_with_a_source(published: PublishedSet) -> None:
    assert (files("cfid.published") / f"{published.name}.toml").is_file()
    assert published.values
    for value in published.values:
        assert find(value.key) is not None
        assert shape_error(value.key, value.value, value.std) == ""
        assert published.source in published.origin(value)
        assert not value.calculated or value.remark


def test_the_thesis_is_first_and_has_the_numbers_of_its_appendix() -> None:
    first = SETS[0]
    stated = {value.key: value.value for value in reversed(first.values)}

    assert first.name == "thesis"
    assert (first.frame.forward, first.frame.left, first.frame.up) == ("y", "-x", "z")
    assert stated["mass_kg"] == thesis.MASS_KG
    assert stated["arm_m"] == thesis.ARM_M
    assert stated["inertia.matrix_kg_m2"] == thesis.INERTIA_KG_M2
    assert stated["motor.thrust_poly"] == thesis.THRUST_POLY
    assert stated["motor.speed_poly"] == thesis.SPEED_POLY
    assert stated["motor.torque_poly"] == thesis.TORQUE_POLY
    assert stated["drag.simple_kg_per_rad"] == thesis.DRAG_KG_PER_RAD
    assert stated["drag.cross_coupling_kg_per_rad"] == thesis.CROSS_KG_PER_RAD
    assert stated["tf.time_constant_s"] == thesis.TIME_CONSTANT_S


@pytest.mark.parametrize(
    ("name", "map_name"),
    [
        ("firmware", "legacy propellers, 2026.08"),
        ("firmware-21plus", "2.1+ propellers, 2026.08"),
        ("firmware-brushless", "brushless, 2026.08"),
    ],
)
def test_the_firmwares_maps_are_those_that_it_ships(name: str, map_name: str) -> None:
    cubic, (_, most_n) = SHIPPED[map_name]
    published = published_set(name)

    assert published["motor.thrust_voltage_poly"].value == list(cubic)
    assert published["motor.max_thrust_n"].value == most_n


def test_the_set_that_the_reference_shows_can_be_read(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "reference" / "exports.md").read_text()
    after = page[page.index('    name = "mine"') :].splitlines()
    block = itertools.takewhile(lambda line: not line or line.startswith("    "), after)
    (tmp_path / "shown.toml").write_text("\n".join(block))
    shown = published_set(str(tmp_path / "shown.toml"))

    assert shown["mass_kg"].value == pytest.approx(0.0295)
    same = published_set("bitcraze-2015")["motor.thrust_speed_poly"].value
    assert shown["motor.thrust_speed_poly"].value == same


# Units as printed


@pytest.mark.parametrize(
    ("key", "printed", "expected"),
    [
        ("mass_kg", 'value = 27.9\nunit = "g"', 0.0279),
        ("arm_m", 'value = 46\nunit = "mm"', 0.046),
        ("tf.time_constant_s", 'value = 65\nunit = "ms"', 0.065),
        ("motor.max_thrust_n", 'value = 58\nunit = "g of 4 motors"', 58e-3 * 9.80665 / 4),
        ("motor.thrust_per_speed_squared_n_s2", 'value = 3.16e-10\nunit = "N/rpm^2"', 3.16e-10 / RPM**2),
        ("inertia.matrix_kg_m2", 'value = [16, 17, 29]\nunit = "kg mm^2"', np.diag([16e-6, 17e-6, 29e-6])),
        ("motor.torque_poly", 'value = [7.94e-12, 0]\nunit = "N m(N)"\ndivided_by = 3.16e-10', [7.94e-2 / 3.16, 0]),
        ("motor.speed_poly", 'value = [0.2685, 4070.3]\nunit = "rpm(cmd)"', [0.2685 * RPM, 4070.3 * RPM]),
        ("motor.thrust_speed_poly", 'value = [2, 3, 4]\nunit = "N(rpm)"', [2 / RPM**2, 3 / RPM, 4]),
        ("motor.thrust_voltage_poly", 'value = [1, 2, 3]\nunit = "N(mV)"', [1, 2e3, 3e6]),  # lowest power first
    ],
)
def test_numbers_are_converted_from_the_units_that_their_source_prints(
    tmp_path: Path, key: str, printed: str, expected: Any
) -> None:
    found = set_of(tmp_path, f'key = "{key}"\n{printed}')[key].value

    np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_a_standard_uncertainty_is_converted_with_its_value(tmp_path: Path) -> None:
    mass, speed = (
        'key = "mass_kg"\nvalue = 28\nstd = 0.1\nunit = "g"',
        'key = "motor.speed_poly"\nvalue = [0.3, 4000]\nstd = [0.01, 20]\nunit = "rpm(cmd)"',
    )
    found = set_of(tmp_path, mass, speed)

    assert found["mass_kg"].std == pytest.approx(1e-4)
    assert found["motor.speed_poly"].std == pytest.approx([0.01 * RPM, 20 * RPM])


def test_points_are_rows_in_si_units() -> None:
    row = published_set("bitcraze-2015")["motor.table"].value[8]

    assert row == pytest.approx({"cmd": 32768, "thrust_n": 24.4e-3 * 9.80665 / 4, "speed_rad_s": 15924 * RPM})


# What follows from formulas


def test_two_maps_of_the_command_give_that_of_the_speed_and_k_in_hover() -> None:
    published = published_set("thesis")
    for command in (0, 20000, 65535):
        speed_rad_s = evaluate("motor.speed_poly", thesis.SPEED_POLY, command)
        thrust_n = evaluate("motor.thrust_speed_poly", published["motor.thrust_speed_poly"].value, speed_rad_s)
        assert thrust_n == pytest.approx(evaluate("motor.thrust_poly", thesis.THRUST_POLY, command), rel=1e-12)
    assert published["motor.thrust_per_speed_squared_n_s2"].value == pytest.approx(thesis.K_N_S2, rel=1e-12)


def test_k_and_the_speed_of_the_command_give_thrust() -> None:
    published = published_set("gym-pybullet-drones")
    most_n = 3.16e-10 * (0.2685 * FULL_COMMAND + 4070.3) ** 2

    assert published["motor.thrust_poly"].calculated
    assert published["motor.max_thrust_n"].value == pytest.approx(most_n, rel=1e-12)
    assert published["motor.command_of_thrust"].value[0]["thrust_max_n"] == pytest.approx(most_n, rel=1e-12)


def test_a_stated_value_counts_before_a_calculated_one(tmp_path: Path) -> None:
    thrust = 'key = "motor.thrust_poly"\nvalue = [2e-6, 0]\nunit = "N(cmd)"'
    stated = 'key = "motor.max_thrust_n"\nvalue = 0.15\nunit = "N"'

    assert set_of(tmp_path, thrust)["motor.max_thrust_n"].value == pytest.approx(2e-6 * 65535)
    assert set_of(tmp_path, thrust, stated)["motor.max_thrust_n"].value == 0.15


def test_of_two_values_the_first_counts() -> None:
    tau_s = [value.value for value in published_set("thesis").values if value.key == "tf.time_constant_s"]

    assert tau_s == pytest.approx([-0.002 / math.log(0.9695404), -0.002 / math.log(0.9745210)], rel=1e-12)
    assert published_set("thesis")["tf.time_constant_s"].value == tau_s[0]


@pytest.mark.parametrize(
    "printed",
    [
        ('key = "motor.thrust_poly"\nvalue = [-2e-6, 0.1]\nunit = "N(cmd)"',),  # falls with the command
        ('key = "motor.thrust_poly"\nvalue = [1e-15, 1e-11, 1e-6, 0]\nunit = "N(cmd)"',),  # a cubic
    ],
)
def test_a_map_without_a_rising_root_has_no_inverse(tmp_path: Path, printed: tuple[str, ...]) -> None:
    assert set_of(tmp_path, *printed).find("motor.command_of_thrust") is None


@pytest.mark.parametrize("poly", [[-1e-9, 1e-5, 0], [1e-9, 0, 1.0]])  # bends down; lifts more at rest
def test_a_map_of_speed_without_hovering_gives_no_k(tmp_path: Path, poly: list[float]) -> None:
    mass = 'key = "mass_kg"\nvalue = 0.028\nunit = "kg"'
    found = set_of(tmp_path, mass, f'key = "motor.thrust_speed_poly"\nvalue = {poly}\nunit = "N(rad/s)"')

    assert found.find("motor.thrust_per_speed_squared_n_s2") is None


# Faults


@pytest.mark.parametrize(
    ("quantity", "named"),
    [
        ('key = "mass"\nvalue = 1\nunit = "kg"', "mass"),
        ('key = "mass_kg"\nvalue = 28\nunit = "mm"', "mm"),
        ('key = "mass_kg"\nvalue = [28]\nunit = "g"', "mass_kg"),
        ('key = "mass_kg"\nvalue = "28"\nunit = "g"', "value"),
        ('key = "mass_kg"\nvalue = inf\nunit = "g"', "value"),
        ('key = "mass_kg"\nvalue = 28', "unit"),
        ('key = "mass_kg"\nvalue = 28\nunit = ["g"]', "mass_kg"),
        ('key = "mass_kg"\nvalue = 28\nstd = [1]\nunit = "g"', "std"),
        ('key = "mass_kg"\nvalue = 28\nstd = -1\nunit = "g"', "std"),
        ('key = "mass_kg"\nvalue = 28\nunit = "g"\nsource = "x"', "source"),
        ('key = "mass_kg"\nvalue = 28\nunit = "g"\ndivided_by = 0', "divided_by"),
        ('key = "motor.thrust_poly"\nvalue = [1, 2]\nunit = "N"', "N"),
        ('key = "motor.thrust_poly"\nvalue = 1\nunit = "N(cmd)"', "motor.thrust_poly"),
        ('key = "motor.thrust_speed_poly"\nvalue = [1, 2]\nunit = "N(rpm)"', "motor.thrust_speed_poly"),
        ('key = "inertia.matrix_kg_m2"\nvalue = [[1, 2], [3, 4]]\nunit = "kg m^2"', "inertia.matrix_kg_m2"),
        ('key = "motor.table"\nvalue = [[1, 2]]\ncolumns = ["cmd", "fun"]\nunit = ["cmd", "N"]', "fun"),
        ('key = "motor.table"\nvalue = [[1, 2]]\ncolumns = ["cmd", "thrust_n"]\nunit = ["cmd"]', "motor.table"),
        ('key = "motor.table"\nvalue = [[1]]\ncolumns = ["cmd", "thrust_n"]\nunit = ["cmd", "N"]', "motor.table"),
        ('key = "motor.table"\nvalue = [[1]]\ncolumns = ["thrust_n"]\nunit = ["N"]', "cmd"),
    ],
)
def test_a_quantity_that_cannot_be_read_is_named(tmp_path: Path, quantity: str, named: str) -> None:
    with pytest.raises(ConfigError, match=r"mine\.toml: ") as refused:
        set_of(tmp_path, quantity)
    assert named in str(refused.value)


def test_formulas_that_no_vehicle_has_are_refused(tmp_path: Path) -> None:
    thrust = 'key = "motor.thrust_poly"\nvalue = [2e-6, 0]\nunit = "N(cmd)"'
    speed = 'key = "motor.speed_poly"\nvalue = [0, 2000]\nunit = "rad/s(cmd)"'
    with pytest.raises(ConfigError, match="formulas"):
        set_of(tmp_path, thrust, speed)


@pytest.mark.parametrize("key", tomllib.loads(HEAD))
def test_a_set_without_a_part_of_its_head_is_refused(tmp_path: Path, key: str) -> None:
    head = "".join(line for line in HEAD.splitlines(keepends=True) if not line.startswith(key))
    with pytest.raises(ConfigError, match=key):
        set_of(tmp_path, 'key = "mass_kg"\nvalue = 28\nunit = "g"', head=head)


def test_a_left_handed_frame_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="frame"):
        set_of(tmp_path, 'key = "mass_kg"\nvalue = 28\nunit = "g"', head=HEAD.replace('"y"', '"-y"'))


@pytest.mark.parametrize("name", ["nobody", "nobody.toml", "Thesis", ""])
def test_an_unknown_set_is_refused_with_the_names_there_are(name: str) -> None:
    with pytest.raises(ConfigError) as refused:
        published_set(name)
    assert all(published.name in str(refused.value) for published in SETS)
