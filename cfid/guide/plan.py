"""What each kind of campaign records and fits, in order, and how certain its results should be."""

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from cfid.experiments import EXPERIMENTS
from cfid.records.rig_file import CampaignKind, Rig
from cfid.records.run import Label, RunHeader

Words = tuple[str, ...]

KINDS: Mapping[CampaignKind, tuple[str, ...]] = {
    "full": ("inertia", "friction", "thrust", "torque", "speed", "latency", "tf", "drag"),
    "inertia": ("inertia", "friction"),
    "motors": ("thrust", "torque", "speed", "latency", "tf"),
    "afternoon": ("inertia", "thrust", "torque"),
}

_WEIGHTS_G = (20, 30, 40)
_WINDS = 6
_ABOVE_IDLE: Words = ("--from", "8000", "--motor", "1,2,3,4")  # for a Brushless: unused rotors idle at 7000, and pull


@dataclass(frozen=True, kw_only=True)
class Assignment:
    """A run to record: the words of the command, what to do at the rig first, and the label that identifies the run.

    `questions` are asked first, and the answers replace words in braces. A recording that `repeats` another one shows
    the drift between the two, and no fit needs it.
    """

    words: Words
    reminder: str
    kind: str
    label: Label = field(default_factory=Label)
    questions: Mapping[str, str] | None = None
    repeats: bool = False

    @property
    def command(self) -> str:
        """The command as it is shown, with a word in capitals for the answer to each question."""
        blanks = {name: name.upper().replace("_", "-") for name in self.questions or {}}
        return f"cfid {' '.join(word.format(**blanks) for word in self.words)}"

    def is_of(self, header: RunHeader) -> bool:
        """Return whether a run is this recording or a repetition of it."""
        same = (self.label.axis, self.label.weight_g) == (header.label.axis, header.label.weight_g)
        return header.family == self.kind and same and is_vehicle(header.label)


def is_vehicle(label: Label) -> bool:
    """Return whether a run is of the vehicle, not of another body on its mounts."""
    return (label.body or "crazyflie") == "crazyflie"


@dataclass(frozen=True, kw_only=True)
class Task:
    """One fit: its section, the runs that it uses, its command and the keys of the quantities that it should find."""

    section: str
    recordings: tuple[Assignment, ...]
    fit: Words
    aims: tuple[str, ...]


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
    brushless = rig.vehicle.platform == "cf21bl"
    forces = Assignment(
        words=("log", "thrust", *(_ABOVE_IDLE if brushless else ())),
        reminder="Fasten the vehicle on the load cell, propellers on, a full battery in.",
        kind="thrust",
    )
    recordings: Mapping[str, tuple[Assignment, ...]] = {
        "inertia": (
            *(_swing(mount, rig, by_gyro=by_gyro) for mount in mounts),
            *(_swing(mount, rig, by_gyro=by_gyro, repeats=True) for mount in mounts[:1]),
        ),
        "friction": tuple(map(_drop, _WEIGHTS_G)) if rig.friction is not None else (),
        "thrust": (forces,),
        "torque": () if brushless else (forces,),  # the torques of its four rotors cancel
        "speed": (_SPEED_OF_BRUSHLESS if brushless else _SPEED,),
        "latency": (_PINGS,),
        "tf": (_SINES,),
        "drag": (_STILL, *[_WINDY] * _WINDS),
    }
    return tuple(
        Task(
            section=name,
            recordings=recordings[name],
            fit=tuple(EXPERIMENTS[name].fit.split()),
            aims=EXPERIMENTS[name].aims,
        )
        for name in KINDS[kind or rig.campaign.kind]
        if recordings[name]
    )


def _swing(mount: str, rig: Rig, *, by_gyro: bool, repeats: bool = False) -> Assignment:
    words: Words = ("log", "encoder", "--axis", mount, "--for", "20")
    reminder = f"Hang the vehicle on mount {mount}, let it rest, and start; then lift it and let go within 5 s."
    if rig.mounts[mount].threads is not None:
        words = ("log", "gyro", "--axis", mount, "--for", "30")
        reminder = (
            f"Hang the vehicle on the threads of mount {mount}, turn it on, let it rest, and start; then turn it by 30 "
            "to 60 degrees and let go within 5 s."
        )
    elif by_gyro:
        words = ("log", "gyro", "--axis", mount, "--for", "30")
        reminder = f"Turn it on. {reminder}"
    return Assignment(words=words, reminder=reminder, kind="swing", label=Label(axis=mount), repeats=repeats)


def _drop(grams: int) -> Assignment:
    return Assignment(
        words=("log", "encoder", "--weight", str(grams), "--for", "20"),
        reminder=f"Wind the line around the axis in one layer, hang {grams} g on it, and start; then let it go.",
        kind="drop",
        label=Label(weight_g=grams),
    )


_SPEED = Assignment(
    words=("log", "speed"),
    reminder="Point the tachometer at rotor 1, with its strips on, a full battery in.",
    kind="speed",
)
_SPEED_OF_BRUSHLESS = Assignment(
    words=("log", "speed", "--tachometer", "brushless", *_ABOVE_IDLE),
    reminder="Fasten the vehicle, propellers on, a full battery in.",
    kind="speed",
)
_PINGS = Assignment(words=("log", "ping"), reminder="Switch the vehicle on; no motor turns.", kind="ping")
_SINES = Assignment(
    words=("log", "sine"),
    reminder="Fasten the vehicle on the load cell, the propellers on, a full battery in.",
    kind="sine",
)
_STILL = Assignment(
    words=("log", "wind", "--wind", "0,0"),
    reminder="Fasten the vehicle on the load cell as it will stand in the wind; no wind blows.",
    kind="wind",
)
_WINDY = Assignment(
    words=("log", "wind", "--angle", "{angle}", "--fan-voltage", "{volts}", "--wind", "{wind}"),
    reminder="Set the wind generator to another angle or voltage, and measure the wind at the vehicle.",
    kind="wind",
    questions={
        "angle": "Angle of the generator to the vertical, in degrees",
        "volts": "Voltage at its fan",
        "wind": "Lowest and highest wind in m/s, as 2.0,3.7",
    },
)
