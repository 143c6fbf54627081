"""The table of all commands in the order of the lists: each command's function and its line in the lists.

Lists and the `--help` of a group are printed from this table alone, so that they import no command's module.
"""

from cfid.experiments import EXPERIMENTS

_TRANSFER, _LATENCY = ((EXPERIMENTS[name].function, EXPERIMENTS[name].line) for name in ("tf", "latency"))

COMMANDS: dict[str, tuple[str | None, str]] = {
    "demo": (
        "cfid.demo.command:demo",
        "Make a campaign on the simulated rig, fit and report it, and compare the estimates with the true values.",
    ),
    "new": ("cfid.cli.new:new_campaign", "Make a campaign folder with a commented rig.toml."),
    "show": (
        "cfid.cli.show:show_run",
        "Plot a run, device by device: angle and speed, forces and their spectrum, commands, battery, crossings, "
        "pings.",
    ),
    "watch": (
        "cfid.watch.command:watch",
        "Show a run in the browser while it is recorded, with a button that stops all motors; Ctrl-C ends the command.",
    ),
    "report": (
        "cfid.report.command:report",
        "Write a campaign's results to one file: main numbers, parameter sheet, and every experiment with its figures.",
    ),
    "import": (
        "cfid.cli.recordings:import_file",
        "Make a run from another program's recording. The file stays as it is, and no existing run is changed.",
    ),
    "convert": (
        "cfid.cli.recordings:convert",
        "Write a recording in another format: every row and column, in its original units.",
    ),
    "validate": (
        "cfid.validation.command:validate",
        "Compare how well parameter sets predict a flight that none of them was fitted to.",
    ),
    "status": (
        "cfid.guide.command:status",
        "Show a campaign's results, their uncertainties against its aims, what is missing, and the next step.",
    ),
    "next": (
        "cfid.guide.command:next_step",
        "Do the next step of a campaign: record a run, fit, or report; first print what to do at the rig.",
    ),
    "parameters": (
        "cfid.cli.parameters:list_parameters",
        "List the campaign's parameters, each with its standard uncertainty, unit and origin.",
    ),
    "set": (
        "cfid.cli.parameters:set_by_hand",
        "Store a value measured by hand. Values that belong in rig.toml, such as the mass, are changed there.",
    ),
    "fits": ("cfid.cli.fits:show_fits", "List the campaign's kept fits: which count, and why the others do not."),
    "fits drop": ("cfid.cli.fits:drop", "Withdraw fits, so that the next best count. Nothing is deleted."),
    "fits repeat": (
        "cfid.cli.fits:repeat",
        "Repeat a kept fit from its runs and options, and state whether the numbers are the same. Nothing is kept.",
    ),
    "fleet": (
        "cfid.fleet.command:fleet",
        "Compare the results of several campaigns: mean, scatter, expected scatter, outliers and drift of each number.",
    ),
    "fleet fit": (
        "cfid.fleet.fit_command:fleet_fit",
        "Refit campaigns from their recordings: each fit that counts, into a new folder. No campaign is changed.",
    ),
    "export": (
        "cfid.export.command:export",
        "Export the measured parameters to a file for firmware or a simulator, in its frame and units, with their "
        "origins.",
    ),
    "runs": ("cfid.cli.runs:show_runs", "List the campaign's runs: what, when, state, rows, losses."),
    "runs exclude": (
        "cfid.cli.runs:exclude",
        "Exclude runs from fits that select their runs automatically. Nothing is deleted.",
    ),
    "runs include": ("cfid.cli.runs:include", "Include excluded runs again."),
    "runs note": ("cfid.cli.runs:note", "Add a note to runs, after their existing notes."),
    "rig": (None, "Check the rig's devices, or simulate them."),
    "rig check": (
        "cfid.cli.rig:check",
        "Identify every device, and report faults and remedies.",
    ),
    "rig sim": (
        "cfid.cli.rig:sim",
        "Serve a simulated encoder, load cell and Crazyflie on real interfaces; cfid's commands use them while "
        "this runs.",
    ),
    "log": (None, "Record data from the rig."),
    "log encoder": ("cfid.cli.log:encoder", "Record the encoder until Ctrl-C."),
    "log gyro": (
        "cfid.cli.log:gyro",
        "Record the vehicle's gyro and accelerometer until Ctrl-C, in place of an encoder. No motor turns.",
    ),
    "log loadcell": ("cfid.cli.log:loadcell", "Record the load cell until Ctrl-C."),
    "log thrust": (
        "cfid.motors.command:thrust",
        "Record load cell, commands and battery while the motors run a staircase; Ctrl-C stops them.",
    ),
    "log speed": (
        "cfid.motors.command:speed",
        "Record rotor speeds while motors run a staircase; Ctrl-C stops them. Enter alone skips a reading.",
    ),
    "log scales": (
        "cfid.motors.command:scales",
        "Record the readings of scales while motors run a staircase (figure 3.9); Ctrl-C stops the motors.",
    ),
    "log sine": (
        "cfid.transfer.command:sine",
        "Play sines on board, one after the other, and record load cell and crossings; Ctrl-C stops the motors.",
    ),
    "log ping": (
        "cfid.latency.command:ping",
        "Measure round trips to the vehicle: mean, standard deviation, minimum, histogram (table 3.2). No motor turns.",
    ),
    "log wind": (
        "cfid.drag.command:wind",
        "Record load cell, commands and battery in one wind setting, command by command; Ctrl-C stops the motors.",
    ),
    "motors": (
        "cfid.cli.motors:console",
        "Drive the vehicle's motors from the keyboard, or stop them; nothing is recorded.",
    ),
    "motors set": (
        "cfid.cli.motors:set_motors",
        "Run motors at a command until the time is up or Ctrl-C, then stop them and confirm the stop.",
    ),
    "motors stop": (
        "cfid.cli.motors:stop",
        "Stop all motors and confirm the stop. Another cfid that drives them is asked to end, without waiting for it.",
    ),
    "motors recover": (
        "cfid.cli.motors:recover",
        "Recover a vehicle that crashed, once it is upright: stop its motors, recover it, and check its state.",
    ),
    "fit": (None, "Estimate parameters from recordings."),
    **{row.fit: (row.function, row.line) for row in EXPERIMENTS.values() if row.fit.startswith("fit ")},
    "tf": (None, "Identify and check the transfer function of motor and rotor."),
    "tf identify": _TRANSFER,
    "tf verify": (
        "cfid.transfer.command:verify",
        "Simulate the campaign's transfer function against runs that were left out of its fit.",
    ),
    "tf latency": _LATENCY,
}

# Motors are never refused a command for want of JSON.
PRINT_NO_JSON = frozenset(
    (
        *("convert", "demo", "fits drop", "fits repeat", "import", "new", "next", "report", "rig sim"),
        *("runs exclude", "runs include", "runs note", "set", "watch"),
    )
)
