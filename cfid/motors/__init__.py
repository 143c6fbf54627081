"""Motors and rotors: maps of thrust, speed and torque from staircases of commands; vibration; steps."""

from typing import TYPE_CHECKING

from cfid.lazy import attached

if TYPE_CHECKING:
    from cfid.motors import maps as maps
    from cfid.motors import rotor as rotor
    from cfid.motors import vibration as vibration
    from cfid.motors.data import reduce_run as reduce_run

__getattr__, __dir__ = attached(__name__, {"maps": "", "rotor": "", "vibration": "", "reduce_run": "data"})
