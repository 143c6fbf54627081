"""What follows from the formulas of a published set without any further measurement.

A calculated value stands beside the stated ones only where the source states none under the same key.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.polynomial import Polynomial

from cfid.published.set_file import PublishedValue
from cfid.quantities.values import evaluate
from cfid.units import FULL_COMMAND, ROTORS, USUAL_GRAVITY_MPS2

_K, _OF_SPEED = "motor.thrust_per_speed_squared_n_s2", "motor.thrust_speed_poly"
_THRUST, _SPEED, _MOST = "motor.thrust_poly", "motor.speed_poly", "motor.max_thrust_n"


def with_calculated(stated: Sequence[PublishedValue]) -> tuple[PublishedValue, ...]:
    """Return the values of a set, followed by those that its formulas give."""
    known = list(stated)
    known += _of_poles(known)
    for calculate in (_thrust_of_command, _thrust_of_speed, _max_thrust, _inverse, _k_in_hover):
        known += calculate({value.key: value for value in reversed(known)})  # the first value of a key counts
    return tuple(known)


def _of_poles(known: Sequence[PublishedValue]) -> Iterator[PublishedValue]:
    """Yield time constant and static gain of each transfer function of first order."""
    values = {(value.key, value.variant): value for value in known}
    sample_time = values.get(("tf.sample_time_s", ""))
    for (key, variant), denominator in values.items():
        numerator = values.get(("tf.numerator", variant))
        if key != "tf.denominator" or numerator is None or len(denominator.value) != 2:
            continue
        pole = -denominator.value[1] / denominator.value[0]
        gain = sum(numerator.value) / sum(denominator.value)
        derived = {"tf.static_gain_n": gain}
        if sample_time is not None and 0 < pole < 1:
            derived["tf.time_constant_s"] = -sample_time.value / math.log(pole)
        for name, value in derived.items():
            if (name, variant) not in values:
                yield PublishedValue(name, value, None, denominator.place, denominator.remark, variant, True)


def _thrust_of_command(known: dict[str, PublishedValue]) -> Iterator[PublishedValue]:
    k, speed = known.get(_K), known.get(_SPEED)
    if k is not None and speed is not None and _THRUST not in known:
        thrust = (k.value * Polynomial(speed.value[::-1]) ** 2).coef[::-1].tolist()
        yield _calculated(_THRUST, thrust, k, speed, remark="k times the square of its speed of the command")


def _thrust_of_speed(known: dict[str, PublishedValue]) -> Iterator[PublishedValue]:
    thrust, speed = known.get(_THRUST), known.get(_SPEED)
    if thrust is None or speed is None or len(speed.value) != 2 or not {_K, _OF_SPEED}.isdisjoint(known):
        return
    slope, start = speed.value
    of_speed = Polynomial(thrust.value[::-1])(Polynomial([-start / slope, 1 / slope]))
    coefficients = np.pad(of_speed.coef, (0, 3 - len(of_speed.coef)))[::-1].tolist() if len(of_speed.coef) <= 3 else []
    if coefficients:
        remark = "its two maps of the command, one put into the other"
        yield _calculated(_OF_SPEED, coefficients, thrust, speed, remark=remark)


def _max_thrust(known: dict[str, PublishedValue]) -> Iterator[PublishedValue]:
    thrust = known.get(_THRUST)
    if thrust is not None and _MOST not in known:
        most_n = evaluate(_THRUST, thrust.value, FULL_COMMAND)
        yield _calculated(_MOST, most_n, thrust, remark="its thrust at the full command")


def _inverse(known: dict[str, PublishedValue]) -> Iterator[PublishedValue]:
    """Yield the rising root of a thrust map of order 1 or 2, from the command above which it rises."""
    thrust = known.get(_THRUST)
    if thrust is None or "motor.command_of_thrust" in known or len(thrust.value) not in (2, 3):
        return
    square = 0.0 if len(thrust.value) == 2 else thrust.value[0]
    slope, start = thrust.value[-2:]
    lowest = max(-slope / (2 * square), 0.0) if square > 0 else 0.0
    if slope + 2 * square * FULL_COMMAND <= 0 or slope + 2 * square * lowest < 0:
        return
    row = {
        "coefficients": [square, slope, start],
        "command_min": lowest,
        "command_max": float(FULL_COMMAND),
        "thrust_min_n": evaluate(_THRUST, thrust.value, lowest),
        "thrust_max_n": evaluate(_THRUST, thrust.value, FULL_COMMAND),
    }
    yield _calculated("motor.command_of_thrust", [row], thrust, remark="the inverse of its thrust of the command")


def _k_in_hover(known: dict[str, PublishedValue]) -> Iterator[PublishedValue]:
    """Yield the thrust over the squared speed where a quarter of the weight is the thrust of a speed."""
    of_speed, mass = known.get(_OF_SPEED), known.get("mass_kg")
    if of_speed is None or mass is None or _K in known:
        return
    gravity = known.get("gravity_mps2")
    share_n = mass.value * (USUAL_GRAVITY_MPS2 if gravity is None else gravity.value) / ROTORS
    square, slope, start = of_speed.value
    inside = slope**2 + 4 * square * (share_n - start)
    if square > 0 and inside > 0 and (speed_rad_s := (math.sqrt(inside) - slope) / (2 * square)) > 0:
        remark = "its thrust over the squared speed where it hovers"
        yield _calculated(_K, share_n / speed_rad_s**2, of_speed, remark=remark)


def _calculated(key: str, value: object, *of: PublishedValue, remark: str) -> PublishedValue:
    place = ", ".join(dict.fromkeys(part.place for part in of if part.place))
    return PublishedValue(key, value, None, place, remark, calculated=True)
