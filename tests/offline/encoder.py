"""Simulates a polled rotary encoder: turns an axis' true motion into stamped counts; no port and no protocol."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicHermiteSpline

from cfid.sim.plants import swing
from cfid.sim.stepping import Array
from cfid.sim.swing import Truth, draw_release, pendulum
from cfid.wire.rls import STEPS_PER_TURN, encode_positions


class EncoderRecording(NamedTuple):
    """A recording of the encoder: stamps and raw counts, each (n,)."""

    time_s: Array
    counts: npt.NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class EncoderModel:
    """An encoder and the loop that polls it.

    `word` is the counts per turn or the name of a word format, as in rig.toml. The count is zero where the
    axis stands at -`offset_rad`; an eccentric ring adds `eccentricity_rad` sin(angle from there). Intervals
    between samples are uniform within `poll_s` +- `poll_jitter_s`; a stamp misses its sample's instant by a
    normal error of standard deviation `stamp_error_s`. Raises ValueError when the jitter would make an
    interval negative.
    """

    word: float | Literal["rls-13bit-in-22"] = "rls-13bit-in-22"
    offset_rad: float = 0.0
    poll_s: float = 1e-3
    poll_jitter_s: float = 1e-4
    stamp_error_s: float = 5e-5
    eccentricity_rad: float = 0.0

    def __post_init__(self) -> None:
        """Reject a loop that would poll backwards."""
        if not 0 <= self.poll_jitter_s < self.poll_s:
            raise ValueError("poll_jitter_s lies between zero and poll_s")


def record(
    time_s: Array,
    angle_rad: Array,
    *,
    speed_rad_per_s: Array,
    encoder: EncoderModel,
    rng: np.random.Generator,
) -> EncoderRecording:
    """Poll an axis that moved as the plant's samples state (each (m,), time increasing).

    Between them the angle is the cubic through angles and speeds: at 1 ms it misses a swing by less than
    1e-7 rad, where the direction of dry friction jumps too. A host never stamps backwards, so stamps whose
    errors would cross are put in order; errors larger than `poll_s` therefore come out smaller than specified.
    """
    sampled_s = _sampling_instants(float(time_s[0]), float(time_s[-1]), encoder=encoder, rng=rng)
    sampled_rad = CubicHermiteSpline(time_s, angle_rad, speed_rad_per_s)(sampled_s)
    stamps_s = np.sort(sampled_s + encoder.stamp_error_s * rng.standard_normal(sampled_s.size))
    seen_rad = sampled_rad + encoder.offset_rad
    seen_rad += encoder.eccentricity_rad * np.sin(seen_rad)
    return EncoderRecording(stamps_s, _counts(seen_rad, word=encoder.word))


def _sampling_instants(begin_s: float, end_s: float, *, encoder: EncoderModel, rng: np.random.Generator) -> Array:
    shortest_s = encoder.poll_s - encoder.poll_jitter_s
    enough = math.floor((end_s - begin_s) / shortest_s) + 1
    intervals_s = encoder.poll_s + encoder.poll_jitter_s * rng.uniform(-1, 1, enough)
    instants_s: Array = begin_s + np.cumsum(intervals_s) - intervals_s[0]
    return instants_s[: np.searchsorted(instants_s, end_s, side="right")]


def _counts(angle_rad: Array, *, word: float | Literal["rls-13bit-in-22"]) -> npt.NDArray[np.int64]:
    steps = STEPS_PER_TURN if word == "rls-13bit-in-22" else word
    position = np.floor(angle_rad / (2 * math.pi) * steps).astype(np.int64) % int(steps)
    return encode_positions(position) if word == "rls-13bit-in-22" else position


def record_swings(
    truth: Truth,
    mounts: Iterable[str],
    *,
    rng: np.random.Generator,
    encoder: EncoderModel,
    angle_deg: tuple[float, float] = (20, 70),
    duration_s: float = 16.0,
) -> dict[str, EncoderRecording]:
    """Swing the body once in each of the named mounts and record it.

    A body that is mounted again meets the encoder at any angle: every swing gets its own offset in place of the
    encoder's.
    """
    names = tuple(mounts)
    releases = [draw_release(rng, angle_deg=angle_deg) for _ in names]
    pendulums = [pendulum(truth, name) for name in names]
    motion = swing(pendulums, releases, duration_s=duration_s, step_s=2e-3, store_every=1)
    return {
        name: record(
            motion.time_s,
            motion.angle_rad[:, i],
            speed_rad_per_s=motion.speed_rad_per_s[:, i],
            encoder=replace(encoder, offset_rad=rng.uniform(0, 2 * math.pi)),
            rng=rng,
        )
        for i, name in enumerate(names)
    }
