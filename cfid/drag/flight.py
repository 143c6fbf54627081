"""What drag coefficients are for: a vehicle's velocity from its accelerometer, and its motion foretold.

Equations 4.1 to 4.4 of the thesis. They hold without wind; then the velocity relative to the air is the vehicle's own.
Coefficients are those of the simple model (3,), or a matrix (3, 3), in kg/rad, body frame.
"""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

_UP = np.array([0.0, 0.0, 1.0])


def drag_force_n(
    *, coefficients_kg_per_rad: npt.ArrayLike, velocity_mps: npt.ArrayLike, speed_sum_rad_s: npt.ArrayLike
) -> Array:
    """Return the aerodynamic force (..., 3) beyond the thrust, body frame (eq. 4.2).

    `velocity_mps` (..., 3) in the body frame, R^-1 x'; `speed_sum_rad_s` (...) of all four rotors.
    """
    felt = np.asarray(velocity_mps) @ _matrix(coefficients_kg_per_rad).T
    return np.asarray(felt * np.asarray(speed_sum_rad_s)[..., np.newaxis])


def acceleration_mps2(
    *,
    rotation: npt.ArrayLike,
    thrust_n: npt.ArrayLike,
    drag_n: npt.ArrayLike,
    mass_kg: float,
    gravity_mps2: float,
) -> Array:
    """Return the acceleration x'' (..., 3) in the inertial frame, z up (eq. 4.1).

    `rotation` (..., 3, 3) takes the body frame to the inertial one, `thrust_n` (...) is along the body's z,
    `drag_n` (..., 3) in the body frame.
    """
    force = np.asarray(thrust_n)[..., np.newaxis] * _UP + np.asarray(drag_n)
    turned = (np.asarray(rotation) @ force[..., np.newaxis])[..., 0]
    return np.asarray(turned / mass_kg - gravity_mps2 * _UP)


def drag_from_acceleration_n(*, felt_mps2: npt.ArrayLike, thrust_n: npt.ArrayLike, mass_kg: float) -> Array:
    """Return the aerodynamic force (..., 3) in the body frame (eq. 4.3).

    `felt_mps2` (..., 3) is what an accelerometer shows in the body frame, R^-1 (x'' - g): at rest, g upward.
    """
    return np.asarray(mass_kg * np.asarray(felt_mps2) - np.asarray(thrust_n)[..., np.newaxis] * _UP)


def velocity_from_acceleration_mps(
    *,
    felt_mps2: npt.ArrayLike,
    thrust_n: npt.ArrayLike,
    speed_sum_rad_s: npt.ArrayLike,
    mass_kg: float,
    coefficients_kg_per_rad: npt.ArrayLike,
) -> Array:
    """Return the vehicle's velocity (..., 3) in the body frame from its accelerometer (eq. 4.4).

    `felt_mps2` (..., 3) as in `drag_from_acceleration_n`; thrust (...) from the motor map, speed sum (...) of all
    four rotors, which must turn.
    """
    drag = drag_from_acceleration_n(felt_mps2=felt_mps2, thrust_n=thrust_n, mass_kg=mass_kg)
    along = drag / np.asarray(speed_sum_rad_s)[..., np.newaxis]
    return np.asarray(np.linalg.solve(_matrix(coefficients_kg_per_rad), along[..., np.newaxis])[..., 0])


def _matrix(coefficients_kg_per_rad: npt.ArrayLike) -> Array:
    given = np.asarray(coefficients_kg_per_rad, dtype=np.float64)
    return np.diag(given) if given.ndim == 1 else given
