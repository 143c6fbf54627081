"""All targets by name."""

from collections.abc import Mapping

from cfid.errors import ConfigError
from cfid.export import (
    crazyflow,
    crazyswarm2,
    exchange,
    firmware,
    gazebo,
    mujoco,
    omnidrones,
    px4,
    rotorpy,
    system_id,
    urdf,
    webots,
)
from cfid.export.target import Target

TARGETS: Mapping[str, Target] = {
    target.name: target
    for target in (
        firmware.TARGET,
        crazyflow.TARGET,
        urdf.GYM_PYBULLET_DRONES,
        urdf.SAFE_CONTROL_GYM,
        mujoco.TARGET,
        rotorpy.TARGET,
        gazebo.TARGET,
        px4.GAZEBO,
        px4.AIRFRAME,
        webots.TARGET,
        crazyswarm2.TARGET,
        omnidrones.TARGET,
        system_id.TARGET,
        exchange.TARGET,
    )
}


def target_named(name: str) -> Target:
    """Return a target.

    Raises ConfigError for an unknown name.
    """
    if name not in TARGETS:
        raise ConfigError(
            f"export {name}: no such target. There are {', '.join(TARGETS)}; `cfid export list` shows what each needs."
        )
    return TARGETS[name]
