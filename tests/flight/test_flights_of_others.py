"""Public logs of flights: their authors' results, and results that must not depend on details of the fit."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from scipy.ndimage import uniform_filter1d

from cfid.errors import DataError
from cfid.flight.capture import refuse_unlike_gyro, velocity_findings
from cfid.flight.data import FlownLog, read_flight
from cfid.flight.estimation import CrossedError, FlightFit, fit_flights
from cfid.flight.model import PAST, THRUST, TURNS, whitening, without
from cfid.flight.result import fit
from cfid.flight.rows import Flight
from cfid.flight.values import Body
from cfid.recordings.crazyflie import channel
from cfid.recordings.read import read_recording
from tests.lab import DATA
from tests.recordings.made import only

Array = npt.NDArray[np.float64]

FLIGHTS = DATA / "flights"
MASS_KG = 0.027  # stated by all authors
ARM = Body(mass_kg=MASS_KG, mass_std_kg=0.0003, arm_m=0.046, arm_std_m=0.0003)
AUTHORS_LEVER_M = 0.028
# The authors' windows, 35 to 65 s and 55 to 90 s of the logs' own times, counted here from the first row.
LOG10, LOG15 = ("eschmann_log10.usd", 8.76, 39.12), ("eschmann_log15.usd", 15.94, 51.36)
HALVES = (("eschmann_log15.usd", 15.94, 33.6), ("eschmann_log15.usd", 33.6, 51.36))
Windows = tuple[tuple[str, float, float], ...]
OLDER = (2, 3, 4, 5)  # in rows: torques 20 to 50 ms earlier

pytestmark = pytest.mark.skipif(not FLIGHTS.is_dir(), reason="the public flights are not here (CFID_DATA)")


@cache
def read(name: str, from_s: float | None = None, to_s: float | None = None) -> FlownLog:
    return read_flight(FLIGHTS / name, from_s=from_s, to_s=to_s)


@cache
def fitted(*windows: tuple[str, float, float]) -> FlightFit:
    return fit_flights([read(*window).flight for window in windows])


def moments(found: FlightFit) -> Array:
    """Return moments about roll and pitch with the authors' lever."""
    return np.asarray(AUTHORS_LEVER_M * MASS_KG / found.values[TURNS][:2])


def relative_std(found: FlightFit) -> Array:
    return np.asarray((found.std[TURNS] / np.abs(found.values[TURNS]))[:2])


def projected(columns: Array, values: Array) -> Array:
    return np.asarray(columns @ np.linalg.lstsq(columns, values, rcond=None)[0])


def both_directions(found: FlightFit, axis: int) -> tuple[float, float]:
    """Return the gain from torque to acceleration about an axis, from regressions in both directions.

    The instruments are torques of several earlier rows. They outnumber the unknowns, so the two gains may differ.
    """
    torque, shown, older = [], [], []
    for block, _ in found.blocks:
        if block.axis == axis:
            of_one = block.terms @ found.values[THRUST]
            white = whitening(block, without(block.shown - found.values[TURNS][axis] * of_one, block.others))
            both = white.of(np.column_stack([of_one, block.shown]))
            begin = 0
            for length in block.lengths:
                part, begin = both[begin : begin + length - PAST], begin + length - PAST
                older.append(np.column_stack([part[max(OLDER) - rows : len(part) - rows, 0] for rows in OLDER]))
                torque.append(part[max(OLDER) :, 0])
                shown.append(part[max(OLDER) :, 1])
    x, y, z = np.concatenate(torque), np.concatenate(shown), np.concatenate(older)
    forward, backward = projected(z, x), projected(z, y)
    return float((forward @ y) / (forward @ x)), float((backward @ y) / (backward @ x))


def test_one_lag_of_the_climbing_flight_is_its_authors() -> None:
    result = fit([read(*LOG10)], body=ARM)
    single = result.quantities["flight.single_lag_s"]
    print(f"log10: one lag {1e3 * single.value:.1f} +- {1e3 * single.std:.1f} ms")
    assert 0.070 < single.value < 0.078
    assert "flight.rising_s" in result.rejected  # uncertain by more than 10 %, unlike the sum of both lags
    assert "flight.single_lag_s" not in result.rejected


