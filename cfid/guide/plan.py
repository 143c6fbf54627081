"""What each kind of campaign records and fits, in order, and how certain its results should be."""

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

from cfid.records.rig_file import CampaignKind, Rig
from cfid.records.run import Label
from cfid.wire.app import MIDDLE

Words = tuple[str, ...]

_WEIGHTS_G = (20, 30, 40)
_WINDS = 6
_ABOVE_IDLE: Words = ("--from", "8000", "--motor", "1,2,3,4")  # for a Brushless: unused rotors idle at 7000, and pull


@dataclass(frozen=True, kw_only=True)
class Aim:
    """A quantity, and the relative standard uncertainty that its purpose requires.

    A polynomial is judged where it is used: by the sum of its numbers times `weights`, a function of their count. Its
    coefficients alone do not show how certain its values are.
    """

    key: str
    std: float
    purpose: str
    weights: Callable[[int], Sequence[float]] | None = None


@dataclass(frozen=True, kw_only=True)
class Assignment:
    """A run to record: the words of the command, what to do at the rig first, and the label that identifies the run.

    `questions` are asked first, and the answers replace words in braces. `kind` may be the beginning of a run's kind.
    A recording that `repeats` another one shows the drift between the two, and no fit needs it. `completes` is the name
    of a run that ended early, whose rest this recording is.
    """

    words: Words
    reminder: str
    kind: str
    label: Label = field(default_factory=Label)
    questions: Mapping[str, str] | None = None
    repeats: bool = False
    completes: str = ""

    @property
    def command(self) -> str:
        """The command as it is shown, with a word in capitals for the answer to each question."""
        blanks = {name: name.upper().replace("_", "-") for name in self.questions or {}}
        return f"cfid {' '.join(word.format(**blanks) for word in self.words)}"

    def is_of(self, kind: str, label: Label) -> bool:
        """Return whether a run of a kind with a label is this recording or a repetition of it."""
        same = (self.label.axis, self.label.weight_g) == (label.axis, label.weight_g)
        return kind.partition("_")[0] == self.kind and same and is_vehicle(label)


def is_vehicle(label: Label) -> bool:
    """Return whether a run is of the vehicle, not of another body on its mounts."""
    return (label.body or "crazyflie") == "crazyflie"


@dataclass(frozen=True, kw_only=True)
class Task:
    """One fit: its section of parameters.toml, the runs that it uses, its command and what it should find."""

    section: str
    recordings: tuple[Assignment, ...]
    fit: Words
    aims: tuple[Aim, ...]


def tasks(
    rig: Rig, *, kind: CampaignKind | None = None, order: str = "", swung: Sequence[str] = (), by_gyro: bool = False
) -> tuple[Task, ...]:
    """Return a campaign's tasks; `kind` replaces that of rig.toml.

    The vehicle's gyro records swings on threads, which have no encoder, and all swings if it already recorded some
    (`by_gyro`).

    The mounts already `swung` come first, in their order, then the others in a random order with the seed `order`, so
    that no drift over the day looks like a difference between axes. The first mount is swung once more at the end, and
    any difference is then a drift.
    """
    every = {
        "inertia": _inertia(rig, _mounts(rig, order, swung), by_gyro=by_gyro),
        "friction": _friction(rig),
        "thrust": _thrust(rig),
        "torque": _torque(rig),
        "speed": _speed(rig),
        "latency": _latency(),
        "tf": _transfer(),
        "drag": _drag(),
    }
    sections: Mapping[CampaignKind, Sequence[str]] = {
        "full": tuple(every),
        "inertia": ("inertia", "friction"),
        "motors": ("thrust", "torque", "speed", "latency", "tf"),
        "afternoon": ("inertia", "thrust", "torque"),
    }
    return tuple(every[name] for name in sections[kind or rig.campaign.kind] if every[name].recordings)


def _mounts(rig: Rig, order: str, swung: Sequence[str]) -> list[str]:
    left = sorted(rig.mounts)
    random.Random(order).shuffle(left)
    first = [mount for mount in dict.fromkeys(swung) if mount in rig.mounts]
    return [*first, *(mount for mount in left if mount not in first)]


def _inertia(rig: Rig, mounts: Sequence[str], *, by_gyro: bool) -> Task:
    swings = tuple(
        _swing(mount, rig, by_gyro=by_gyro, repeats=place == len(mounts))
        for place, mount in enumerate((*mounts, *mounts[:1]))
    )
    aim = Aim(key="inertia.matrix_kg_m2", std=0.03, purpose="a rate controller's gains: 3 %")
    return Task(section="inertia", recordings=swings, fit=("fit", "inertia"), aims=(aim,))


def _swing(mount: str, rig: Rig, *, by_gyro: bool, repeats: bool) -> Assignment:
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


