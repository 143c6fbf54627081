"""The table of all commands, of the groups that are no commands themselves, and of the sections of the list."""

from cfid.experiments import EXPERIMENTS

GROUPS = {
    "rig": "Check the rig's devices, or simulate them.\n\nExample: cfid rig check",
    "log": "Record data from the rig.\n\nExample: cfid log encoder --axis x --for 20",
    "fit": "Estimate parameters from recordings.\n\nExample: cfid fit inertia",
    "tf": "Identify and check the transfer function of motor and rotor.\n\nExample: cfid tf identify",
}

# By its words, the function of each command; None is a group. Lists show the first paragraph of its docstring.
COMMANDS: dict[str, str | None] = {
    "demo": "cfid.demo.command:demo",
    "new": "cfid.cli.new:new_campaign",
    "show": "cfid.cli.show:show_run",
    "watch": "cfid.watch.command:watch",
    "report": "cfid.report.command:report",
    "import": "cfid.cli.recordings:import_file",
    "convert": "cfid.cli.recordings:convert",
    "compare": "cfid.comparison.command:compare",
    "validate": "cfid.validation.command:validate",
    "status": "cfid.guide.command:status",
    "next": "cfid.guide.command:next_step",
    "parameters": "cfid.cli.parameters:list_parameters",
    "set": "cfid.cli.parameters:set_by_hand",
    "fits": "cfid.cli.fits:show_fits",
    "fits drop": "cfid.cli.fits:drop",
    "fits repeat": "cfid.cli.fits:repeat",
    "fleet": "cfid.fleet.command:fleet",
    "fleet fit": "cfid.fleet.command:fleet_fit",
    "export": "cfid.export.command:export",
    "runs": "cfid.cli.runs:show_runs",
    "runs exclude": "cfid.cli.runs:exclude",
    "runs include": "cfid.cli.runs:include",
    "runs note": "cfid.cli.runs:note",
    "rig": None,
    "rig check": "cfid.cli.rig:check",
    "rig sim": "cfid.cli.rig:sim",
    "log": None,
    "log encoder": "cfid.cli.log:encoder",
    "log gyro": "cfid.cli.log:gyro",
    "log loadcell": "cfid.cli.log:loadcell",
    "log thrust": "cfid.motors.command:thrust",
    "log speed": "cfid.motors.command:speed",
    "log scales": "cfid.motors.command:scales",
    "log sine": "cfid.transfer.command:sine",
    "log ping": "cfid.latency.command:ping",
    "log wind": "cfid.drag.command:wind",
    "motors": "cfid.cli.motors:console",
    "motors set": "cfid.cli.motors:set_motors",
    "motors stop": "cfid.cli.motors:stop",
    "motors recover": "cfid.cli.motors:recover",
    "fit": None,
    **{row.fit: row.function for row in EXPERIMENTS.values() if row.fit.startswith("fit ")},
    "tf": None,
    "tf identify": EXPERIMENTS["tf"].function,
    "tf verify": "cfid.transfer.command:verify",
    "tf latency": EXPERIMENTS["latency"].function,
}

# The program's commands in the sections of its help.
SECTIONS = {
    "Campaign": ("demo", "new", "status", "next", "set", "fleet"),
    "Record": ("rig", "log", "motors", "watch"),
    "Results": ("fit", "tf", "fits", "parameters", "compare", "validate", "report", "export"),
    "Files": ("runs", "show", "import", "convert"),
}

# Motors are never refused a command for want of JSON.
PRINT_NO_JSON = frozenset(
    (
        *("convert", "demo", "fits drop", "import", "new", "next", "rig sim"),
        *("runs exclude", "runs include", "runs note", "set", "watch"),
    )
)
