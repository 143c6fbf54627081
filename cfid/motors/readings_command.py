"""`cfid log speed` and `cfid log scales`: a staircase with the readings of a tachometer, or of scales."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cfid.console.live import LiveLine
from cfid.console.options import flat
from cfid.console.recording import KeepOptions, ResumeOptions, record, rig_of
from cfid.console.vehicle import LogMs, Motor, VehicleOptions, confirm, motors_of, reach
from cfid.motors.command import Note, StairOptions, announce

if TYPE_CHECKING:
    from cfid.rig.log import Device
    from cfid.rig.loop import Loop
    from cfid.rig.procedures import StaircasePlan
    from cfid.rig.ready_vehicle import ReadyVehicle

_INSTRUMENT = "Instrument"

_SPEED_STEP, _SPEED_HOLD_S, _SPEED_REST_S = 2000, 6.0, 2.0  # a tachometer's display takes seconds to settle
_SCALES_STEP, _SCALES_HOLD_S, _SCALES_REST_S = 4000, 5.0, 3.0  # as in figure 3.9


@flat
def speed(
    *,
    stairs: StairOptions,
    tachometer: Annotated[
        Literal["typed", "ut372", "deck", "brushless"],
        typer.Option(
            help="Source of the speed: typed by you, a UT372, the RPM deck, brushless motors.",
            rich_help_panel=_INSTRUMENT,
        ),
    ] = "typed",
    port: Annotated[
        str | None, typer.Option(help="Port of the UT372; default: search for it.", rich_help_panel=_INSTRUMENT)
    ] = None,
    motor: Motor = None,
    vehicle: VehicleOptions,
    log_ms: LogMs = 10,
    resume: ResumeOptions,
    keep: KeepOptions,
    note: Note = None,
) -> None:
    """Record rotor speeds while motors run a staircase; Ctrl-C stops them. Enter alone leaves a reading out.

    Example: [bold]cfid log speed --motor 1[/bold]
    """
    from cfid.errors import ConfigError

    if port is not None and tachometer != "ut372":
        raise ConfigError(f"--port is the UT372's, and --tachometer is {tachometer}.")
    wanted = stairs.stairs(motors_of(motor, (1,)), step=_SPEED_STEP, hold_s=_SPEED_HOLD_S, rest_s=_SPEED_REST_S)

    def instrument(crazyflie: "ReadyVehicle") -> "list[Device]":
        from cfid.rig.ready_instruments import ready_tachometer

        if tachometer == "ut372":
            return [crazyflie.usual_log(log_ms), ready_tachometer(port)]
        if tachometer == "typed":
            return [crazyflie.usual_log(log_ms)]
        return [crazyflie.speed_log(log_ms, deck=tachometer == "deck")]

    question = "RPM shown at command {command}" if tachometer == "typed" else None
    _climb(
        "speed",
        wanted,
        stairs,
        instrument,
        resume=resume.word,
        vehicle=vehicle,
        keep=keep,
        note=note,
        value="rpm",
        question=question,
    )


@flat
def scales(
    *,
    stairs: StairOptions,
    port: Annotated[
        str | None,
        typer.Option(help="Serial port of the scales; default: you type what they show.", rich_help_panel=_INSTRUMENT),
    ] = None,
    baud: Annotated[int, typer.Option(min=1, help="Speed of that port.", rich_help_panel=_INSTRUMENT)] = 9600,
    motor: Motor = None,
    vehicle: VehicleOptions,
    log_ms: LogMs = 10,
    resume: ResumeOptions,
    keep: KeepOptions,
    note: Note = None,
) -> None:
    """Record what scales show while motors run a staircase (figure 3.9); Ctrl-C stops them.

    Example: [bold]cfid log scales --motor 1,3[/bold]
    """
    wanted = stairs.stairs(motors_of(motor, (1, 3)), step=_SCALES_STEP, hold_s=_SCALES_HOLD_S, rest_s=_SCALES_REST_S)

    def instrument(crazyflie: "ReadyVehicle") -> "list[Device]":
        from cfid.rig.ready_instruments import ready_scales

        return [crazyflie.usual_log(log_ms), *([] if port is None else [ready_scales(port, baud=baud)])]

    question = "grams shown at command {command}" if port is None else None
    _climb(
        "scales",
        wanted,
        stairs,
        instrument,
        resume=resume.word,
        vehicle=vehicle,
        keep=keep,
        note=note,
        value="grams",
        question=question,
    )


def _climb(
    kind: str,
    wanted: "StaircasePlan",
    stairs: StairOptions,
    instrument: "Callable[[ReadyVehicle], list[Device]]",
    *,
    resume: Path | None,
    vehicle: VehicleOptions,
    keep: KeepOptions,
    note: str | None,
    value: str,
    question: str | None,
) -> None:
    """Run a staircase with an instrument that records by itself, or, with a question, one that the operator reads."""
    from cfid.motors.resume import interrupted, missing
    from cfid.records.run import Label
    from cfid.rig.log import Plan
    from cfid.rig.ready_instruments import typed_readings

    campaign, devices, simulated = rig_of(keep.campaign)
    if resume is not None:
        wanted = missing(interrupted(resume, campaign, kind=kind), kind=kind)
    if stairs.dry_run:
        announce(wanted)
        return
    live = LiveLine()
    with ExitStack() as held:
        crazyflie = reach(vehicle, devices, held, simulated=simulated)
        parts = [crazyflie.commands(), *instrument(crazyflie), crazyflie.supervisor_log()]
        if question is not None:
            parts.append(typed_readings(value))
        confirm(crazyflie, wanted.motors, wanted.steps, yes=vehicle.yes)
        plan = Plan(
            runs_folder=campaign.runs_folder,
            kind=kind,
            label=Label(note=note),
            procedure=_procedure(wanted, question, live),
            facts=campaign.rig.facts,
            asked=wanted.asked,
            simulated=simulated,
        )
        record(f"log {kind}", plan, parts, live, keep)


def _procedure(wanted: "StaircasePlan", question: str | None, live: LiveLine) -> Any:
    from cfid.rig.procedures import read_at_steps, run_staircase
    from cfid.rig.questions import Questions

    async def read(there: Any, loop: "Loop") -> None:
        questions = Questions(loop=loop, tell=live.task, say=live.tell)

        async def ask(command: int) -> float | None:
            return await questions.number(str(question).format(command=command))

        questions.open()
        try:
            await read_at_steps(wanted, there["commands"], there["readings"].add, ask, loop=loop, tell=live.task)
        finally:
            questions.close()

    if question is not None:
        return read
    return lambda there, loop: run_staircase(wanted, there["commands"], loop=loop, tell=live.task)
