"""The simulated encoder: no recorded value may differ from the motion by more than a step."""

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cfid.sim.plants import HandRelease, Pendulum, swing
from cfid.wire.rls import decode_words
from tests.offline.encoder import EncoderModel, record

Array = npt.NDArray[np.float64]

TIME_S = np.arange(0, 5, 1e-3)
TURN = 2 * math.pi
PUNCTUAL = {"poll_jitter_s": 0.0, "stamp_error_s": 0.0}


def _motion(time_s: Array) -> Array:
    return np.asarray(0.9 * np.exp(-0.4 * time_s) * np.cos(14 * time_s))


def _speed(time_s: Array) -> Array:
    return np.asarray(-0.9 * np.exp(-0.4 * time_s) * (0.4 * np.cos(14 * time_s) + 14 * np.sin(14 * time_s)))


def _record(encoder: EncoderModel, *, seed: int = 1) -> tuple[Array, npt.NDArray[np.int64]]:
    return record(
        TIME_S,
        _motion(TIME_S),
        speed_rad_per_s=_speed(TIME_S),
        encoder=encoder,
        rng=np.random.default_rng(seed),
    )


def _unwrapped(counts: npt.NDArray[np.int64], *, per_turn: int) -> Array:
    return np.asarray(np.unwrap(counts.astype(np.float64), period=per_turn) * TURN / per_turn)


@settings(deadline=None, max_examples=40)
@given(offset_rad=st.floats(-20, 20), seed=st.integers(0, 1000))
def test_a_count_that_runs_over_its_end_loses_nothing(offset_rad: float, seed: int) -> None:
    per_turn = 4194304
    encoder = EncoderModel(word=per_turn, offset_rad=offset_rad, stamp_error_s=0)
    t_s, counts = _record(encoder, seed=seed)
    assert counts.min() >= 0
    assert counts.max() < per_turn
    below_rad = _motion(t_s) + offset_rad - _unwrapped(counts, per_turn=per_turn)
    below_rad -= TURN * np.round(below_rad[0] / TURN)
    assert below_rad.min() > -1e-7
    assert below_rad.max() < TURN / per_turn + 1e-7


@pytest.mark.parametrize("offset_rad", [0.0, 1.0, -0.3, 6.1])
def test_words_of_13_bits_pass_their_own_check_and_step_8192_times_a_turn(offset_rad: float) -> None:
    t_s, counts = _record(EncoderModel(offset_rad=offset_rad, stamp_error_s=0))
    decoded = decode_words(counts)
    assert decoded.valid.all()
    below_rad = _motion(t_s) + offset_rad - _unwrapped(decoded.position, per_turn=8192)
    below_rad -= TURN * np.round(below_rad[0] / TURN)
    assert below_rad.min() > -1e-7
    assert below_rad.max() < TURN / 8192 + 1e-7
    assert below_rad.mean() == pytest.approx(TURN / 8192 / 2, rel=0.05)


def test_between_the_plants_samples_a_swing_with_dry_friction_is_met_within_a_tenth_of_a_microradian() -> None:
    pendulum = Pendulum(axis_inertia_kg_m2=3.1e-5, gravity_moment_nm=6.3e-3, viscous_nms_per_rad=1e-5, coulomb_nm=4e-5)
    fine = swing(
        [pendulum],
        [HandRelease(angle_rad=1, wait_s=0.05, lift_s=0.3, hold_s=0.1)],
        duration_s=4.0,
        step_s=2.5e-4,
        store_every=1,
    )
    per_turn = 1 << 40  # whose steps are far below the tested error
    t_s, counts = record(
        fine.time_s[::4],
        fine.angle_rad[::4, 0],
        speed_rad_per_s=fine.speed_rad_per_s[::4, 0],
        encoder=EncoderModel(word=per_turn, poll_s=2.5e-4, **PUNCTUAL),
        rng=np.random.default_rng(0),
    )
    assert t_s == pytest.approx(fine.time_s[: t_s.size], abs=1e-9)
    assert t_s.size > 15_500
    recorded_rad = counts * (TURN / per_turn)
    error_rad = (recorded_rad - fine.angle_rad[: t_s.size, 0] + math.pi) % TURN - math.pi
    assert np.abs(error_rad).max() < 1e-7
