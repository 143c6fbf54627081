"""Motors of other autopilots by the Crazyflie's numbers: 1 front right, 2 rear right, 3 rear left, 4 front left."""

from collections.abc import Mapping, Sequence

from cfid.units import MOTORS

PX4_QUAD_X = (1, 3, 4, 2)  # the Crazyflie's numbers of its motors in order: front right, rear left, front left, ...
BETAFLIGHT_QUAD_X = (2, 1, 3, 4)  # rear right, front right, rear left, front left

_PLACES = {(True, True): 1, (False, True): 2, (False, False): 3, (True, False): 4}  # forward, right


def by_geometry(parameters: Mapping[str, float]) -> tuple[int, ...] | None:
    """Return the Crazyflie's numbers of PX4's motors in order by its rotor positions, None where these state none."""
    at = [(parameters.get(f"CA_ROTOR{i}_PX", 0.0), parameters.get(f"CA_ROTOR{i}_PY", 0.0)) for i in range(len(MOTORS))]
    if any(0.0 in place for place in at) or parameters.get("CA_ROTOR_COUNT", len(MOTORS)) != len(MOTORS):
        return None
    found = tuple(_PLACES[forward > 0, right > 0] for forward, right in at)
    return found if set(found) == set(MOTORS) else None


def numbering(numbers: Sequence[int], own: str, *, why: str) -> str:
    """Return the sentence that states which motor is which; `own` is the name of one, as `motor[{}]`."""
    named = ", ".join(own.format(numbers.index(motor)) for motor in MOTORS)
    return f"motors have the Crazyflie's numbers: control.m1 to m4 are {named}, {why}"
