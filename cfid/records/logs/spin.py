"""Find which way rotors turn where a log shows it: as a Crazyflie's, front right counterclockwise, or the other way."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from cfid.records.logs.log import Array, FlightLog
from cfid.records.logs.motor_numbers import NO_SQUARE
from cfid.units import MOTORS, ROTOR_TURNS

OTHER_WAY = "rotors turn the other way than a Crazyflie's"

_MIXED = 0.7  # least size of a correlation; it is nearly one: outputs are whole numbers, and mixer limits rare
_ROWS = 100_000  # of a log that are examined


def by_moments(parameters: Mapping[str, float], numbers: Sequence[int]) -> tuple[str, ...]:
    """Return a sentence where PX4's parameters state that rotors turn the other way.

    `numbers` are the Crazyflie's numbers of PX4's motors in order. PX4 counts the moment over the thrust of a rotor
    that turns counterclockwise, seen from above, as positive.
    """
    stated = [parameters.get(f"CA_ROTOR{place}_KM", 0.0) * ROTOR_TURNS[motor] for place, motor in enumerate(numbers)]
    return (f"{OTHER_WAY}, by CA_ROTOR0_KM to CA_ROTOR3_KM",) if max(stated) < 0 else ()


def by_mixer(wanted: Array, outputs: Mapping[int, Array]) -> tuple[str, ...]:
    """Return a sentence where the torques (n,) wanted about z and the outputs show rotors that turn the other way.

    `outputs` has the outputs (n,) for each motor; rows without a number show nothing.
    """
    every = slice(None, None, max(len(wanted) // _ROWS, 1))
    # A rotor's torque on the vehicle is opposite to its own rotation.
    against = -np.sum([ROTOR_TURNS[motor] * outputs[motor][every] for motor in MOTORS], axis=0)
    known = np.isfinite(wanted[every]) & np.isfinite(against)
    wanted, against = wanted[every][known], against[known]
    if len(wanted) < 2 or min(np.std(wanted), np.std(against)) == 0:
        return ()
    alike = float(np.corrcoef(wanted, against)[0, 1])
    return (f"{OTHER_WAY}: the autopilot's mixer has them so",) if alike < -_MIXED else ()


def of_rotors(texts: Sequence[str]) -> tuple[str, ...]:
    """Return those of a log's sentences that are on its rotors; they stay with the log in any format."""
    return tuple(text for text in texts if text.startswith((NO_SQUARE, OTHER_WAY)))


def kept_texts(log: FlightLog) -> dict[str, str]:
    """Return the texts on a log's rotors that a file converted from the log keeps."""
    texts = {"notes": of_rotors(log.notes), "assumed": of_rotors(log.assumed)}
    return {f"rotors_{key}": "\n".join(each) for key, each in texts.items() if each}


def with_kept_texts(log: FlightLog, origin: Mapping[str, str]) -> FlightLog:
    """Return a log that was read from a converted file, with the texts on rotors that its `origin` keeps."""
    notes, assumed = (tuple(origin.get(f"rotors_{key}", "").splitlines()) for key in ("notes", "assumed"))
    return replace(log, notes=(*log.notes, *notes), assumed=(*log.assumed, *assumed))
