"""Swings recorded by the vehicle's own gyro, on an axis and on two threads: natural frequency, scale and axis."""

import functools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from cfid.recordings.gyro import SCALE_STD, about_one_axis, integrated
from cfid.records.rig_file import EncoderScale
from cfid.sim.imu import Hanging, Imu, ImuTruth
from cfid.sim.plants import Motion, Pendulum, TwoThreads, swing
from cfid.sim.swing import draw_release
from cfid.swing.estimation import SwingFit, fit_swing
from cfid.swing.pendulum import NO_THREADS, Threads
from cfid.swing.window import FreeSwing, find_swing, swing_in
from tests.recordings.made import made_angle

Array = npt.NDArray[np.float64]

G = 9.81
STEP_S = 1e-3


def gyro_of(
    motion: Motion,
    i: int,
    *,
    rate_hz: float,
    truth: ImuTruth,
    rng: np.random.Generator,
    axis: Sequence[float] | Array = (1.0, 0.0, 0.0),
) -> tuple[Array, Array]:
    """Return a gyro's times (n,) and rates (n, 3) in rad/s for one body of a motion with steps of 1 ms or less."""
    every = round(1 / rate_hz / (motion.time_s[1] - motion.time_s[0]))
    time_s, speed = motion.time_s[::every], motion.speed_rad_per_s[::every, i]
    hanging = Hanging(axis=np.array(axis), down=np.array([0.0, 0.0, -1.0]), sensor_m=np.zeros(3), gravity_mps2=9.81)
    moving = iter(speed.tolist())
    imu = Imu(truth, hanging, lambda _: (0.0, next(moving), 0.0), rng)
    return time_s, np.radians([imu.at(float(at)).gyro_dps for at in time_s])


def gyro_swing(time_s: Array, rates_rad_per_s: Array, threads: Threads = NO_THREADS) -> FreeSwing:
    """Return the swing that a gyro's rates (n, 3) show."""
    found = about_one_axis(rates_rad_per_s)
    angle, bias = integrated(time_s, found.rate_rad_per_s)
    swing = find_swing(time_s, angle)
    rate = found.rate_rad_per_s - bias
    return replace(swing, rate_rad_per_s=rate, rate_scale_std=SCALE_STD, threads=threads)


def usual_gyro(rng: np.random.Generator) -> ImuTruth:
    """Return a gyro with a random bias, and with scale errors that its data sheet allows."""
    x, y, z = rng.normal(0, SCALE_STD, 3).tolist()
    bias = rng.uniform(-1, 1, 3).tolist()
    return ImuTruth(gyro_scale=(x, y, z), gyro_bias_dps=(bias[0], bias[1], bias[2]))


def pendulums(count: int, rng: np.random.Generator) -> list[Pendulum]:
    return [
        Pendulum(
            axis_inertia_kg_m2=rng.uniform(3.1e-5, 7e-5),
            gravity_moment_nm=0.028 * G * rng.uniform(0.0229, 0.038),
            viscous_nms_per_rad=rng.uniform(0.5, 2) * 1.2e-5,
            coulomb_nm=rng.uniform(0.2, 1) * 3e-5,
            quadratic_nms2_per_rad2=rng.uniform(0, 2) * 2e-8,
        )
        for _ in range(count)
    ]


@functools.cache
def swung(degrees: float, count: int, *, seed: int) -> tuple[Motion, Array]:
    """Return the motion of `count` vehicles on an axis, released at one angle, and their true W."""
    rng = np.random.default_rng(seed)
    bodies = pendulums(count, rng)
    releases = [draw_release(rng, angle_deg=(degrees, degrees)) for _ in bodies]
    motion = swing(bodies, releases, duration_s=10.0, step_s=STEP_S, store_every=1)
    return motion, np.array([body.gravity_moment_nm / body.axis_inertia_kg_m2 for body in bodies])


def fits(motion: Motion, *, rate_hz: float, seed: int, threads: Sequence[Threads] = ()) -> list[SwingFit]:
    rng = np.random.default_rng(seed)
    return [
        fit_swing(
            gyro_swing(
                *gyro_of(motion, i, rate_hz=rate_hz, truth=usual_gyro(rng), rng=rng),
                threads[i] if threads else NO_THREADS,
            )
        )
        for i in range(motion.angle_rad.shape[1])
    ]


