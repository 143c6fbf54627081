"""The documented accuracy of a swing fit, over many simulated hands, encoders and releases."""

import functools
import math
from typing import Literal

import numpy as np
import numpy.typing as npt
import pytest

from cfid.sim.plants import Motion, Pendulum, swing
from cfid.sim.swing import draw_release
from cfid.swing.estimation import fit_swing
from cfid.swing.window import find_swing
from cfid.wire.rls import decode_words
from tests.offline.encoder import EncoderModel, record

Array = npt.NDArray[np.float64]

Word = float | Literal["rls-13bit-in-22"]

FINE = float(1 << 22)
COARSE: Literal["rls-13bit-in-22"] = "rls-13bit-in-22"
RELEASES_DEG = (10.0, 20.0, 35.0, 50.0, 70.0)
PEAKS = (4, 8, 14)
DURATION_S = 10.0


@functools.cache
def plants(degrees: float, count: int) -> tuple[Motion, Array]:
    """Return the motion of `count` different vehicles released at one angle, and their true W."""
    rng = np.random.default_rng(round(degrees))
    inertia = rng.uniform(3.1e-5, 7e-5, count)
    moment = 0.028 * 9.81 * rng.uniform(0.0229, 0.038, count)
    pendulums = [
        Pendulum(
            axis_inertia_kg_m2=inertia[i],
            gravity_moment_nm=moment[i],
            viscous_nms_per_rad=rng.uniform(0.5, 2) * 1.2e-5,
            coulomb_nm=rng.uniform(0.2, 1) * 3e-5,
            quadratic_nms2_per_rad2=rng.uniform(0, 2) * 2e-8,
            rest_rad=rng.uniform(-0.2, 0.2),
        )
        for i in range(count)
    ]
    releases = [draw_release(rng, angle_deg=(degrees, degrees)) for _ in range(count)]
    return swing(pendulums, releases, duration_s=DURATION_S, step_s=1e-3, store_every=2), moment / inertia


def polled(motion: Motion, i: int, *, word: Word, stamp_s: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return one encoder record, whose stamps are up to twice `stamp_s` late, as on a busy host."""
    encoder = EncoderModel(word=word, offset_rad=rng.uniform(0, 2 * math.pi), stamp_error_s=0.0)
    recorded = record(
        motion.time_s, motion.angle_rad[:, i], speed_rad_per_s=motion.speed_rad_per_s[:, i], encoder=encoder, rng=rng
    )
    late = recorded.time_s + rng.uniform(0, 2 * stamp_s, len(recorded.time_s))
    turns = decode_words(recorded.counts).position / 8192 if isinstance(word, str) else recorded.counts / word
    return np.maximum.accumulate(late), np.unwrap(2 * np.pi * turns)


def inertia_errors(degrees: float, peaks: int, *, word: Word, stamp_s: float, count: int) -> tuple[Array, Array]:
    """Return the relative errors of the axis inertia, and the errors of W in stated standard uncertainties."""
    motion, truth = plants(degrees, count)
    rng = np.random.default_rng(peaks)
    errors, scores = [], []
    for i in range(count):
        record = polled(motion, i, word=word, stamp_s=stamp_s, rng=rng)
        found = find_swing(*record)
        if found.peaks_used > peaks:
            found = find_swing(*record, peaks=peaks)
        fit = fit_swing(found)
        frequency = fit.coefficients.natural_frequency_squared_s2
        errors.append(truth[i] / frequency - 1)  # I_a = m g r / W
        scores.append((frequency - truth[i]) / fit.std.natural_frequency_squared_s2)
    return np.array(errors), np.array(scores)


# A bound on the errors themselves is as strict for eight swings as for 24, and three windows have 24 swings in all.
@pytest.mark.parametrize("count", [8, pytest.param(24, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("word", "degrees", "peaks"), [(COARSE, 10, 4), (FINE, 50, 8), (COARSE, 70, 14)])
def test_good_stamps_give_the_axis_inertia_to_a_fiftieth_of_a_percent(
    word: Word, degrees: float, peaks: int, count: int
) -> None:
    errors, _ = inertia_errors(degrees, peaks, word=word, stamp_s=2e-4, count=count)

    assert abs(errors.mean()) < 2e-4
    assert errors.std() < 2e-4


@pytest.mark.slow
@pytest.mark.parametrize(
    ("word", "stamp_s", "mean_within", "std_within"),
    [(COARSE, 2e-4, 2e-4, np.inf), (FINE, 2e-4, 2e-4, np.inf), (COARSE, 2e-3, np.inf, 5e-4)],
)
@pytest.mark.parametrize("peaks", PEAKS)
@pytest.mark.parametrize("degrees", RELEASES_DEG)
def test_over_200_runs_good_stamps_leave_no_bias_and_bad_ones_scatter_by_a_twentieth_of_a_percent(
    degrees: float, peaks: int, word: Word, stamp_s: float, mean_within: float, std_within: float
) -> None:
    errors, scores = inertia_errors(degrees, peaks, word=word, stamp_s=stamp_s, count=200)

    print(
        f"{degrees:.0f} degrees, {peaks} peaks, {word}, stamps {1e3 * stamp_s:g} ms: "
        f"mean {100 * errors.mean():+.5f} %, std {100 * errors.std():.5f} %, "
        f"within 95 % interval {np.mean(np.abs(scores) < 1.96):.3f}"
    )
    assert abs(errors.mean()) < mean_within
    assert errors.std() <= std_within
