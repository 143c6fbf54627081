"""`cfid log thrust`: a staircase of commands on the load cell."""

from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.live import LiveLine
from cfid.console.options import flat, positive
from cfid.console.recording import KeepOptions, ResumeOptions, record, rig_of
from cfid.console.vehicle import LogMs, Motor, VehicleOptions, confirm, motors_of, reach

if TYPE_CHECKING:
    from cfid.rig.procedures import StaircasePlan

_STAIRS = "StaircasePlan"
LARGEST_COMMAND = 65535


@dataclass(frozen=True, kw_only=True)
class StairOptions:
    """The commands, and how long each is held."""

    from_: Annotated[
        int, typer.Option("--from", min=0, max=LARGEST_COMMAND, help="First command.", rich_help_panel=_STAIRS)
    ] = 0
    to: Annotated[int, typer.Option(min=0, max=LARGEST_COMMAND, help="Last command.", rich_help_panel=_STAIRS)] = 64000
    step: Annotated[
        int | None,
        typer.Option(min=1, help="Difference between commands; default: the thesis'.", rich_help_panel=_STAIRS),
    ] = None
    down: Annotated[
        bool, typer.Option("--down", help="Also go down again; separates the battery's sag.", rich_help_panel=_STAIRS)
    ] = False
    hold: Annotated[
        float | None, typer.Option(metavar="S", help="Seconds at each command.", rich_help_panel=_STAIRS)
    ] = None
    rest: Annotated[
        float | None,
        typer.Option(metavar="S", help="Seconds of pause before, between, after.", rich_help_panel=_STAIRS),
    ] = None
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print what would be done and how long it takes.", rich_help_panel=_STAIRS)
    ] = False

    def stairs(self, motors: tuple[int, ...], *, step: int, hold_s: float, rest_s: float) -> "StaircasePlan":
        """Return the staircase. Raises ConfigError for one without steps."""
        from cfid.errors import ConfigError
        from cfid.rig.procedures import StaircasePlan

        steps = tuple(range(self.from_, self.to + 1, self.step or step))
        if not steps:
            raise ConfigError(f"--from {self.from_} --to {self.to}: there is no command between them.")
        steps += steps[-2::-1] if self.down else ()
        hold_s = hold_s if self.hold is None else positive(self.hold, "--hold")
        rest_s = rest_s if self.rest is None else positive(self.rest, "--rest")
        return StaircasePlan(steps=steps, motors=motors, hold_s=hold_s, rest_s=rest_s)


Note = Annotated[str | None, typer.Option(help="A note, kept with the run.")]


@flat
def thrust(
    *,
    stairs: StairOptions,
    motor: Motor = None,
    vehicle: VehicleOptions,
    log_ms: LogMs = 10,
    resume: ResumeOptions,
    keep: KeepOptions,
    note: Note = None,
    rate_hz: Annotated[int | None, typer.Option(min=1, help="Load cell's rate; default: rig.toml's.")] = None,
) -> None:
    """Record load cell, commands and battery while the motors run a staircase; Ctrl-C stops them.

    Example: [bold]cfid log thrust --from 0 --to 64000 --step 2000 --motor 1,3[/bold]
    """
    from cfid.motors.resume import interrupted, missing
    from cfid.records.run import Label
    from cfid.rig.log import Plan, ready_loadcell
    from cfid.rig.procedures import run_staircase

    campaign, devices, simulated = rig_of(keep.campaign)
    wanted = stairs.stairs(motors_of(motor, (1, 3)), step=2000, hold_s=10.0, rest_s=3.0)
    if resume.word is not None:
        wanted = missing(interrupted(resume.word, campaign, kind="thrust"), kind="thrust")
    if stairs.dry_run:
        announce(wanted)
        return
    cell = devices.loadcell.model_copy(update={"rate_hz": rate_hz} if rate_hz else {})
    live = LiveLine()
    with ExitStack() as held:
        loadcell = ready_loadcell(cell, held, buffered=True, bias=False, say=live.say, patient=False)
        crazyflie = reach(vehicle, devices, held, simulated=simulated)
        crazyflie.limits.refuse_idling(wanted.motors)
        confirm(crazyflie, wanted.motors, wanted.steps, yes=vehicle.yes)
        plan = Plan(
            runs_folder=campaign.runs_folder,
            kind="thrust",
            label=Label(note=note),
            procedure=lambda there, loop: run_staircase(wanted, there["commands"], loop=loop, tell=live.task),
            facts=campaign.rig.facts,
            asked=wanted.asked,
            simulated=simulated,
        )
        parts = [crazyflie.commands(), loadcell, *crazyflie.watch(log_ms)]
        record("log thrust", plan, parts, live, keep)


def announce(stairs: "StaircasePlan") -> None:
    """Print what a staircase would do."""
    from cfid.rig.procedures import clock

    motors = ", ".join(map(str, stairs.motors))
    typer.echo(
        f"{len(stairs.steps)} commands from {min(stairs.steps)} to {max(stairs.steps)} on motors {motors}, "
        f"{stairs.hold_s:g} s each with {stairs.rest_s:g} s of rest: {clock(stairs.duration_s)} min"
    )
