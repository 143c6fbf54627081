"""Lists how a real rig differs from the ideal one: keys of a truth file, each with the distribution between rigs.

All of them are off by default. A truth file states a rig's own values; `draw` draws the values of another rig.
"""

from collections.abc import Iterable
from typing import Literal, NamedTuple

import numpy as np

from cfid.sim.stepping import Array
from cfid.sim.truth_file import SimTruth

Distribution = Literal["normal", "around", "fixed"]


class Imperfection(NamedTuple):
    """An imperfection of the simulated rig: a key of a truth file, and how its value differs between rigs.

    `normal`: mean 0 and the standard deviation `size`, drawn separately for each number of a list. `around`: between
    0.5 and 1.5 times `size`, all equally likely. `fixed`: `size` itself, since it is the standard deviation of what
    varies within one rig, from one time to another.
    """

    key: str
    distribution: Distribution
    size: float
    unit: str
    text: str


IMPERFECTIONS = (
    Imperfection("swing.eccentricity_deg", "around", 0.3, "deg", "the encoder's ring is mounted off centre"),
    Imperfection("swing.spring_nm_per_rad", "around", 6e-5, "Nm/rad", "a cable acts as a spring, 1 % of gravity"),
    Imperfection("swing.stribeck_nm", "around", 2e-5, "Nm", "dry friction is larger at low speed"),
    Imperfection("swing.ripple_nm", "normal", 1e-5, "Nm", "dry friction varies with the angle"),
    Imperfection("swing.tilt_deg", "fixed", 1.0, "deg", "axes are mounted less exactly than rig.toml states"),
    Imperfection("vehicle.fixture_kg", "around", 1.2e-3, "kg", "the cube on the axis is neglected"),
    Imperfection("vehicle.centre_of_mass_error_mm", "normal", 0.5, "mm", "the centre of mass is known less exactly"),
    Imperfection("vehicle.mass_error_kg", "normal", 1e-4, "kg", "the mass is known less exactly"),
    Imperfection("axis.line_diameter_mm", "around", 0.2, "mm", "the line's thickness is neglected"),
    Imperfection("axis.turns_per_layer", "around", 20.0, "turns", "the line is wound in layers"),
    Imperfection("rotors.thrust_scatter", "fixed", 0.005, "relative", "thrust scatters from step to step"),
    Imperfection("rotors.speed_wander", "fixed", 0.005, "relative", "a rotor's speed wanders, correlated over 0.1 s"),
    Imperfection("rotors.slower_fall", "around", 0.5, "relative", "a rotor slows down more slowly than it speeds up"),
    Imperfection("rotors.arm_error", "normal", 0.01, "relative", "the arm is longer than stated"),
    Imperfection("rotors.tachometer_gain", "normal", 0.005, "relative", "the tachometer reads too much"),
    Imperfection("rotors.tachometer_std", "fixed", 0.005, "relative", "the tachometer's readings scatter with speed"),
    Imperfection("loadcell.gain_error", "normal", 0.01, "relative", "the load cell's axes read too much"),
    Imperfection("loadcell.crosstalk", "normal", 0.005, "of range", "the load cell's axes show each other's load"),
    Imperfection("loadcell.warm_up", "around", 0.02, "relative", "the load cell reads too little while it warms up"),
    Imperfection("loadcell.bias_wander", "fixed", 1e-4, "of range", "the load cell's bias wanders within a minute"),
    Imperfection("battery.charge", "around", 0.6, "of full", "a lithium cell sags (with battery.kind = lipo)"),
    Imperfection("radio.loss", "fixed", 0.01, "of all", "packets and reports are lost"),
    Imperfection("radio.jitter_shape", "around", 2.0, "1", "delays have no sharp lower edge"),
    Imperfection("radio.floor_wander_s", "fixed", 5e-3, "s", "the shortest delay wanders within a minute"),
    Imperfection("radio.congestion_s", "around", 0.03, "s", "packets take longer in times of congestion"),
    Imperfection("wind.anemometer_gain", "normal", 0.04, "relative", "the anemometer reads too much"),
)


def imperfection(key: str, *, size: float | None = None) -> Imperfection:
    """Return the imperfection of a key, with another size where one is given. Raises KeyError for an unknown key."""
    found = {one.key: one for one in IMPERFECTIONS}[key]
    return found if size is None else found._replace(size=size)


def draw(truth: SimTruth, imperfections: Iterable[Imperfection], *, rng: np.random.Generator) -> SimTruth:
    """Return the truth of another rig, with a value for each of the imperfections drawn from its distribution."""
    for one in imperfections:
        section, name = one.key.split(".")
        part = getattr(truth, section)
        value = _drawn(one, np.shape(getattr(part, name)), rng)
        changed = type(part).model_validate({**part.model_dump(exclude_unset=True), name: value.tolist()})
        truth = truth.model_copy(update={section: changed})
    return truth


def _drawn(one: Imperfection, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    if one.distribution == "normal":
        return np.asarray(one.size * rng.standard_normal(shape))
    return np.asarray(one.size * (rng.uniform(0.5, 1.5, shape) if one.distribution == "around" else np.ones(shape)))