def test_moments_are_the_same_in_both_directions_of_regression() -> None:
    found = fitted(LOG15)
    for axis in (0, 1):
        forward, backward = both_directions(found, axis)
        gain = found.values[TURNS][axis]
        print(f"axis {axis}: apart by {100 * (forward / backward - 1):+.2f} %, fit {100 * (forward / gain - 1):+.2f} %")
        assert forward == pytest.approx(backward, rel=0.01)
        assert forward == pytest.approx(gain, rel=0.01)


def test_what_is_found_does_not_depend_on_units() -> None:
    of_drive, of_force, of_rates = 0.7, 2.0, 1 / 1.5
    flight = read(*HALVES[0]).flight
    scaled = replace(
        flight, command=of_drive * flight.command, force=of_force * flight.force, rates=of_rates * flight.rates
    )
    usual, found = fitted(HALVES[0]), fit_flights([scaled])

    sizes = np.concatenate([np.ones(4), of_force / of_drive ** np.arange(3.0), np.full(3, of_rates / of_force)])
    excited = slice(0, 9)  # yaw is not excited in this flight
    assert found.values[excited] / sizes[excited] == pytest.approx(usual.values[excited], rel=2e-3)
    assert found.std[excited] / sizes[excited] == pytest.approx(usual.std[excited], rel=1e-2)


@pytest.mark.parametrize(
    ("one", "other"),
    [(HALVES[:1], HALVES[1:]), pytest.param((LOG10, LOG15), (LOG15,), marks=pytest.mark.slow)],
    ids=["two halves", "with climbs and without"],
)
def test_windows_of_a_flight_give_the_same_moments_within_their_uncertainty(one: Windows, other: Windows) -> None:
    first, second = fitted(*one), fitted(*other)
    for found in (first, second):
        print(moments(found), f"kg m^2, +- {np.round(100 * relative_std(found), 1)} %")
    for axis in (0, 1):
        apart = float(np.log(moments(first)[axis] / moments(second)[axis]))
        assert abs(apart) < 2 * float(np.hypot(relative_std(first)[axis], relative_std(second)[axis]))


def test_circles_and_helices_give_drag_and_refuse_the_rest() -> None:
    names = ("nanobench_B2_circle_fast_rep2.csv", "nanobench_B5_helix_fast_rep1.csv")
    result = fit([read(name) for name in names], body=ARM)
    rejections = {finding.code for finding in result.findings if finding.severity == "rejection"}
    assert "flight-thrust-not-excited" in rejections
    assert not any("inertia" in key or "thrust" in key for key in result.without_rejected().quantities)
    assert result.accepted
    for axis in ("forward", "left"):
        one = result.quantities[f"flight.drag_over_mass_per_s.{axis}"]
        print(f"{axis}: {one.value:.3f} +- {one.std:.3f} 1/s")
        assert one.value - 1.96 * one.std < 0.42
        assert one.value + 1.96 * one.std > 0.39
        assert one.std < 0.02


@pytest.mark.parametrize(
    ("arm_m", "kept"),
    [(0.0046, False), (0.028, True), pytest.param(0.046, True, marks=pytest.mark.slow), (0.46, False)],
)
def test_a_moment_that_no_quadrocopter_with_such_an_arm_has_is_rejected(arm_m: float, *, kept: bool) -> None:
    result = fit([read(*HALVES[0])], body=replace(ARM, arm_m=arm_m))
    for axis in ("roll", "pitch"):
        assert (f"flight.inertia_kg_m2.{axis}" not in result.rejected) is kept
    assert ("flight-moment-unlike-arm" in [one.code for one in result.findings]) is not kept


def turned(values: Array, degrees: float) -> Array:
    """Return vectors (n, 3) as shown by axes that are turned about the vertical."""
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.asarray(values @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1.0]]).T)


CROSSED: dict[str, Callable[[Flight], Flight]] = {
    "turned": lambda one: replace(one, rates=turned(one.rates, -45)),
    "exchanged axes": lambda one: replace(one, rates=one.rates[:, [1, 0, 2]]),
    "exchanged motors": lambda one: replace(one, command=one.command[:, [1, 0, 2, 3]]),
}


@pytest.mark.parametrize("defect", CROSSED)
def test_axes_and_motors_that_no_vehicle_has_are_refused(defect: str) -> None:
    flown = read(*HALVES[0])
    with pytest.raises(CrossedError):
        fit([replace(flown, flight=CROSSED[defect](flown.flight))], body=ARM)


