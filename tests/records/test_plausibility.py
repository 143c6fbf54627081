"""Values impossible for a rig's platform are rejected when a result is kept; physics alone judges other bodies."""

from dataclasses import replace
from pathlib import Path

import pytest

from cfid.errors import FitError
from cfid.findings import rejection
from cfid.quantities.plausible import implausible
from cfid.records.parameters import Parameter
from cfid.records.plausibility import judged
from cfid.records.result import Result
from cfid.records.rig_file import Rig, thesis_rig
from tests.lab import new_campaign


def of(platform: str) -> Rig:
    rig = thesis_rig()
    return rig.model_copy(update={"vehicle": rig.vehicle.model_copy(update={"platform": platform})})


def result(key: str, value: object, std: object = None) -> Result:
    return Result(command="fit x", section="x", method="default", quantities={key: Parameter(value=value, std=std)})


def test_a_pendulum_of_a_kilogram_passes_as_another_body_only() -> None:
    swing = result("swing.axis_inertia_kg_m2", 0.5)
    assert judged(swing, of("other")).accepted
    assert not judged(swing, of("cf2")).accepted
    assert "kg" in judged(swing, None).rejected["swing.axis_inertia_kg_m2"]


def test_a_static_gain_over_an_arm_of_46_metres_is_never_accepted() -> None:
    found = judged(result("tf.static_gain_n", 2.4e-9, 1e-11), of("cf2"))
    assert not found.accepted
    assert found.findings[0].concerns("tf.numerator")
    assert not found.findings[0].concerns("tf.time_constant_s")
    assert judged(result("tf.static_gain_n", -2.4e-6, 1e-8), of("cf2")).accepted  # the sign is not judged here


def test_a_known_vehicle_has_narrow_ranges_that_an_uncertain_number_may_leave() -> None:
    key = "drag.simple_kg_per_rad"
    assert judged(result(key, [-9e-7, -9e-7, -1e-6], [1e-8] * 3), of("cf2")).accepted
    assert not judged(result(key, [-4.7e-7, -4.7e-7, -5e-7], [1e-8] * 3), of("cf2")).accepted
    assert judged(result(key, [-4.7e-7, -9e-7, -1e-6], [2e-7, 1e-8, 1e-8]), of("cf2")).accepted
    assert judged(result(key, [-4.7e-7, -4.7e-7, -5e-7], [1e-8] * 3), of("crazyflie")).accepted
    assert implausible("mass_kg", 0.5, platform="cf2").startswith("mass_kg is implausible")
    assert not implausible("mass_kg", 0.5)


@pytest.mark.parametrize(("largest", "kept"), [(52428.0, True), (65535.0, False)])
def test_a_map_is_judged_by_the_thrust_at_the_largest_command_that_was_measured(largest: float, *, kept: bool) -> None:
    """A motor of 8.2 N at 80 % of the command: that its map reaches 12.8 N at full command rejects no measurement."""
    table = Parameter(value=[{"cmd": 0.0}, {"cmd": largest}])
    quantities = {"motor.thrust_poly": Parameter(value=[2.93e-9, 3.03e-6, 0.0]), "motor.table": table}
    found = judged(Result(command="fit thrust", method="default", quantities=quantities), None)
    assert ("motor.thrust_poly" not in found.rejected) is kept
    assert implausible("motor.thrust_poly", [2e-12, 0, 0], measured_to=20000)  # too small is so at full command
    assert implausible("motor.max_thrust_n", 12.8, measured_to=52428)


def test_a_moment_of_the_wrong_sign_whose_cause_is_named_is_not_rejected_as_that_of_another_body() -> None:
    key = "flight.inertia_kg_m2.yaw"
    backwards = rejection("flight-wrong-way", "its rotors turn the other way.", key)
    found = judged(replace(result(key, -3e-5, 1e-6), findings=(backwards,)), of("cf2"))

    assert found.findings == (backwards,)
    assert "implausible" in judged(result(key, -3e-5, 1e-6), of("cf2")).rejected[key]


def test_physics_holds_for_another_body_too() -> None:
    matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 3.0]]
    assert "is not that of a body" in implausible("inertia.matrix_kg_m2", matrix, platform="other")
    assert implausible("gravity_mps2", 981.0, platform="other")


def test_a_campaign_keeps_what_is_implausible_by_force_alone_and_marks_it(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    most = result("motor.max_thrust_n", 15.0)
    with pytest.raises(FitError, match=r"15\.0 N: "):
        campaign.keep(most)
    assert campaign.values().sections() == {}
    campaign.keep(most, force=True)
    section = campaign.values().sections()["x"]
    assert not section.accepted
    assert "motor.max_thrust_n" in section.rejected
