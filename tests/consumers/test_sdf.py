"""Models of Gazebo and PX4: Drake parses them with SDFormat's own library, and provides their bodies.

Gazebo is not in the package index, so the tests calculate its motors according to MulticopterMotorModel.cc.
"""

import importlib.metadata
import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.consumers.conftest import Judge
from tests.consumers.plant import (
    DRAG_1_S,
    HOVER_RAD_S,
    INERTIA,
    MASS_KG,
    MIXES,
    MOST_RAD_S,
    PLACES,
    UP_S,
    Array,
    G,
    Row,
    accelerations,
    lag_of_first_order,
    pairs,
    speeds,
    time_to_63,
    written,
)

BODIES = {"gazebo": "crazyflie/body", "px4-gazebo": "base_link"}
TOPICS = {"gazebo": "crazyflie/gazebo/command/motor_speed", "px4-gazebo": "crazyflie/command/motor_speed"}
ORDER = {"gazebo": [0, 1, 2, 3], "px4-gazebo": [0, 2, 3, 1]}  # the motor, 0 for m1, of each command index


@dataclass
class Motor:
    """A plugin, read in the way of the motor model."""

    plugin: ET.Element

    def text(self, name: str) -> str:
        found = self.plugin.find(name)
        assert found is not None
        return found.text or ""

    def number(self, name: str) -> float:
        return float(self.text(name))

    def thrust(self, speed_rad_s: float) -> float:
        """Return the thrust in N; the simulated joint turns slower than the rotor by a factor, which is undone here."""
        slowdown = self.number("rotorVelocitySlowdownSim")
        joint_rad_s = min(speed_rad_s, self.number("maxRotVelocity")) / slowdown
        return self.number("motorConstant") * (joint_rad_s * slowdown) ** 2

    def torque(self, speed_rad_s: float) -> float:
        turning = {"ccw": 1, "cw": -1}[self.text("turningDirection")]
        return -turning * self.thrust(speed_rad_s) * self.number("momentConstant")

    def step(self, time_s: float, start: float, faster: float) -> float:
        """Return the rotor's speed at `time_s` after its command rises from `start` to `faster`."""
        return faster + (start - faster) * math.exp(-time_s / self.number("timeConstantUp"))


@pytest.fixture(params=list(BODIES))
def target(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def path(target: str, tmp_path: Path) -> Path:
    return written(target, tmp_path, "model.sdf")


def parsed(path: Path) -> tuple[Any, Any]:
    """Return Drake's plant and its context."""
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant

    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(path))
    plant.Finalize()
    return plant, plant.CreateDefaultContext()


def motors_of(path: Path) -> list[Motor]:
    """Return the motors by the index of their command."""
    found = [Motor(p) for p in ET.parse(path).iter("plugin") if "multicopter-motor" in p.attrib["filename"]]
    return sorted(found, key=lambda motor: motor.number("motorNumber"))


def test_sdformat_has_the_whole_vehicles_mass_inertia_and_motors(target: str, path: Path, judge: Judge) -> None:
    plant, context = parsed(path)
    body = plant.GetBodyByName(BODIES[target]).body_frame()
    everything = plant.GetBodyIndices(plant.GetModelInstanceByName("crazyflie"))
    spatial = plant.CalcSpatialInertia(context, body, everything)
    inertia = spatial.CalcRotationalInertia().CopyToFullMatrix3()
    motors = motors_of(path)
    places = np.array(
        [
            plant.CalcPointsPositions(context, plant.GetFrameByName(motor.text("linkName")), np.zeros((3, 1)), body)[
                :, 0
            ]
            for motor in motors
        ]
    )

    def moment(rotor_speeds: Array) -> Array:
        thrusts = [m.thrust(w) for m, w in zip(motors, rotor_speeds, strict=True)]
        found: Array = np.cross(places, np.outer(thrusts, [0, 0, 1])).sum(axis=0)
        found[2] += sum(m.torque(w) for m, w in zip(motors, rotor_speeds, strict=True))
        return found

    turning = [float(np.linalg.solve(inertia, moment(speeds(axis)[ORDER[target]]))[i]) for i, axis in enumerate(MIXES)]
    hover = math.sqrt(spatial.get_mass() * G / sum(motor.thrust(1.0) for motor in motors))
    across = 4 * HOVER_RAD_S * motors[0].number("rotorDragCoefficient") / spatial.get_mass()
    judge(
        Row(
            target=target,
            version=f"drake {importlib.metadata.version('drake')}",
            loaded="parsed by SDFormat; motors read by the tests",
            hover=(HOVER_RAD_S, hover),
            hover_unit="rad/s",
            turning=pairs(accelerations(), turning),
            lag_s=(
                lag_of_first_order(UP_S),
                time_to_63(lambda t: motors[0].thrust(motors[0].step(t, HOVER_RAD_S, 1.1 * HOVER_RAD_S))),
            ),
            drag_1_s=[(float(DRAG_1_S[0]), across)],
        )
    )
    np.testing.assert_allclose(inertia, INERTIA, rtol=1e-6)
    np.testing.assert_allclose(places[:, :2], PLACES[ORDER[target]], atol=1e-9)
    np.testing.assert_allclose(spatial.get_com(), 0, atol=1e-9)
    assert spatial.get_mass() == pytest.approx(MASS_KG, rel=1e-9)


