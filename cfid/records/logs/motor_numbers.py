"""Give motors of other autopilots the Crazyflie's numbers: 1 front right, 2 rear right, 3 rear left, 4 front left.

Also report rotors that do not form a square, which the moments of a flight rest on.
"""

from collections.abc import Mapping, Sequence

from cfid.units import MOTORS

PX4_QUAD_X = (1, 3, 4, 2)  # the Crazyflie's numbers of PX4's motors in order: front right, rear left, front left, ...
BETAFLIGHT_QUAD_X = (2, 1, 3, 4)  # rear right, front right, rear left, front left

NO_SQUARE = "the rotors do not stand on a square"

_OFF_SQUARE = 0.01  # relative to the lever: airframe files round places by as much
_PLACES = {(True, True): 1, (False, True): 2, (False, False): 3, (True, False): 4}  # forward, right


def by_geometry(parameters: Mapping[str, float]) -> tuple[int, ...] | None:
    """Return the Crazyflie's numbers of PX4's motors in order, from its rotor positions; None where these show none."""
    at = _places_m(parameters)
    if any(0.0 in place for place in at) or parameters.get("CA_ROTOR_COUNT", len(MOTORS)) != len(MOTORS):
        return None
    found = tuple(_PLACES[forward > 0, right > 0] for forward, right in at)
    return found if set(found) == set(MOTORS) else None


def off_square(parameters: Mapping[str, float], driven: int) -> tuple[str, ...]:
    """Return a sentence on PX4's rotors where they are known not to be at the corners of a square.

    `driven` is the number of motors with commands; motors beyond four count only with commands other than 0. It is 0
    where no commands are logged.
    """
    stated = int(parameters.get("CA_ROTOR_COUNT", driven))
    if others := not_four(max(stated, driven), "control"):
        return others
    if by_geometry(parameters) is None:
        return ()
    levers = [abs(one) for place in _places_m(parameters) for one in place]
    mean = sum(levers) / len(levers)
    if max(abs(one - mean) for one in levers) <= _OFF_SQUARE * mean:
        return ()
    places = "; ".join(f"{1e3 * forward:g}, {1e3 * right:g}" for forward, right in _places_m(parameters))
    return (f"{NO_SQUARE}: CA_ROTOR0 to 3 are {places} mm forward and right.",)


def not_four(count: int, own: str) -> tuple[str, ...]:
    """Return a sentence on motors where there are not four; `own` is the name of their commands, numbered from 0."""
    if count in (0, len(MOTORS)):
        return ()
    return (f"{NO_SQUARE}: there are {count}, of which {own}[0] to [3] alone are read as motors m1 to m4.",)


def _places_m(parameters: Mapping[str, float]) -> list[tuple[float, float]]:
    """Return PX4's rotor positions forward and right, 0 for an unknown one."""
    return [
        (parameters.get(f"CA_ROTOR{i}_PX", 0.0), parameters.get(f"CA_ROTOR{i}_PY", 0.0)) for i in range(len(MOTORS))
    ]


def numbering(numbers: Sequence[int], own: str, *, why: str) -> str:
    """Return the sentence that states which motor is which; `own` is the log's name for one, as in `motor[{}]`."""
    named = ", ".join(own.format(numbers.index(motor)) for motor in MOTORS)
    return f"motors have the Crazyflie's numbers: control.m1 to m4 are {named}, {why}"