def relative(found: Sequence[SwingFit], truth: Array) -> tuple[Array, Array]:
    """Return the relative errors of W, and its errors divided by the stated standard uncertainties."""
    values = np.array([fit.coefficients.natural_frequency_squared_s2 for fit in found])
    stds = np.array([fit.std.natural_frequency_squared_s2 for fit in found])
    return values / truth - 1, (values - truth) / stds


@pytest.mark.parametrize(("degrees", "rate_hz", "limit"), [(10, 1000, 2e-4), (70, 1000, 2e-4), (50, 100, 5e-4)])
def test_a_gyro_whose_scale_is_off_gives_w_to_two_ten_thousandths(degrees: float, rate_hz: float, limit: float) -> None:
    motion, truth = swung(degrees, 1, seed=round(degrees))

    errors, scores = relative(fits(motion, rate_hz=rate_hz, seed=3), truth)

    assert np.abs(errors).max() < limit
    assert np.abs(scores).max() < 4
    assert np.abs(errors / scores).max() < limit  # what is stated


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [1000, 100])
@pytest.mark.parametrize("degrees", [10, 20, 35, 50, 70])
def test_intervals_of_gyro_swings_hold_w_93_to_97_times_in_100(degrees: float, rate_hz: float) -> None:
    motion, truth = swung(degrees, 200, seed=round(degrees))

    errors, scores = relative(fits(motion, rate_hz=rate_hz, seed=round(degrees)), truth)

    print(
        f"{degrees} degrees, {rate_hz} Hz: mean {100 * errors.mean():+.5f} %, std {100 * errors.std():.5f} %, largest "
        f"{100 * np.abs(errors).max():.4f} %, within 95 % interval {np.mean(np.abs(scores) < 1.96):.3f}"
    )
    assert np.abs(errors).max() < (2e-4 if rate_hz == 1000 else 5e-4)
    assert np.mean(np.abs(scores) < 1.96) >= 0.9  # each row of 200 scatters; all together are stated


def test_a_large_swing_shows_the_scale_of_the_gyro_and_a_small_one_leaves_what_is_usual() -> None:
    truth = ImuTruth(gyro_scale=(0.02, 0.0, 0.0))
    large, small = (
        fit_swing(gyro_swing(*gyro_of(swung(angle, 1, seed=4)[0], 0, rate_hz=100, truth=truth, rng=rng)))
        for angle, rng in ((50, np.random.default_rng(1)), (10, np.random.default_rng(2)))
    )

    assert large.instrument[0] == pytest.approx(0.02, abs=1e-3)
    assert large.instrument_std[0] < 5e-4
    assert small.instrument_std[0] > 1e-3


@pytest.mark.parametrize(("scale", "named"), [(0.02, False), (0.2, True), (-0.08, True)])
def test_a_gyro_whose_scale_no_sound_one_has_is_named(scale: float, *, named: bool) -> None:
    motion, truth = swung(50, 1, seed=4)
    gyro = ImuTruth(gyro_scale=(scale, 0.0, 0.0))
    found = fit_swing(gyro_swing(*gyro_of(motion, 0, rate_hz=100, truth=gyro, rng=np.random.default_rng(1))))

    assert [one.severity for one in found.findings if one.code == "swing-gyro-scale"] == ["rejection"] * named
    assert named or np.abs(relative([found], truth)[0]).max() < 5e-4


def test_the_axis_is_the_direction_of_what_changes_and_no_bias_turns_it() -> None:
    axis = np.array([1.0, 2.0, -0.5]) / np.sqrt(5.25)
    truth = ImuTruth(gyro_bias_dps=(30.0, -20.0, 10.0))
    motion, _ = swung(40, 1, seed=6)

    found = about_one_axis(gyro_of(motion, 0, rate_hz=100, truth=truth, rng=np.random.default_rng(7), axis=axis)[1])

    assert found.axis == pytest.approx(axis, abs=1e-3)
    assert found.off_axis < 0.01


