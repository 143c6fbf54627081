"""What each kind of campaign records and fits, in order, and how certain its results should be."""

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from cfid.experiments import EXPERIMENTS
from cfid.records.rig_file import CampaignKind, Rig
from cfid.records.run import Label, RunHeader

Words = tuple[str, ...]

KINDS: Mapping[CampaignKind, tuple[str, ...]] = {
    "full": ("inertia", "friction", "thrust", "torque", "speed", "latency", "tf", "drag"),
    "inertia": ("inertia", "friction"),
    "motors": ("thrust", "torque", "speed", "latency", "tf"),
    "afternoon": ("inertia", "thrust", "torque"),
    "owner": ("inertia", "thrust"),
}


@dataclass(frozen=True, kw_only=True)
class Assignment:
    """A run to record: the words of the command, what to do at the rig first, and the label that identifies the run.

    `questions` are asked first, and the answers replace words in braces. A recording that `repeats` another one shows
    the drift between the two, and no fit needs it. A run of the kind `instead` is as good.
    """

    words: Words
    reminder: str
    kind: str
    label: Label = field(default_factory=Label)
    questions: Mapping[str, str] | None = None
    repeats: bool = False
    instead: str = ""

    @property
    def command(self) -> str:
        """The command as it is shown, with a word in capitals for the answer to each question."""
        blanks = {name: name.upper().replace("_", "-") for name in self.questions or {}}
        return f"cfid {' '.join(word.format(**blanks) for word in self.words)}"

    def is_of(self, header: RunHeader) -> bool:
        """Return whether a run is this recording or a repetition of it."""
        same = (self.label.axis, self.label.weight_g) == (header.label.axis, header.label.weight_g)
        return header.family in (self.kind, self.instead) and same and is_vehicle(header.label)


def is_vehicle(label: Label) -> bool:
    """Return whether a run is of the vehicle, not of another body on its mounts."""
    return (label.body or "crazyflie") == "crazyflie"


@dataclass(frozen=True, kw_only=True)
class Task:
    """One fit: its section, the runs that it uses, its command and the keys of the quantities that it should find.

    The fit also takes runs of the kinds `besides`, together with those of its own.
    """

    section: str
    recordings: tuple[Assignment, ...]
    fit: Words
    aims: tuple[str, ...]
    besides: tuple[str, ...] = ()


def _motors_run(command: str, reminder: str, *, questions: Mapping[str, str] | None = None) -> Assignment:
    """Return a recording without a label, whose kind of run is the second word of its command."""
    words = tuple(command.split())
    return Assignment(words=words, reminder=reminder, kind=words[1], questions=questions)


# A Brushless starts above 7000, at which its unused rotors idle, and pull.
_ABOVE_IDLE = "--from 8000 --motor 1,2,3,4"
_FASTENED = "Fasten the vehicle on the load cell, propellers on, a full battery in."
_WIND_QUESTIONS = {
    "angle": "Angle of the generator to the vertical, in degrees",
    "volts": "Voltage at its fan",
    "wind": "Lowest and highest wind in m/s, as 2.0,3.7",
}
_STILL_AIR = _motors_run(
    "log wind --wind 0,0", "Fasten the vehicle on the load cell as it will stand in the wind; no wind blows."
)
_WIND = _motors_run(
    "log wind --angle {angle} --fan-voltage {volts} --wind {wind}",
    "Set the wind generator to another angle or voltage, and measure the wind at the vehicle.",
    questions=_WIND_QUESTIONS,
)
_MOTORS: Mapping[str, tuple[Assignment, ...]] = {
    "thrust": (replace(_motors_run("log thrust", _FASTENED), instead="scales"),),
    "torque": (_motors_run("log thrust", _FASTENED),),
    "speed": (
        _motors_run("log speed", "Point the tachometer at rotor 1, with its strips on, a full battery in."),
    ),
    "latency": (_motors_run("log ping", "Switch the vehicle on; no motor turns."),),
    "tf": (_motors_run("log sine", _FASTENED),),
    "drag": (_STILL_AIR, *[_WIND] * 6),
}  # fmt: skip
_ON_SCALES = Assignment(
    words=("log", "scales", "--motor", "1,2,3,4"),
    reminder="Fix the vehicle on a heavy block on the scales, propellers on, a full battery in.",
    kind="scales",
    instead="thrust",
)
_BRUSHLESS: Mapping[str, tuple[Assignment, ...]] = {
    "thrust": (_motors_run(f"log thrust {_ABOVE_IDLE}", _FASTENED),),
    "torque": (),  # the torques of its four rotors cancel
    "speed": (
        _motors_run(
            f"log speed --tachometer brushless {_ABOVE_IDLE}", "Fasten the vehicle, propellers on, a full battery in."
        ),
    ),
}
_DROPS = tuple(
    Assignment(
        words=("log", "encoder", "--weight", f"{grams}:0.03", "--for", "20"),  # as scales of 0.1 g show
        reminder=f"Wind the line around the axis in one layer, hang {grams} g on it, and start; then let it go.",
        kind="drop",
        label=Label(weight_g=grams),
    )
    for grams in (20, 30, 40)
)


