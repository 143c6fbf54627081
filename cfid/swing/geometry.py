"""Which body swung, about what: from options, labels and rig.toml to the analysis' own types."""

from typing import TYPE_CHECKING

from cfid.console.inputs import Workplace
from cfid.console.options import positive
from cfid.errors import ConfigError
from cfid.swing.data import FIXTURE, check_mounts

if TYPE_CHECKING:
    from cfid.records.campaign import TestBody
    from cfid.swing.axis_inertias import MountedSwing, Surroundings, SwungBody

BY_HAND = "by hand"


def vehicle(workplace: Workplace, mass_kg: float | None) -> "SwungBody":
    """Return the vehicle of rig.toml, its mass overridden by --mass-kg.

    Raises ConfigError for a mass that is none.
    """
    import numpy as np

    from cfid.swing.axis_inertias import SwungBody
    from cfid.units import MM

    given = workplace.rig.vehicle
    return SwungBody(
        mass_kg=given.mass_kg if mass_kg is None else positive(mass_kg, "--mass-kg"),
        mass_std_kg=given.mass_std_kg,
        centre_m=MM * np.array(given.centre_of_mass_mm),
        centre_std_m=MM * np.array(given.centre_of_mass_std_mm),
        mounts=workplace.rig.mounts,
    )


def described_test_body(workplace: Workplace, mass_kg: float | None) -> "TestBody":
    """Return the test body of rig.toml, its mass overridden by --mass-kg.

    Raises ConfigError when rig.toml describes none.
    """
    body = workplace.rig.testbody
    if body is None:
        raise ConfigError("rig.toml describes no test body: add [testbody] with its cuboids and mounts.")
    return body if mass_kg is None else body.model_copy(update={"mass_kg": positive(mass_kg, "--mass-kg")})


def swung(body: "TestBody") -> "SwungBody":
    """Return a test body as something that swings."""
    from cfid.swing.axis_inertias import swung_test_body

    return swung_test_body(body)


def surroundings(workplace: Workplace, fixture_swing: "MountedSwing | None" = None) -> "Surroundings":
    """Return gravity and, with a swing of it, the empty fixture.

    Raises ConfigError when a fixture swung that rig.toml does not describe.
    """
    from cfid.swing.axis_inertias import Surroundings

    if fixture_swing is not None and workplace.rig.fixture is None:
        raise ConfigError("a swing of the fixture needs its mass and distance: add [fixture] to rig.toml.")
    site = workplace.rig.site
    return Surroundings(
        gravity_mps2=site.gravity_mps2,
        gravity_std_mps2=site.gravity_std_mps2,
        fixture=workplace.rig.fixture,
        fixture_swing=fixture_swing,
    )


def body_of_swing(
    workplace: Workplace,
    *,
    axis: str | None,
    body: str | None,
    mass_kg: float | None,
    distance_m: float | None,
) -> "tuple[SwungBody, str] | None":
    """Return the body that swung and its mount's name, or None where only a frequency can be told.

    Mass and distance given by hand make a mount of their own; else the axis has to be one of rig.toml.
    A rig that is not the operator's own never lends its mass.
    """
    if distance_m is not None:
        return _by_hand(mass_kg, positive(distance_m, "--distance-m"))
    if workplace.borrowed or axis is None or body == FIXTURE:
        if mass_kg is not None:
            raise ConfigError("--mass-kg alone gives no inertia: add --distance-m, or a rig.toml and --axis.")
        return None
    is_test_body = body == "testbody"
    chosen = swung(described_test_body(workplace, mass_kg)) if is_test_body else vehicle(workplace, mass_kg)
    check_mounts([axis], chosen.mounts, table="testbody.mounts" if is_test_body else "mounts")
    return chosen, axis


def _by_hand(mass_kg: float | None, distance_m: float) -> "tuple[SwungBody, str]":
    import numpy as np

    from cfid.records.campaign import Mount
    from cfid.swing.axis_inertias import SwungBody

    if mass_kg is None:
        raise ConfigError("--distance-m needs --mass-kg.")
    mount = Mount(point_mm=(0.0, 1e3 * distance_m, 0.0), direction=(1, 0, 0))
    body = SwungBody(
        mass_kg=positive(mass_kg, "--mass-kg"),
        mass_std_kg=0.0,
        centre_m=np.zeros(3),
        centre_std_m=np.zeros(3),
        mounts={BY_HAND: mount},
    )
    return body, BY_HAND