def on_threads(count: int, rng: np.random.Generator) -> list[TwoThreads]:
    return [
        TwoThreads(
            inertia_kg_m2=rng.uniform(1.5e-5, 3.5e-5),
            mass_kg=0.028,
            gravity_mps2=G,
            above_m=rng.uniform(0.05, 0.1),
            below_m=rng.uniform(0.05, 0.1),
            length_m=rng.uniform(0.3, 0.6),
            viscous_nms_per_rad=rng.uniform(0.5, 2) * 3e-6,
            quadratic_nms2_per_rad2=rng.uniform(0.5, 2) * 2e-7,
        )
        for _ in range(count)
    ]


def of_threads(body: TwoThreads) -> tuple[float, Threads]:
    """Return W = m g a b / (h I) and the ratios of the threads, both from their definitions."""
    a, b = body.above_m / 2, body.below_m / 2
    height = np.sqrt(body.length_m**2 - (a - b) ** 2)
    return body.mass_kg * G * a * b / (height * body.inertia_kg_m2), Threads(a * b / height**2, a * b / (G * height))


def twisted(degrees: float, count: int, *, seed: int) -> tuple[Motion, Array, list[Threads]]:
    rng = np.random.default_rng(seed)
    return let_go(on_threads(count, rng), degrees, rng)


def let_go(bodies: list[TwoThreads], degrees: float, rng: np.random.Generator) -> tuple[Motion, Array, list[Threads]]:
    releases = [draw_release(rng, angle_deg=(degrees, degrees)) for _ in bodies]
    motion = swing(bodies, releases, duration_s=14.0, step_s=2 * STEP_S, store_every=1)
    truth = [of_threads(body) for body in bodies]
    return motion, np.array([w for w, _ in truth]), [threads for _, threads in truth]


def test_an_encoder_over_threads_gives_the_same_and_a_pendulums_equation_does_not() -> None:
    rng = np.random.default_rng(9)
    short = [replace(body, above_m=0.1, below_m=0.1, length_m=0.12) for body in on_threads(1, rng)]
    motion, truth, threads = let_go(short, 60, rng)
    seen = find_swing(motion.time_s[::5], motion.angle_rad[::5, 0])
    right, wrong = (fit_swing(replace(seen, threads=one)) for one in (threads[0], NO_THREADS))

    assert abs(relative([right], truth)[0][0]) < 1e-5
    assert abs(relative([wrong], truth)[0][0]) > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [20, 50])
def test_intervals_of_bodies_on_threads_hold_w_93_to_97_times_in_100(degrees: float) -> None:
    motion, truth, threads = twisted(degrees, 200, seed=round(degrees))

    errors, scores = relative(fits(motion, rate_hz=100, seed=2, threads=threads), truth)

    print(
        f"threads, {degrees} degrees: mean {100 * errors.mean():+.5f} %, std {100 * errors.std():.5f} %, largest "
        f"{100 * np.abs(errors).max():.4f} %, within 95 % interval {np.mean(np.abs(scores) < 1.96):.3f}"
    )
    assert np.abs(errors).max() < 2e-4
    assert np.mean(np.abs(scores) < 1.96) >= 0.9


@pytest.mark.parametrize(("stated", "std"), [(None, 5e-4), (0.01, 0.01)])
def test_a_cable_that_a_gyro_does_not_show_is_in_the_uncertainty(stated: float | None, std: float) -> None:
    motion, _ = swung(50, 1, seed=4)
    time_s, rates = gyro_of(motion, 0, rate_hz=100, truth=ImuTruth(), rng=np.random.default_rng(1))
    found = about_one_axis(rates)
    record = made_angle(time_s, integrated(time_s, found.rate_rad_per_s)[0], rates=found)
    free, tied = (fit_swing(swing_in(record, encoder=EncoderScale(cable_std=one))) for one in (0.0, stated))

    assert np.sqrt(tied.std[0] ** 2 - free.std[0] ** 2) == pytest.approx(std * tied.coefficients[0], rel=1e-3)