def tasks(
    rig: Rig, *, kind: CampaignKind | None = None, swung: Sequence[str] = (), by_gyro: bool = False
) -> tuple[Task, ...]:
    """Return a campaign's tasks; `kind` replaces that of rig.toml.

    The vehicle's gyro records swings on threads, which have no encoder, and all swings if it already recorded some
    (`by_gyro`). The mounts already `swung` come first, in their order, then the others in a random order, whose seed is
    in rig.toml, so that no drift over the day looks like a difference between axes. The first mount is swung once more
    at the end, and any difference is then a drift.
    """
    mounts = sorted(rig.mounts)
    random.Random(rig.campaign.seed).shuffle(mounts)
    mounts = list(dict.fromkeys((*(mount for mount in swung if mount in rig.mounts), *mounts)))
    recordings: Mapping[str, tuple[Assignment, ...]] = {
        "inertia": (
            *(_swing(mount, rig, by_gyro=by_gyro) for mount in mounts),
            *(_swing(mount, rig, by_gyro=by_gyro, repeats=True) for mount in mounts[:1]),
        ),
        "friction": _DROPS if rig.friction is not None else (),
        **_MOTORS,
        **(_BRUSHLESS if rig.vehicle.platform == "cf21bl" else {}),
        **({"thrust": (_ON_SCALES,)} if (kind or rig.campaign.kind) == "owner" else {}),
    }
    return tuple(
        Task(
            section=name,
            recordings=recordings[name],
            fit=tuple(EXPERIMENTS[name].fit.split()),
            aims=EXPERIMENTS[name].aims,
            besides=("speed",) if recordings[name] == _MOTORS["thrust"] else (),
        )
        for name in KINDS[kind or rig.campaign.kind]
        if recordings[name]
    )


def _swing(mount: str, rig: Rig, *, by_gyro: bool, repeats: bool = False) -> Assignment:
    words: Words = ("log", "encoder", "--axis", mount, "--for", "20")
    reminder = f"Hang the vehicle on mount {mount}, let it rest, and start; then lift it and let go within 5 s."
    if rig.mounts[mount].threads is not None or by_gyro:
        words = ("log", "gyro", "--axis", mount, "--for", "30")
        reminder = f"Turn it on. {reminder}"
    if rig.mounts[mount].threads is not None:
        reminder = (
            f"Hang the vehicle on the threads of mount {mount}, turn it on, let it rest, and start; then turn it by 30 "
            "to 60 degrees and let go within 5 s."
        )
    if repeats:
        reminder = f"The first mount once more, which shows what drifted since: {reminder[0].lower()}{reminder[1:]}"
    return Assignment(words=words, reminder=reminder, kind="swing", label=Label(axis=mount), repeats=repeats)