def test_a_smoothed_gyro_costs_moments_and_lags() -> None:
    flown = read(*HALVES[0])
    smoothed = replace(flown.flight, rates=np.asarray(uniform_filter1d(flown.flight.rates, 5, axis=0)))
    result = fit([replace(flown, flight=smoothed)], body=ARM)
    assert "flight-torques-contradict" in {one.code for one in result.findings if one.severity == "rejection"}
    assert {"flight.inertia_kg_m2.roll", "flight.rising_s", "flight.single_lag_s"} <= set(result.rejected)


CIRCLE, HELIX = "nanobench_B2_circle_fast_rep2.csv", "nanobench_B5_helix_fast_rep1.csv"
UNLIKE_ATTITUDE: dict[str, Callable[[Flight], Flight]] = {
    "roll the other way": lambda one: replace(one, rates=one.rates * [-1, 1, 1]),
    "z down": lambda one: replace(one, rates=one.rates * [1, -1, -1]),
    "exchanged": lambda one: replace(one, rates=one.rates[:, [1, 0, 2]]),
    "in deg/s": lambda one: replace(one, rates=np.degrees(one.rates)),
    "from the world to the vehicle": lambda one: replace(one, attitude=np.asarray(one.attitude) * [1, -1, -1, -1]),
}
MOVED: dict[str, Callable[[Flight], Flight]] = {
    "mm/s": lambda one: replace(one, velocity=1000 * np.asarray(one.velocity)),
    "half": lambda one: replace(one, velocity=np.asarray(one.velocity) / 2),
    "attitude stuck": lambda one: replace(one, attitude=np.asarray(one.attitude) * 0 + [1, 0, 0, 0]),
}


@pytest.mark.parametrize("log", [CIRCLE, HELIX])
def test_motion_capture_that_moves_otherwise_than_the_sensors_is_found(log: str) -> None:
    flight = read(log).flight
    path = FLIGHTS / log
    refuse_unlike_gyro(path, flight)
    assert not velocity_findings(flight)
    for change in UNLIKE_ATTITUDE.values():
        with pytest.raises(DataError) as refused:
            refuse_unlike_gyro(path, change(flight))
        assert refused.value.code == "gyro-unlike-attitude"
    for change in MOVED.values():
        refuse_unlike_gyro(path, change(flight))
        assert [one.code for one in velocity_findings(change(flight))] == ["flight-velocity-unlike-force"]


def test_a_wrong_scale_of_the_accelerometer_costs_moments_or_is_a_warning() -> None:
    flown = read(*HALVES[0])
    for scale, severity in ((0.7, "rejection"), (2.0, "warning")):
        result = fit([replace(flown, flight=replace(flown.flight, force=scale * flown.flight.force))], body=ARM)
        assert [one.severity for one in result.findings if one.code == "flight-weight-unlike"] == [severity]
        assert ("flight.inertia_kg_m2.roll" in result.rejected) is (severity == "rejection")


def test_delays_of_the_gyro_are_those_of_its_filter_and_more_in_every_flight() -> None:
    delays = [float(fitted(one).values[3]) for one in (LOG15, *HALVES)]
    assert min(delays) > 0.003  # the low-pass filter of 80 Hz alone is 2.8 ms
    assert max(delays) - min(delays) < 0.001


def test_a_flight_as_two_formats_is_one(tmp_path: Path) -> None:
    log = read_recording(FLIGHTS / LOG15[0])
    copy = tmp_path / "copy.csv"
    series = only(log)
    keys = ["motor.m1", "motor.m2", "motor.m3", "motor.m4", "acc.x", "acc.y", "acc.z", "gyro.x", "gyro.y", "gyro.z"]
    units = [*[1.0] * 4, *[9.81] * 3, *[np.pi / 180] * 3]
    columns = {key: channel(log, key).value / unit for key, unit in zip(keys, units, strict=True)}
    pd.DataFrame({"t_s": series.time_s, **columns}).to_csv(copy, index=False)
    with pytest.raises(DataError, match=r"the same flight as eschmann_log15\.usd"):
        fit([read(*LOG15), read_flight(copy, from_s=LOG15[1], to_s=LOG15[2])], body=ARM)