def test_the_vehicle_begins_upright(target: str, path: Path) -> None:
    plant, context = parsed(path)
    pose = plant.GetBodyByName(BODIES[target]).EvalPoseInWorld(context)

    np.testing.assert_allclose(pose.rotation().matrix(), np.eye(3), atol=1e-12)
    assert plant.num_positions() == 7 + 4


def test_every_motor_hears_its_command_and_does_not_alias(target: str, path: Path) -> None:
    motors = motors_of(path)

    assert [motor.number("motorNumber") for motor in motors] == [0, 1, 2, 3]
    for motor in motors:
        space = motor.plugin.find("robotNamespace")
        name = "crazyflie" if space is None else space.text  # the default namespace is the model's name
        assert f"{name}/{motor.text('commandSubTopic')}" == TOPICS[target]
        joint_rad_s = MOST_RAD_S / motor.number("rotorVelocitySlowdownSim")
        assert joint_rad_s / (2 * math.pi) < 1 / (2 * 0.004)  # the motor model's own check, at PX4's time step
        assert motor.number("maxRotVelocity") == pytest.approx(MOST_RAD_S)


def test_a_rotors_angular_momentum_is_the_measured_one(path: Path) -> None:
    plant, _ = parsed(path)
    for motor in motors_of(path):
        link = plant.GetBodyByName(motor.text("linkName"))
        along = link.default_spatial_inertia().CalcRotationalInertia().get_moments()[2]
        joint_rad_s = HOVER_RAD_S / motor.number("rotorVelocitySlowdownSim")
        assert along * joint_rad_s == pytest.approx(3.0e-8 * HOVER_RAD_S)


def test_px4_finds_the_sensors_and_the_airframe_agrees_with_the_model(tmp_path: Path) -> None:
    model = ET.parse(written("px4-gazebo", tmp_path, "model.sdf"))
    script = written("px4-airframe", tmp_path, "22000_gz_crazyflie").read_text()
    words = [line.split() for line in script.splitlines() if line.startswith("param set-default ")]
    numbers = {word[2]: float(word[3]) for word in words}

    sensors = {sensor.attrib["name"] for sensor in model.iter("sensor")}
    assert sensors == {"imu_sensor", "air_pressure_sensor", "magnetometer_sensor", "navsat_sensor"}
    for i, motor in enumerate(motors_of(tmp_path / "model.sdf")):
        link = next(link for link in model.iter("link") if link.attrib["name"] == f"rotor_{i}")
        ahead, left = (float(word) for word in (link.findtext("pose") or "").split()[:2])
        assert (numbers[f"CA_ROTOR{i}_PX"], -numbers[f"CA_ROTOR{i}_PY"]) == pytest.approx((ahead, left))
        sign = {"ccw": 1, "cw": -1}[motor.text("turningDirection")]
        assert numbers[f"CA_ROTOR{i}_KM"] == pytest.approx(sign * motor.number("momentConstant"))
        most = numbers[f"SIM_GZ_EC_MAX{i + 1}"]
        assert numbers["MPC_THR_HOVER"] * motor.thrust(most) == pytest.approx(MASS_KG * G / 4, rel=1e-3)
    assert script.startswith("#!/bin/sh\n")
