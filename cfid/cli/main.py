"""The program `cfid`: its groups of commands, and the one place where errors become exit codes."""

import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from cfid import __version__
from cfid.cli.campaign import new
from cfid.cli.demo import demo
from cfid.cli.export import export
from cfid.cli.fit_drag import drag
from cfid.cli.fit_dynamics import dynamics
from cfid.cli.fit_friction import friction
from cfid.cli.fit_inertia import inertia
from cfid.cli.fit_motors import speed as fit_speed
from cfid.cli.fit_motors import thrust as fit_thrust
from cfid.cli.fit_motors import torque as fit_torque
from cfid.cli.fit_rotor import rotor
from cfid.cli.fit_swing import swing
from cfid.cli.fit_testbody import testbody
from cfid.cli.fleet import fleet
from cfid.cli.log import encoder, loadcell
from cfid.cli.log_ping import ping
from cfid.cli.log_readings import scales, speed
from cfid.cli.log_sine import sine
from cfid.cli.log_thrust import thrust
from cfid.cli.log_wind import wind
from cfid.cli.motors import console, set_motors, stop
from cfid.cli.parameters import parameters, set_by_hand
from cfid.cli.report import report
from cfid.cli.rig import check, sim
from cfid.cli.runs import exclude, include, note, runs
from cfid.cli.show import show
from cfid.cli.speech import fault
from cfid.cli.tf_identify import identify
from cfid.cli.tf_latency import latency
from cfid.cli.tf_verify import verify
from cfid.errors import CfidError

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
