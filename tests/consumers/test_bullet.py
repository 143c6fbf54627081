"""PyBullet, which both gyms use, loads their files as they do; the gyms themselves are not in the package index.

The tests copy the gyms' parser and forces from BaseAviary.py: the parser reads by position in the tree; thrust acts at
the links of the propellers, yaw torque and drag at the fifth link.
"""

import importlib.metadata
import xml.etree.ElementTree as ET
from collections.abc import Iterator
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
    RPM,
    Array,
    G,
    Row,
    accelerations,
    pairs,
    speeds,
    written,
)

STEP_S = 1 / 240


@dataclass
class Gym:
    """A vehicle in Bullet, with the numbers that the gyms' parsers read from its file."""

    bullet: Any
    path: Path

    def __post_init__(self) -> None:
        properties, base = list(ET.parse(self.path).getroot())[:2]
        self.mass = float(base[0][1].attrib["value"])
        self.diagonal = [float(base[0][2].attrib[name]) for name in ("ixx", "iyy", "izz")]
        self.hull = [float(base[2][1][0].attrib[name]) for name in ("length", "radius")]
        self.hull_z = float(base[2][0].attrib["xyz"].split(" ")[2])
        self.numbers = {name: float(value) for name, value in properties.attrib.items()}
        self.client = self.bullet.connect(self.bullet.DIRECT)
        self.reset()

    def reset(self, velocity: Any = (0, 0, 0)) -> None:
        self.bullet.resetSimulation(physicsClientId=self.client)
        self.bullet.setGravity(0, 0, -G, physicsClientId=self.client)
        self.bullet.setTimeStep(STEP_S, physicsClientId=self.client)
        flags = self.bullet.URDF_USE_INERTIA_FROM_FILE
        self.body = self.bullet.loadURDF(str(self.path), [0, 0, 1], flags=flags, physicsClientId=self.client)
        self.bullet.resetBaseVelocity(self.body, velocity, [0, 0, 0], physicsClientId=self.client)

    def force(self, link: int, force: Any) -> None:
        flags = self.bullet.LINK_FRAME
        self.bullet.applyExternalForce(self.body, link, force, [0, 0, 0], flags, physicsClientId=self.client)

    def step(self, rotor_speeds: Array, *, drag: bool = False) -> Array:
        """Return the velocities (6,) after one step of BaseAviary's physics."""
        rpm = rotor_speeds / RPM
        torques = self.numbers["km"] * rpm**2
        for link in range(4):
            self.force(link, [0, 0, self.numbers["kf"] * rpm[link] ** 2])
        yaw = -torques[0] + torques[1] - torques[2] + torques[3]
        flags = self.bullet.LINK_FRAME
        self.bullet.applyExternalTorque(self.body, 4, [0, 0, yaw], flags, physicsClientId=self.client)
        if drag:
            velocity = self.bullet.getBaseVelocity(self.body, physicsClientId=self.client)[0]
            coefficients = np.array([self.numbers[f"drag_coeff_{axis}"] for axis in ("xy", "xy", "z")])
            self.force(4, list(-coefficients * np.sum(rotor_speeds) * np.array(velocity)))
        self.bullet.stepSimulation(physicsClientId=self.client)
        return np.concatenate(self.bullet.getBaseVelocity(self.body, physicsClientId=self.client))

    def acceleration(self, rotor_speeds: Array, velocity: Any = (0, 0, 0), *, drag: bool = False) -> Array:
        self.reset(velocity)
        found: Array = (self.step(rotor_speeds, drag=drag) - np.concatenate([velocity, np.zeros(3)])) / STEP_S
        return found


@pytest.fixture(params=["gym-pybullet-drones", "safe-control-gym"])
def gym(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Gym]:
    import pybullet

    gym = Gym(pybullet, written(request.param, tmp_path, f"{request.param}.urdf"))
    yield gym
    pybullet.disconnect(gym.client)


def test_bullet_moves_the_vehicle_as_the_gyms_do(gym: Gym, judge: Judge) -> None:
    hovering = np.full(4, HOVER_RAD_S)
    rise = [gym.acceleration(share * hovering)[2] for share in (0.5, 1.5)]
    hover = HOVER_RAD_S * np.sqrt(0.25 - 2 * rise[0] / (rise[1] - rise[0]))
    braking = [
        gym.acceleration(hovering, np.eye(3)[i])[i] - gym.acceleration(hovering, np.eye(3)[i], drag=True)[i]
        for i in range(3)
    ]

    judge(
        Row(
            target=gym.path.stem,
            version=f"pybullet {importlib.metadata.version('pybullet')}",
            loaded="`loadURDF` and forces as BaseAviary.py has them; its parser read by the tests",
            hover=(HOVER_RAD_S, hover),
            hover_unit="rad/s",
            turning=pairs(
                accelerations(np.diag(np.diag(INERTIA))),
                [gym.acceleration(speeds(axis))[3 + i] for i, axis in enumerate(MIXES)],
            ),
            drag_1_s=pairs(DRAG_1_S, braking),
        )
    )


def test_the_vehicle_begins_upright_and_does_not_drift(gym: Gym) -> None:
    _, pose = gym.bullet.getBasePositionAndOrientation(gym.body, physicsClientId=gym.client)
    np.testing.assert_allclose(gym.bullet.getEulerFromQuaternion(pose), 0, atol=1e-9)

    places = np.array([gym.bullet.getLinkState(gym.body, i, physicsClientId=gym.client)[0][:2] for i in range(4)])
    shares = np.linalg.lstsq(np.vstack([np.ones(4), places.T, [-1, 1, -1, 1]]), [4, 0, 0, 0], rcond=None)[0]
    for _ in range(72):
        velocities = gym.step(HOVER_RAD_S * np.sqrt(shares))
    assert np.abs(velocities[:3]).max() < 1e-4


def test_everything_that_the_gyms_parsers_ask_for_is_there(gym: Gym) -> None:
    wanted = {
        "arm", "kf", "km", "thrust2weight", "max_speed_kmh", "gnd_eff_coeff", "prop_radius", "drag_coeff_xy",
        "drag_coeff_z", "dw_coeff_1", "dw_coeff_2", "dw_coeff_3",
    }  # fmt: skip
    if gym.path.stem == "safe-control-gym":
        wanted |= {"pwm2rpm_scale", "pwm2rpm_const", "pwm_min", "pwm_max"}

    assert wanted <= set(gym.numbers)
    assert gym.mass == MASS_KG
    assert gym.diagonal == pytest.approx(np.diag(INERTIA))
    assert gym.hull == [0.025, 0.06]
    assert gym.hull_z == 0
    names = [gym.bullet.getJointInfo(gym.body, i, physicsClientId=gym.client)[12].decode() for i in range(5)]
    assert names == ["prop0_link", "prop1_link", "prop2_link", "prop3_link", "center_of_mass_link"]
