"""Unusable recordings: each fault is reported during the recording, or by the verdict at its end."""

import functools
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from cfid.sim.plants import HandRelease, Pendulum, swing
from tests.virtual_bench import Bench, bench_in
from tests.virtual_lab import lab_in

Array = npt.NDArray[np.float64]

STAIRS = ("thrust", "--from", 20000, "--to", 32000, "--step", 4000, "--hold", 3, "--rest", 1, "--yes")
SINE = ("sine", "--hz", 20, "--for", 2, "--yes")
RELEASED_S = 2.0


@functools.cache
def pendulum() -> tuple[Array, Array]:
    """Return time and angle of a swing that is released at 40 degrees after some two seconds."""
    body = Pendulum(axis_inertia_kg_m2=3e-5, gravity_moment_nm=6.3e-3, viscous_nms_per_rad=4e-6, coulomb_nm=3e-6)
    hand = HandRelease(angle_rad=math.radians(40), wait_s=1.0)
    found = swing([body], [hand], duration_s=16.0)
    return found.time_s, found.angle_rad[:, 0]


def held(time_s: Array, angle_rad: Array) -> Array:
    return np.full_like(angle_rad, 0.01)


def striking(time_s: Array, angle_rad: Array) -> Array:
    """Return the angle of the same pendulum that bounces off a stop at -0.35 rad with half its speed."""
    step_s, angle, speed, found = 1e-4, float(angle_rad.max()), 0.0, []
    for _ in np.arange(0, time_s[-1], step_s):
        speed -= step_s * (210 * math.sin(angle) + 0.13 * speed)
        angle += step_s * speed
        if angle < -0.35 and speed < 0:
            angle, speed = -0.35, -speed / 2
        found.append(angle)
    return np.interp(time_s - 1.0, step_s * np.arange(len(found)), found)


def frozen(time_s: Array, angle_rad: Array) -> Array:
    return np.where(time_s < 4.0, angle_rad, angle_rad[np.searchsorted(time_s, 4.0)])


@pytest.mark.parametrize(
    ("label", "spoil", "lasts_s", "verdict"),
    [
        (("--axis", "x"), striking, 14, "differs from a pendulum"),
        (("--axis", "x"), frozen, 14, "does not change in the last"),
        (("--weight", 20), held, 8, ""),
    ],
)
def test_a_spoilt_angle_is_named(
    tmp_path: Path,
    label: tuple[object, ...],
    spoil: Callable[[Array, Array], Array],
    lasts_s: float,
    verdict: str,
) -> None:
    time_s, angle_rad = pendulum()
    angle_rad = spoil(time_s, angle_rad)
    with lab_in(tmp_path) as lab:
        begin_s = lab.hardware.seconds() + RELEASED_S
        lab.e201._angle_at = lambda now_s: float(np.interp(now_s - begin_s, time_s, angle_rad))
        said = lab.cfid("log", "encoder", *label, "--for", lasts_s, "--json")
    found = json.loads(said.out)["verdict"]

    assert not found["usable"]
    assert verdict in found["text"]


def scaled(*factors: float) -> Callable[[Bench], None]:
    """Return a function that multiplies the load on each axis of the load cell by its factor."""

    def spoil(bench: Bench) -> None:
        cell = bench.rig.loadcell.box.load_cell
        read = cell.read
        cell.read = lambda time_s, wrench: read(time_s, np.array(factors) * wrench)  # type: ignore[method-assign]

    return spoil


def overload(bench: Bench) -> None:
    bench.rig.loadcell.box.load_cell.overload()


def empty(bench: Bench) -> None:
    bench.vehicle_suffers(low_battery_after_s=0)


@pytest.mark.parametrize(
    ("words", "spoil", "during", "verdict"),
    [
        (STAIRS, scaled(1, 1, 0, 1, 1, 1), "no thrust is felt at command 20000", "no motor is felt"),
        (STAIRS, overload, "saturation", "saturation"),
        (SINE, scaled(0, 0, 0, 0, 0, 0), "", "does not measure it"),
        (STAIRS, empty, "2.90 V", "2.90 V"),
    ],
    ids=["a dead axis", "a cell beyond its range", "a sine not felt", "an empty battery"],
)
def test_a_fault_beside_running_motors_is_named_and_they_stop(
    tmp_path: Path,
    words: tuple[object, ...],
    spoil: Callable[[Bench], None],
    during: str,
    verdict: str,
) -> None:
    with bench_in(tmp_path) as bench:
        pilot = bench.start("log", *words, "--json")
        pilot.wait_until_motors_run(0.0)
        spoil(bench)
        pilot.end()
        found = bench.run().header.verdict

    assert not any(bench.motors)
    assert during in pilot.err
    assert found is not None
    assert verdict in found.text
