"""`cfid rig preflight`: judge a few seconds of real signals before a recording of minutes."""

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cfid.console.flat import flat
from cfid.console.options import positive
from cfid.console.vehicle import VehicleOptions

if TYPE_CHECKING:
    from cfid.console.recording import Rig
    from cfid.estimate.battery_endurance import Held
    from cfid.rig.check import DeviceAnswer
    from cfid.rig.instrument import Instrument
    from cfid.rig.ready_vehicle import ReadyVehicle
    from cfid.rig.recorder import Sampled

Experiment = Literal["thrust", "sine", "wind", "swing"]
Answers = dict[str, "list[DeviceAnswer]"]

_SWING_S = 60.0
_SHORTEST_S = 0.5
_VEHICLE_ROWS_HZ = 100.0
_LOW_COMMAND, _HOLD_S, _REST_S = 20000, 3.0, 1.5  # for the balance of the propellers
_UNBALANCED, _WORSE = 1.2, 2.0  # limits of the line's amplitude over the thrust, and of that over the median


@flat
def preflight(
    *,
    experiment: Annotated[
        Experiment, typer.Argument(metavar="EXPERIMENT", help="Experiment to check the rig for.")
    ] = "thrust",
    for_s: Annotated[float, typer.Option("--for", metavar="S", help="Seconds of signals to check.")] = 10.0,
    balance: Annotated[
        bool,
        typer.Option(
            "--balance/--no-balance", help="Offer to turn each motor slowly, to check its propeller's balance."
        ),
    ] = True,
    vehicle: VehicleOptions,
    campaign: Annotated[
        Path | None, typer.Option(help="Campaign folder; default: the current folder or a parent.")
    ] = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", help="Do not ring the bell after the check of the signals.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Check a few seconds of real signals before an experiment: value, limit, and what to do. Changes no runs.

    The check assumes the plan of the `cfid log` command without options. Motors turn only for the balance, after you
    confirm it.

    Example: [bold]cfid rig preflight thrust[/bold]
    """
    from cfid.cli.rig import report_answers
    from cfid.console.messages import note
    from cfid.console.recording import rig_of
    from cfid.errors import ConfigError, DeviceError, StopError
    from cfid.rig.check import DeviceAnswer

    if positive(for_s, "--for") < _SHORTEST_S:
        raise ConfigError(f"--for {for_s:g}: noise and drift need {_SHORTEST_S:g} s or more.")
    rig = rig_of(campaign)
    answers: Answers = _identified(experiment, rig)
    if not any(one.state == "fault" for own in answers.values() for one in own):
        try:
            with ExitStack() as held:
                _look(experiment, rig, answers, held, vehicle, seconds=for_s, balance=balance, quiet=quiet)
        except StopError:
            raise
        except DeviceError as error:
            answers.setdefault("signals", []).append(DeviceAnswer("recording", "fault", str(error)))
    else:
        note("no signal was examined: mend the faults above first.")
    report_answers("rig preflight", answers, simulated=rig.simulated, json=json)


def _identified(experiment: Experiment, rig: "Rig") -> Answers:
    """Return what `cfid rig check` finds about the devices of the experiment."""
    from cfid.rig.check import check_encoder, check_loadcell, check_vehicle

    devices, stated, hardware = rig.devices, rig.campaign.rig, rig.hardware
    if experiment == "swing":
        counts_per_turn = stated.encoder.counts_per_turn
        return {"encoder": check_encoder(devices.encoder, hardware, counts_per_turn=counts_per_turn)}
    vehicle = check_vehicle(devices.crazyflie, stated.vehicle.platform, hardware)
    return {"loadcell": check_loadcell(devices.loadcell, hardware), "crazyflie": vehicle}


def _look(
    experiment: Experiment,
    rig: "Rig",
    answers: Answers,
    held: ExitStack,
    vehicle: VehicleOptions,
    *,
    seconds: float,
    balance: bool,
    quiet: bool,
) -> None:
    """Sample the devices of the experiment, and add the verdicts on their signals to the answers."""
    from cfid.console.live import LiveLine
    from cfid.console.preflight import TARE_S, judged
    from cfid.console.preflight_lines import sends_lines
    from cfid.console.vehicle import reach
    from cfid.rig.check import DeviceAnswer
    from cfid.rig.encoder import ready_encoder
    from cfid.rig.loadcell import ready_loadcell
    from cfid.rig.run import sample

    campaign, devices, hardware = rig.campaign, rig.devices, rig.hardware
    live = LiveLine(quiet=quiet)
    crazyflie: ReadyVehicle | None = None
    if experiment == "swing":
        counts = campaign.rig.encoder.counts_per_turn
        parts: list[Instrument] = [ready_encoder(devices.encoder, hardware, held, counts_per_turn=counts, say=live.say)]
        rate_hz = devices.encoder.rate_hz
    else:
        loadcell = ready_loadcell(devices.loadcell, hardware, held, say=live.say, patient=False)
        crazyflie = reach(vehicle, rig, held)
        parts, rate_hz = [loadcell, crazyflie.usual_log()], devices.loadcell.rate_hz + _VEHICLE_ROWS_HZ
    plan = _plan(experiment)
    live.task("looking at the signals")
    try:
        sampled = sample(parts, hardware, for_s=seconds, tare_s=TARE_S, show=live.show)
    finally:
        live.end()
    mass_kg = campaign.rig.vehicle.mass_kg
    for name, own in judged(
        {part.name: part.record for part in parts}, sampled, plan, mass_kg=mass_kg, calm=experiment != "wind"
    ).items():
        answers[name] += own
    answers["disk"] = [_disk(sum(part.seconds for part in plan), campaign.runs_folder, rate_hz)]
    if crazyflie is not None and balance and sends_lines(parts[0].record):
        text = "not measured: it takes a load cell that samples at 3.5 kHz or more"
        answers["rotors"] = [DeviceAnswer("balance", "ok", text)]
    elif crazyflie is not None and balance:
        answers["rotors"] = _balances(crazyflie, loadcell, sampled["crazyflie"], vehicle, live)


def _plan(experiment: Experiment) -> "list[Held]":
    """Return the plan of the experiment's `cfid log` command without options."""
    from cfid.drag.command import SweepOptions
    from cfid.estimate.battery_endurance import Held
    from cfid.motors.command import StaircaseOptions, thrust_staircase
    from cfid.transfer.command import SineOptions, seconds_of_each

    if experiment == "swing":
        return [Held(0, 0, _SWING_S)]
    if experiment == "sine":
        sweep = SineOptions().chosen()
        each_s = seconds_of_each(sweep, before_s=SineOptions().before)
        return [held for sine in sweep.sines for held in sine.held(each_s)]
    if experiment == "wind":
        return SweepOptions().staircase().held
    return thrust_staircase(StaircaseOptions()).held


def _disk(seconds: float, runs_folder: Path, rate_hz: float) -> "DeviceAnswer":
    from cfid.console.messages import clock
    from cfid.console.recording import space_of
    from cfid.errors import ConfigError
    from cfid.rig.check import DeviceAnswer

    try:
        space = space_of(seconds, runs_folder, rate_hz=rate_hz)
    except ConfigError as error:
        return DeviceAnswer("space", "fault", str(error))
    return DeviceAnswer("space", "ok", f"{clock(seconds)} min take {space}")


def _balances(
    crazyflie: "ReadyVehicle", loadcell: "Instrument", at_rest: "Sampled", vehicle: VehicleOptions, live: Any
) -> "list[DeviceAnswer]":
    """Turn each motor at a low command after the operator confirms it, and judge its propeller.

    `at_rest`, the vehicle's log with motors off, contains the battery's voltage.
    """
    from cfid.cli.motors import stopped_line
    from cfid.console.messages import clock, note
    from cfid.console.preflight import battery
    from cfid.console.vehicle import confirm
    from cfid.errors import CfidError, ConfigError, DeviceError
    from cfid.motors.plan import StaircasePlan
    from cfid.motors.record import run_staircase
    from cfid.rig.check import DeviceAnswer
    from cfid.rig.run import sample
    from cfid.units import MOTORS

    idles = bool(crazyflie.limits.idle_thrust)
    groups = [MOTORS] if idles else [(motor,) for motor in MOTORS]
    plans = [StaircasePlan(steps=(_LOW_COMMAND,), motors=motors, hold_s=_HOLD_S, rest_s=_REST_S) for motors in groups]
    lasts_s = sum(plan.duration_s for plan in plans)
    lasting = battery(at_rest, [held for plan in plans for held in plan.held]).answer
    how = "together" if idles else "one after the other"
    effort = f", {how}, for {clock(lasts_s)} min (nothing is kept on the disk); battery {lasting}"
    try:
        confirm(crazyflie, MOTORS, [_LOW_COMMAND], yes=vehicle.yes, effort=effort)
    except ConfigError as error:
        return [DeviceAnswer("balance", "warning", f"not measured: {error}")]

    async def turn(there: Any, hardware: Any) -> None:
        for plan in plans:
            await run_staircase(plan, there["commands"], hardware=hardware, tell=live.task)

    stopped_s: list[float] = []
    try:
        sampled = sample(
            [crazyflie.commands(), loadcell, *crazyflie.watch()],
            crazyflie.vehicle.hardware,
            for_s=lasts_s,
            tare_s=_REST_S,
            procedure=turn,
            show=live.show,
            stopped=stopped_s.append,
        )
    finally:
        live.end()
        for seconds in stopped_s:
            note(stopped_line(crazyflie.uri, seconds))
    try:
        return _judged_balances(sampled, loadcell)
    except DeviceError:
        raise
    except CfidError as error:
        return [DeviceAnswer("balance", "warning", f"not measured: {error}")]


def _judged_balances(sampled: "Mapping[str, Sampled]", loadcell: "Instrument") -> "list[DeviceAnswer]":
    import numpy as np

    from cfid.console.preflight import AXES
    from cfid.motors.vibration.balance import balances
    from cfid.rig.check import DeviceAnswer

    scale = loadcell.record.model_extra or {}
    cell, commands = sampled["loadcell"].columns, sampled["commands"].columns
    per_unit = np.repeat([scale["counts_per_n"], scale["counts_per_nm"]], 3)
    found = balances(
        time_s=cell["t"] - cell["t"][0],
        wrench=np.column_stack([cell[axis] for axis in AXES]) / per_unit,
        command_time_s=commands["t"] - cell["t"][0],
        commands=np.column_stack([commands[f"m{motor}"] for motor in (1, 2, 3, 4)]),
    )
    usual = float(np.median([one.ratio for one in found if not one.reason] or [np.nan]))
    answers = []
    for one in found:
        line = f"balance {','.join(map(str, one.motors))}"
        if one.reason:
            answers.append(DeviceAnswer(line, "warning", f"not measured: {one.reason}"))
            continue
        most = min(_UNBALANCED, _WORSE * usual)
        within = one.ratio <= most
        answers.append(
            DeviceAnswer(
                line,
                "ok" if within else "fault",
                f"{1e3 * one.line_n:.3g} mN at {one.speed_rad_per_s / (2 * np.pi):.0f} Hz, {100 * one.ratio:.0f} % of "
                f"{1e3 * one.thrust_n:.3g} mN of thrust",
                "" if within else "clean, balance or replace this propeller; look for a bent shaft",
                f"{100 * most:.0f} %",
            )
        )
    return answers
