"""Units of rotor speeds, as stands and tachometers state them: their spellings, and factors to rad/s."""

import math
import re
from collections.abc import Mapping

from cfid.units import RPM

_TURN = r"(?:1|u|umdr\.?|umdrehungen|r|revs?|revolutions?|rounds?|turns?|tr)"  # 1/min is DIN's, U/min German
_SECOND, _MINUTE = "s(?:ec(?:ond)?)?", "min(?:ute)?"

PER_MINUTE = rf"rpm|r\.p\.m\.?|upm|{_TURN}?/{_MINUTE}|{_MINUTE}\^?-1|{_TURN}\.{_MINUTE}\^?-1"

# Patterns of units as `spelt` returns them. A bare 1/s is in turns, but in radians after an angular velocity's symbol.
SPEEDS_RAD_S: Mapping[str, float] = {
    PER_MINUTE: RPM,
    "krpm": 1e3 * RPM,
    rf"rad/{_SECOND}|rad\.?s\^?-1": 1.0,
    rf"deg/{_SECOND}|°/{_SECOND}": math.radians(1),
    rf"hz|[rtu]ps|{_TURN}/{_SECOND}|s\^?-1|{_TURN}\.s\^?-1": 60 * RPM,
}
PER_SECOND = re.compile(r"[(\[](?:1/s|s\^?-1)[)\]]")
