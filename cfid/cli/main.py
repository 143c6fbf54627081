"""The program `cfid`: its groups of commands, and the one place where errors become exit codes."""

import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from cfid import __version__
from cfid.cli.log import encoder, loadcell
from cfid.cli.motors import console, set_motors, stop
from cfid.cli.new import new
from cfid.cli.parameters import parameters, set_by_hand
from cfid.cli.rig import check, sim
from cfid.cli.runs import exclude, include, note, runs
from cfid.cli.show import show
from cfid.cli.upgrade import upgrade_campaign
from cfid.console.messages import fault
from cfid.demo.command import demo
from cfid.drag.command import drag
from cfid.drag.wind.command import wind
from cfid.errors import CfidError
from cfid.export.command import export
from cfid.fleet.command import fleet
from cfid.friction.command import friction
from cfid.inertia.command import inertia
from cfid.inertia.testbody_command import testbody
from cfid.latency.command import latency
from cfid.latency.log_command import ping
from cfid.motors.command import thrust
from cfid.motors.maps.command import speed as fit_speed
from cfid.motors.maps.command import thrust as fit_thrust
from cfid.motors.maps.command import torque as fit_torque
from cfid.motors.readings_command import scales, speed
from cfid.motors.steps.command import dynamics
from cfid.motors.vibration.command import rotor
from cfid.report.command import report
from cfid.swing.command import swing
from cfid.transfer.command import identify
from cfid.transfer.sines.command import sine
from cfid.transfer.verify_command import verify

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
fit = typer.Typer(no_args_is_help=True, help="Find parameters from recordings.")

rig = typer.Typer(no_args_is_help=True, help="Ask the rig's devices, or simulate them.")
tf = typer.Typer(no_args_is_help=True, help="Find and check the transfer function of motor and rotor.")
log = typer.Typer(no_args_is_help=True, help="Record from the rig.")
motors = typer.Typer()
recorded = typer.Typer()

app.command()(demo)
app.command()(new)
app.command()(show)
app.command()(report)
app.command()(parameters)
app.command("set")(set_by_hand)
app.command("upgrade")(upgrade_campaign)
app.command()(fleet)
app.command()(export)
app.add_typer(recorded, name="runs")
recorded.callback(invoke_without_command=True)(runs)
recorded.command()(exclude)
recorded.command()(include)
recorded.command()(note)
app.add_typer(rig, name="rig")
rig.command()(check)
rig.command()(sim)
app.add_typer(log, name="log")
log.command()(encoder)
log.command()(loadcell)
log.command()(thrust)
log.command()(speed)
log.command()(scales)
log.command()(sine)
log.command()(ping)
log.command()(wind)
app.add_typer(motors, name="motors")
motors.callback(invoke_without_command=True)(console)
motors.command("set")(set_motors)
motors.command()(stop)
app.add_typer(fit, name="fit")
fit.command()(swing)
fit.command()(friction)
fit.command()(inertia)
fit.command()(testbody)
fit.command("thrust")(fit_thrust)
fit.command("speed")(fit_speed)
fit.command("torque")(fit_torque)
fit.command()(rotor)
fit.command()(dynamics)
fit.command()(drag)
fit.command("tf")(identify)
app.add_typer(tf, name="tf")
tf.command()(identify)
tf.command()(verify)
tf.command()(latency)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"cfid {__version__}")
        raise typer.Exit


@app.callback()
def cfid(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Measure a Crazyflie: record, identify its physical parameters, say how sure they are.

    A newcomer starts with [bold]cfid demo[/bold].
    """


def main(words: Sequence[str] | None = None) -> None:
    """Run the program with its arguments, or others. Expected errors end in a sentence on stderr and an exit code."""
    try:
        app(words, prog_name="cfid")
    except CfidError as error:
        fault(str(error))
        sys.exit(error.exit_code)


if __name__ == "__main__":
    main()
