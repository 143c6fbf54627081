"""`cfid motors`: drive the motors by hand, and stop them."""

from contextlib import ExitStack
from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.live import LiveLine
from cfid.console.messages import note, result
from cfid.console.options import positive
from cfid.console.recording import rig_of
from cfid.console.run_summary import stop_line
from cfid.console.vehicle import Motor, Uri, confirm, motors_of, reach
from cfid.units import FULL_COMMAND, MOTORS

if TYPE_CHECKING:
    from cfid.records.rig_file import CrazyflieLink
    from cfid.rig.ready_vehicle import ReadyVehicle
    from cfid.rig.run import Procedure
    from cfid.wire.app import AppPorts


def console(context: typer.Context, *, uri: Uri = None) -> None:
    """Drive motors from the keyboard or stop them; nothing is recorded.

    Example: cfid motors
    """
    if context.invoked_subcommand is not None:
        return
    from cfid.rig.console import Console

    rig = rig_of()
    live = LiveLine()
    with ExitStack() as held:
        crazyflie = reach(uri, rig, held)
        confirm(crazyflie, MOTORS, [crazyflie.limits.largest_command])
        _drive(
            crazyflie,
            live,
            lambda there, hardware: Console(
                there["commands"], crazyflie.limits, hardware=hardware, tell=live.ask, say=live.tell
            ).run(),
        )


def set_motors(
    command: Annotated[
        int,
        typer.Argument(metavar="COMMAND", min=0, max=FULL_COMMAND, help=f"Motor command, from 0 to {FULL_COMMAND}."),
    ],
    *,
    motor: Motor = None,
    for_s: Annotated[
        float | None, typer.Option("--for", metavar="S", help="Seconds to run; default: until Ctrl-C.")
    ] = None,
    uri: Uri = None,
) -> None:
    """Run motors at a command until the time is up or Ctrl-C, then stop them and confirm the stop.

    Example: cfid motors set 30000 --motor 1,3 --for 10
    """
    from cfid.rig.motor_commands import hold

    if for_s is not None:
        positive(for_s, "--for")
    chosen = motors_of(motor, MOTORS)
    rig = rig_of()
    live = LiveLine()
    with ExitStack() as held:
        crazyflie = reach(uri, rig, held)
        confirm(crazyflie, chosen, [command])
        _drive(
            crazyflie,
            live,
            lambda there, hardware: hold(there["commands"], command, chosen, for_s=for_s, hardware=hardware),
        )


def stop(*, uri: Uri = None, by_button: Annotated[bool, typer.Option("--by-button", hidden=True)] = False) -> None:
    """Stop all motors and confirm the stop. Another cfid that drives them is asked to end, without waiting for it.

    Example: cfid motors stop
    """
    from cfid.errors import DeviceError
    from cfid.rig.hardware import present
    from cfid.rig.lock import resolved, vehicles_held

    setting = _setting(uri)
    failed: list[DeviceError] = []
    for vehicle in [setting.uri] if setting.uri else vehicles_held() or [present().find_vehicle()]:
        try:
            _stop(vehicle, setting, by_button=by_button)
        except DeviceError as error:
            failed.append(error)
    for other in vehicles_held():
        if setting.uri is not None and other != resolved(setting.uri):
            note(f"{other}: another cfid holds this vehicle, and it was not stopped: cfid motors stop --uri {other}")
    if failed:
        raise type(failed[0])("\n".join(map(str, failed)))


def recover(*, uri: Uri = None) -> None:
    """Recover a vehicle that crashed, once it is upright: stop its motors, recover it, and check its state.

    Example: cfid motors recover
    """
    from cfid.rig.emergency import recover_vehicle
    from cfid.rig.hardware import present

    setting = _setting(uri)
    hardware = present()
    vehicle = setting.uri or hardware.find_vehicle()
    state = recover_vehicle(vehicle, _ports(setting), hardware, say=note)
    result(f"{vehicle}: motors stopped; the vehicle {'reports no state' if state is None else f'is {state.name}'}.")


def _stop(uri: str, setting: "CrazyflieLink", *, by_button: bool) -> None:
    from cfid.rig.emergency import stop_vehicle
    from cfid.rig.hardware import present

    stopped = stop_vehicle(uri, _ports(setting), present(), say=note, by_button=by_button)
    result(f"{uri}: {stop_line(stopped.after_s)}")
    if stopped.state is not None and stopped.state.remedy:
        note(f"{uri}: the vehicle is {stopped.state.name}: {stopped.state.remedy}.")


def _ports(setting: "CrazyflieLink") -> "AppPorts":
    from cfid.wire.app import AppPorts

    return AppPorts(setting.thrust_port, setting.sine_port, setting.ping_port)


def _setting(uri: str | None) -> "CrazyflieLink":
    """Return the link to the vehicle, also without a campaign, a valid rig.toml or a current folder."""
    from cfid.errors import ConfigError
    from cfid.records.rig_file import CrazyflieLink

    try:
        link = rig_of(or_real=True).devices.crazyflie
    except ConfigError as error:
        which = "" if uri else " The vehicles that another cfid drives are stopped, else the one that is found."
        note(f"{error}{which} The app is looked for on its usual ports.")
        link = CrazyflieLink()
    return link if uri is None else link.model_copy(update={"uri": uri})


def _drive(vehicle: "ReadyVehicle", live: LiveLine, procedure: "Procedure") -> None:
    from cfid.rig.run import drive

    def stopped(seconds: float) -> None:
        live.end()
        result(f"{vehicle.uri}: {stop_line(seconds)}")

    try:
        drive(
            [vehicle.commands(), *vehicle.watch()], procedure, vehicle.vehicle.hardware, show=live.show, stopped=stopped
        )
    finally:
        live.end()
