"""Maps of one motor's thrust, rotor speed and torque, from steady points."""

from typing import TYPE_CHECKING

from cfid.lazy import attached

if TYPE_CHECKING:
    from cfid.motors.maps.result import fit_speed as fit_speed
    from cfid.motors.maps.result import fit_thrust as fit_thrust
    from cfid.motors.maps.result import fit_torque as fit_torque

__getattr__, __dir__ = attached(__name__, dict.fromkeys(("fit_speed", "fit_thrust", "fit_torque"), "result"))