def _friction(rig: Rig) -> Task:
    drops = tuple(
        Assignment(
            words=("log", "encoder", "--weight", str(grams), "--for", "20"),
            reminder=f"Wind the line around the axis in one layer, hang {grams} g on it, and start; then let it go.",
            kind="drop",
            label=Label(weight_g=grams),
        )
        for grams in _WEIGHTS_G
    )
    aim = Aim(key="friction.viscous_nms_per_rad", std=0.2, purpose="how swings decay: 20 %")
    recordings = drops if rig.friction is not None else ()
    return Task(section="friction", recordings=recordings, fit=("fit", "friction"), aims=(aim,))


def _thrust(rig: Rig) -> Task:
    aims = (
        Aim(key="motor.max_thrust_n", std=0.03, purpose="the limit of a mixer: 3 %"),
        Aim(key="motor.hover_mass_kg", std=0.02, purpose="the command that hovers: 2 %"),
    )
    return Task(section="thrust", recordings=(_forces(rig),), fit=("fit", "thrust"), aims=aims)


def _torque(rig: Rig) -> Task:
    weights = partial(slope_at_hover, rig=rig)
    aim = Aim(key="motor.torque_poly", std=0.05, purpose="yaw in a simulator, in hover: 5 %", weights=weights)
    recordings = () if _is_brushless(rig) else (_forces(rig),)  # the torques of its four rotors cancel
    return Task(section="torque", recordings=recordings, fit=("fit", "torque"), aims=(aim,))


def slope_at_hover(count: int, rig: Rig) -> list[float]:
    """Return weights by which the coefficients of a thrust polynomial, highest power first, sum to its hover slope."""
    thrust_n = rig.vehicle.mass_kg * rig.site.gravity_mps2 / 4
    return [power * thrust_n ** max(power - 1, 0) for power in reversed(range(count))]


def _speed(rig: Rig) -> Task:
    aim = Aim(key="motor.speed_poly", std=0.02, purpose="rotors in a simulator: 2 %", weights=at_middle)
    words: Words = ("log", "speed")
    reminder = "Point the tachometer at rotor 1, with its strips on, a full battery in."
    if _is_brushless(rig):
        words = (*words, "--tachometer", "brushless", *_ABOVE_IDLE)
        reminder = "Fasten the vehicle, propellers on, a full battery in."
    staircase = Assignment(words=words, reminder=reminder, kind="speed")
    return Task(section="speed", recordings=(staircase,), fit=("fit", "speed"), aims=(aim,))


def at_middle(count: int) -> list[float]:
    """Return weights by which coefficients of a command polynomial, highest power first, give its value at MIDDLE."""
    return [MIDDLE**power for power in reversed(range(count))]


def _forces(rig: Rig) -> Assignment:
    reminder = "Fasten the vehicle on the load cell, propellers on, a full battery in."
    words = ("log", "thrust", *(_ABOVE_IDLE if _is_brushless(rig) else ()))
    return Assignment(words=words, reminder=reminder, kind="thrust")


def _is_brushless(rig: Rig) -> bool:
    return rig.vehicle.platform == "cf21bl"


def _latency() -> Task:
    reminder = "Switch the vehicle on; no motor turns."
    pings = Assignment(words=("log", "ping"), reminder=reminder, kind="ping")
    aim = Aim(key="latency.rtt_mean_s", std=0.05, purpose="a delay in the loop: 5 %")
    return Task(section="latency", recordings=(pings,), fit=("tf", "latency"), aims=(aim,))


def _transfer() -> Task:
    reminder = "Fasten the vehicle on the load cell, the propellers on, a full battery in."
    sines = Assignment(words=("log", "sine"), reminder=reminder, kind="sine")
    aim = Aim(key="tf.time_constant_s", std=0.05, purpose="an attitude controller's bandwidth: 5 %")
    return Task(section="tf", recordings=(sines,), fit=("tf", "identify"), aims=(aim,))


def _drag() -> Task:
    still = Assignment(
        words=("log", "wind", "--wind", "0,0"),
        reminder="Fasten the vehicle on the load cell as it will stand in the wind; no wind blows.",
        kind="wind",
    )
    windy = Assignment(
        words=("log", "wind", "--angle", "{angle}", "--fan-voltage", "{volts}", "--wind", "{wind}"),
        reminder="Set the wind generator to another angle or voltage, and measure the wind at the vehicle.",
        kind="wind",
        questions={
            "angle": "Angle of the generator to the vertical, in degrees",
            "volts": "Voltage at its fan",
            "wind": "Lowest and highest wind in m/s, as 2.0,3.7",
        },
    )
    aim = Aim(key="drag.simple_kg_per_rad", std=0.2, purpose="a simulator at 3 m/s: 20 %")
    return Task(section="drag", recordings=(still, *[windy] * _WINDS), fit=("fit", "drag"), aims=(aim,))
