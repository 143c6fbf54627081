"""Connect a command to the vehicle, and have the operator confirm that it is fastened before a motor turns."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.lists import comma_list
from cfid.console.messages import ask, note
from cfid.console.program import program
from cfid.console.recording import Rig
from cfid.errors import ConfigError

if TYPE_CHECKING:
    from cfid.rig.ready_vehicle import ReadyVehicle


Motor = Annotated[
    list[str] | None,
    typer.Option("--motor", metavar="1,3", help="Motors to use."),
]


def motors_of(words: Sequence[str] | None, usual: Sequence[int], *, least: int = 1) -> tuple[int, ...]:
    """Return the motors of `--motor`, each once, in ascending order. Raises ConfigError for anything else."""
    if not words:
        return tuple(usual)
    return tuple(sorted(set(comma_list(words, "--motor", int, least=least, most=4, example="1,3"))))


Uri = Annotated[
    str | None,
    typer.Option(metavar="URI", help="Vehicle's address; default: rig.toml's, else search."),
]
NoPreflight = Annotated[
    bool,
    typer.Option(
        "--no-preflight",
        help="Skip the check of one second of signals.",
    ),
]
CellRateHz = Annotated[int | None, typer.Option(metavar="HZ", min=1, help="Load cell's rate; default: rig.toml's.")]
LOG_MS = 10  # between rows of the vehicle's log while motors turn


def reach(uri: str | None, rig: Rig, held: ExitStack) -> "ReadyVehicle":
    """Connect to the chosen vehicle and note what the operator should know about it. Raises DeviceError."""
    from cfid.rig.ready_vehicle import connect_vehicle

    setting = rig.devices.crazyflie
    if uri is not None:
        if rig.simulated:
            raise ConfigError(
                "--uri names a real vehicle while a simulated rig serves this campaign, and a run is one or the other: "
                "end `cfid rig sim`, or leave --uri out."
            )
        setting = setting.model_copy(update={"uri": uri})
    vehicle = connect_vehicle(setting, rig.hardware, held)
    runs_app = vehicle.firmware.kind == "app"
    firmware = "cfid's app" if runs_app else "stock firmware"
    note(f"connected to {vehicle.uri}, which runs {firmware}.")
    if not runs_app:
        note("if the link is lost, nothing stops the motors of this firmware: keep the battery within reach.")
    if setting.stop_below_v is not None and not vehicle.reports_battery:
        note("the vehicle does not report its battery's voltage: stop_below_v of rig.toml has no effect.")
    if vehicle.state is not None and vehicle.state.remedy:
        note(f"the vehicle is {vehicle.state.name}: {vehicle.state.remedy}.")
    if runs_app and not vehicle.firmware.knows_owners:
        note("the app on it is older than this cfid: another program's keep-alives prolong commands there. Flash it.")
    return vehicle


def refuse(vehicle: "ReadyVehicle", motors: Sequence[int], commands: Sequence[int]) -> int:
    """Return the largest of the commands. Raises ConfigError when rig.toml or the rotors forbid one of them.

    Raises DeviceError for a vehicle whose motors cannot be started in its present state.
    """
    vehicle.refuse_unfit()
    turning = [command for command in commands if command] or [0]
    if max(turning):
        vehicle.limits.check_turning(motors, min(turning), max(turning))
    return max(turning)


def confirm(
    vehicle: "ReadyVehicle",
    motors: Sequence[int],
    commands: Sequence[int],
    *,
    effort: str = "",
    ring: Callable[[], None] = lambda: None,
) -> None:
    """Have the operator confirm that the vehicle is fastened, before motors turn at these commands.

    `effort` states how long the motors turn and what that takes; `ring` calls the operator. Raises ConfigError without
    a confirmation, DeviceError where something else drives motors, and otherwise as `refuse` does.
    """
    vehicle.refuse_driven()
    largest = refuse(vehicle, motors, commands)
    if program().yes:
        return
    which = f"motor {motors[0]}" if len(motors) == 1 else f"motors {', '.join(map(str, motors))}"
    turns = f"{vehicle.uri}: {which} will turn at commands up to {largest}{effort}."
    answer = ask(f"{turns} Is the vehicle fastened and everyone clear? [y/N]", ring=ring)
    if not answer:
        raise ConfigError(
            "nobody confirmed that the vehicle is fastened: a script gives --yes to this command, not to `cfid next`."
        )
    if answer.strip().lower() not in ("y", "yes"):
        raise ConfigError("not confirmed: no motor was started.")
