"""Judge what a flight shows of parameter sets: moments, lags and thrust where rotors moved it, not where air did."""

from dataclasses import dataclass

from cfid.findings import Finding, note, warning
from cfid.flight.estimation import EXPLAINED, FlightFit
from cfid.flight.excitation import CALM, CLEAR, LEAST_TURN_RAD_PER_S2, LOOSE, climbing, turnings
from cfid.flight.rows import AXES


@dataclass(frozen=True, kw_only=True)
class Telling:
    """The axes about which a flight shows the effect of a rotor's drive, and whether it shows it along the vertical.

    Where an autopilot only responds to air, commands counteract the air's torques: moments that are too large, and lags
    that are too long, predict such a flight better than the true ones. `reason` states the rotors' effect about other
    axes.
    """

    axes: tuple[str, ...]
    vertical: bool
    reason: str

    @property
    def findings(self) -> tuple[Finding, ...]:
        """A warning where the flight shows no moment, a note where it does not show those about some axes."""
        silent = [axis for axis in AXES if axis not in self.axes]
        if not silent:
            return ()
        if self.axes:
            text = f"this flight shows nothing of the moment about {' and '.join(silent)}: {self.reason}."
            return (note("validation-not-excited", text),)
        text = (
            f"this flight shows nothing of {'moments' if self.vertical else 'moments and lags'}: {self.reason}. What "
            "turned it is mostly something else, such as air, to which its autopilot answers, and that favours wrong "
            "sets: there are no next rates to judge them by. Validate with quick tilts to the right and left, forward "
            "and back, for 20 s."
        )
        return (warning("validation-not-excited", text),)


def telling_of(found: FlightFit | None) -> Telling:
    """Judge a flight by a fit to it, None where there is none, and by the limits of `fit flight`."""
    if found is None:
        reason = "a fit to it does not come to rest, as where air alone moves a vehicle"
        return Telling(axes=(), vertical=False, reason=reason)
    turned = turnings(found)
    each = ", ".join(
        f"about {one.name} {one.moved:.2g} rad/s^2 rms, {100 * max(one.explained, 0):.0f} % of what changed, open by "
        f"{100 * one.open:.0f} %, for 20 s by {100 * one.unclear:.0f} %"
        for one in turned
        if not one.tells
    )
    least = (
        f"at least {LEAST_TURN_RAD_PER_S2:g} rad/s^2 and {100 * EXPLAINED:.0f} %, or {100 * CALM:.0f} %, or "
        f"{100 * EXPLAINED:.0f} % and at most {100 * CLEAR:g} % for 20 s"
    )
    return Telling(
        axes=tuple(one.name for one in turned if one.tells),
        vertical=climbing(found).tells,
        reason=f"its rotors gave {each} ({least}; open by at most {100 * LOOSE:.0f} %)",
    )
