"""The table of all commands, in the order of lists: the function of each, and the line that lists show.

Lists and `--help` of a group are written from here alone, so that no command's module is imported for them.
"""

COMMANDS: dict[str, tuple[str | None, str]] = {
    "demo": (
        "cfid.demo.command:demo",
        "Make a campaign on the simulated rig, fit and report it, and compare with the truth that the simulation "
        "knows.",
    ),
    "new": ("cfid.cli.new:new", "Make a campaign folder with a commented rig.toml."),
    "show": (
        "cfid.cli.show:show",
        "Plot a run, device by device: angle and speed, forces and their spectrum, commands, battery, crossings, "
        "pings.",
    ),
    "report": (
        "cfid.report.command:report",
        "Write what a campaign found into one file: the sheet first, then every experiment with its figures.",
    ),
    "parameters": (
        "cfid.cli.parameters:parameters",
        "List what the campaign knows: every parameter with its deviation, unit, and where it is from.",
    ),
    "set": (
        "cfid.cli.parameters:set_by_hand",
        "Note what was measured by hand. What rig.toml states, as the mass, is changed there.",
    ),
    "upgrade": (
        "cfid.cli.upgrade:upgrade_campaign",
        "Rewrite a campaign's parameters.toml and fits in this version's formats; the old files stay in "
        "before-upgrade.",
    ),
    "fleet": (
        "cfid.fleet.command:fleet",
        "Compare what campaigns found: each number of each, mean, scatter, whether they agree, and drift.",
    ),
    "export": (
        "cfid.export.command:export",
        "Write what was measured as a file for firmware or a simulator: turned to its frame, in its units, with "
        "origins.",
    ),
    "runs": ("cfid.cli.runs:runs", "List the campaign's runs: what, when, state, rows, losses."),
    "runs exclude": (
        "cfid.cli.runs:exclude",
        "Let fits leave runs out that find their runs themselves. Nothing is deleted.",
    ),
    "runs include": ("cfid.cli.runs:include", "Take an exclusion back."),
    "runs note": ("cfid.cli.runs:note", "Write a note into runs, in the place of the one they have."),
    "rig": (None, "Ask the rig's devices, or simulate them."),
    "rig check": (
        "cfid.cli.rig:check",
        "Ask every device who it is, and say what is wrong and what to do. Changes no setting.",
    ),
    "rig sim": (
        "cfid.cli.rig:sim",
        "Serve a simulated encoder, load cell and Crazyflie on real wires; cfid's commands use them while this runs.",
    ),
    "log": (None, "Record from the rig."),
    "log encoder": ("cfid.cli.log:encoder", "Record the encoder until Ctrl-C."),
    "log loadcell": ("cfid.cli.log:loadcell", "Record the load cell until Ctrl-C."),
    "log thrust": (
        "cfid.motors.command:thrust",
        "Record load cell, commands and battery while the motors climb a staircase; Ctrl-C stops them.",
    ),
    "log speed": (
        "cfid.motors.readings_command:speed",
        "Record rotor speeds while motors climb a staircase; Ctrl-C stops them. Typed: Enter alone leaves one out.",
    ),
    "log scales": (
        "cfid.motors.readings_command:scales",
        "Record what scales show while motors climb a staircase (figure 3.9); Ctrl-C stops them.",
    ),
    "log sine": (
        "cfid.transfer.sines.command:sine",
        "Play sines on board, one after the other, and record load cell and crossings; Ctrl-C stops the motors.",
    ),
    "log ping": (
        "cfid.latency.log_command:ping",
        "Measure round trips to the vehicle: mean, standard deviation, least, histogram (table 3.2). No motor turns.",
    ),
    "log wind": (
        "cfid.drag.wind.command:wind",
        "Record load cell, commands and battery in one wind, command after command; Ctrl-C stops the motors.",
    ),
    "motors": (
        "cfid.cli.motors:console",
        "Drive the vehicle's motors from the keyboard, or stop them; nothing is recorded.",
    ),
    "motors set": (
        "cfid.cli.motors:set_motors",
        "Run motors at a command until the time is over or Ctrl-C, then stop them and check.",
    ),
    "motors stop": (
        "cfid.cli.motors:stop",
        "Stop all motors and see that they stopped. Another cfid that drives them is asked to end, and not waited for.",
    ),
    "fit": (None, "Find parameters from recordings."),
    "fit swing": (
        "cfid.swing.command:swing",
        "Fit one swing: a pendulum with its sine kept and the damping that the data supports.",
    ),
    "fit friction": (
        "cfid.friction.command:friction",
        "Fit the friction of the swing's axis to weights dropped on a line wound around it.",
    ),
    "fit inertia": (
        "cfid.inertia.command:inertia",
        "Fit the inertia matrix about the centre of mass to six or more swings about any axes.",
    ),
    "fit testbody": (
        "cfid.inertia.command:testbody",
        "Compare the test body's measured inertias with those of its drawing (table 2.5).",
    ),
    "fit thrust": (
        "cfid.motors.maps.command:thrust",
        "Fit one motor's thrust over command, its inverse, the most it gives, and, with a battery's voltage, over "
        "that.",
    ),
    "fit speed": (
        "cfid.motors.maps.command:speed",
        "Fit one rotor's speed over command; a tachometer's readings are divided by --markers.",
    ),
    "fit torque": ("cfid.motors.maps.command:torque", "Fit one motor's torque over its thrust."),
    "fit rotor": (
        "cfid.motors.vibration.command:rotor",
        "Find rotor speeds in the load cell's vibration, in each steady window or between --from and --to.",
    ),
    "fit dynamics": (
        "cfid.motors.steps.command:dynamics",
        "Fit a first-order lag to each step of the command, and the rotor model of four coefficients to all.",
    ),
    "fit drag": (
        "cfid.drag.command:drag",
        "Fit the simple, the cross-coupling and the complex model of drag, and choose the one the data support.",
    ),
    "fit tf": (
        "cfid.transfer.command:identify",
        "Identify thrust over command: gain, time constant and delay, from sines of many frequencies (section 3.4).",
    ),
    "tf": (None, "Find and check the transfer function of motor and rotor."),
    "tf identify": (
        "cfid.transfer.command:identify",
        "Identify thrust over command: gain, time constant and delay, from sines of many frequencies (section 3.4).",
    ),
    "tf verify": (
        "cfid.transfer.verify_command:verify",
        "Simulate the campaign's transfer function, or one by its numbers, against runs it was not identified from.",
    ),
    "tf latency": (
        "cfid.latency.command:latency",
        "Report round trips of pings, and the vehicle's clock offset and skew where it stamped its answers.",
    ),
}
