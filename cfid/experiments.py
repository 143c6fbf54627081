"""The experiments, a row each, in the order of the thesis: title, fit, revision, aims, and the judge of a new run.

A new experiment is a folder and a row. Its command, its place in the lists, its repetition from a kept fit and its
title in the report follow from the row. Functions are named by `module:function`, and imported where they are used.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from cfid.lazy import later


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """An experiment: its title, the words of its fit's command, and the fit's function.

    `measured_by` states how to record and fit it where no quantity states that. `revision` grows when the method finds
    other numbers in the same recordings: earlier fits then no longer count. `aims` are the quantities that a campaign's
    plan wants, `judges` the functions that judge a new run, by its kind.
    """

    title: str
    fit: str
    function: str
    measured_by: str = ""
    revision: int = 1
    aims: tuple[str, ...] = ()
    judges: Mapping[str, str] = field(default_factory=dict)


EXPERIMENTS: Mapping[str, Experiment] = {
    "swing": Experiment(
        title="Swing",
        fit="fit swing",
        function="cfid.swing.command:swing",
        judges={
            "swing": "cfid.swing.verdict:verdict",
            "encoder": "cfid.swing.verdict:of_no_mount",
            "gyro": "cfid.swing.verdict:of_no_mount",
        },
    ),
    "friction": Experiment(
        title="Friction of the axis",
        fit="fit friction",
        function="cfid.friction.command:friction",
        aims=("friction.viscous_nms_per_rad",),
        judges={"drop": "cfid.friction.verdict:verdict"},
    ),
    "inertia": Experiment(
        title="Inertia matrix",
        fit="fit inertia",
        function="cfid.inertia.command:inertia",
        measured_by="six swings or more, about six mounts, with `cfid log encoder`, then `cfid fit inertia RUN ...`",
        aims=("inertia.matrix_kg_m2",),
    ),
    "testbody": Experiment(
        title="Test body",
        fit="fit testbody",
        function="cfid.inertia.command:testbody",
    ),
    "loadcell": Experiment(
        title="Load cell",
        fit="fit loadcell",
        function="cfid.loadcell.command:loadcell",
        judges={"loadcell": "cfid.loadcell.verdict:verdict"},
    ),
    "thrust": Experiment(
        title="Command to thrust",
        fit="fit thrust",
        function="cfid.motors.maps.command:thrust",
        measured_by="`cfid log thrust`, then `cfid fit thrust RUN`",
        aims=("motor.max_thrust_n", "motor.hover_mass_kg"),
    ),
    "rotor": Experiment(
        title="Rotor speed from vibration",
        fit="fit speed",
        function="cfid.motors.maps.command:speed",
    ),
    "speed": Experiment(
        title="Command to rotor speed",
        fit="fit speed",
        function="cfid.motors.maps.command:speed",
        measured_by="`cfid log speed`, then `cfid fit speed RUN`",
        aims=("motor.speed_poly",),
    ),
    "torque": Experiment(
        title="Thrust to torque",
        fit="fit torque",
        function="cfid.motors.maps.command:torque",
        measured_by="`cfid log thrust`, then `cfid fit torque RUN`",
        aims=("motor.torque_poly",),
    ),
    "dynamics": Experiment(
        title="Rotor dynamics",
        fit="fit dynamics",
        function="cfid.motors.rotor.command:dynamics",
    ),
    "tf": Experiment(
        title="Transfer function of motor and rotor",
        fit="tf identify",
        function="cfid.transfer.command:identify",
        measured_by="`cfid log sine`, then `cfid tf identify RUN ...`",
        aims=("tf.time_constant_s",),
    ),
    "latency": Experiment(
        title="Latency of the link",
        fit="tf latency",
        function="cfid.latency.command:latency",
        aims=("latency.rtt_mean_s",),
    ),
    "flight": Experiment(
        title="Flight",
        fit="fit flight",
        function="cfid.flight.command:flight",
    ),
    "drag": Experiment(
        title="Drag",
        fit="fit drag",
        function="cfid.drag.command:drag",
        measured_by="`cfid log wind`, then `cfid fit drag RUN ...`",
        aims=("drag.simple_kg_per_rad",),
    ),
}


def function_at(place: str) -> Callable[..., Any]:
    """Return the function that `module:function` names."""
    module, _, name = place.partition(":")
    function: Callable[..., Any] = getattr(import_module(module), name)
    return function


def judge_of(kind: str) -> Callable[..., Any] | None:
    """Return the function that judges a new run of a kind, imported at its first call; None where none does."""
    places = {kind: place for experiment in EXPERIMENTS.values() for kind, place in experiment.judges.items()}
    return later(*places[kind].split(":")) if kind in places else None
