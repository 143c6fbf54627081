"""`cfid fit rotor`: how fast rotors turn, from the load cell's vibration."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.flat import flat
from cfid.console.inputs import find_recording, open_workplace
from cfid.console.lists import span
from cfid.console.options import CutOptions, Delivery, RigOptions, positive
from cfid.console.outcome import deliver

if TYPE_CHECKING:
    from cfid.motors.vibration.data import Rotors

_ROTOR = "Rotor"


@dataclass(frozen=True, kw_only=True)
class RotorOptions:
    """What vibrates."""

    rotors: Annotated[
        int | None,
        typer.Option(min=1, max=4, help="Number of rotors that ran, for files; runs state it.", rich_help_panel=_ROTOR),
    ] = None
    blades: Annotated[int, typer.Option(min=1, max=6, help="Blades per propeller.", rich_help_panel=_ROTOR)] = 2
    mains_hz: Annotated[
        float | None, typer.Option(help="Frequency of mains hum to ignore: 50 or 60 Hz.", rich_help_panel=_ROTOR)
    ] = None
    expect: Annotated[
        str | None,
        typer.Option(metavar="FROM,TO", help="Range of speeds to search, in rad/s.", rich_help_panel=_ROTOR),
    ] = None

    def rotors_known(self) -> "Rotors":
        """Return the options in the form that fits take. Raises ConfigError for an invalid range of speeds."""
        from cfid.motors.vibration.data import Rotors

        between = None
        if self.expect is not None:
            low, high = span(self.expect, "--expect", unit="rad/s", example="400,3500")
            between = positive(low, "--expect"), high
        return Rotors(number=self.rotors, blades=self.blades, mains_hz=self.mains_hz, expected_rad_per_s=between)


@flat
def rotor(
    *,
    run: Annotated[str, typer.Argument(metavar="RUN|FILE", help="A run with the load cell, or a load-cell file.")],
    options: RotorOptions,
    cut: CutOptions,
    rig: RigOptions,
    delivery: Delivery,
) -> None:
    """Estimate rotor speeds from the load cell's vibration, in each steady window or a given one.

    Example: [bold]cfid fit rotor 2026-11-21_083012_thrust[/bold]
    """
    from cfid.motors.vibration import fit
    from cfid.recordings.read import read_recording
    from cfid.recordings.wrench import LOADCELL, wrench_of

    rotors = options.rotors_known()
    workplace = open_workplace(rig)
    path = find_recording(run, workplace, lambda one: LOADCELL in one.header.devices)
    result = fit(wrench_of(read_recording(path)), rotors=rotors, from_s=cut.from_s, to_s=cut.to_s)
    deliver(replace(result, folder=workplace.figures), delivery, workplace.campaign, workplace.own_rig)
