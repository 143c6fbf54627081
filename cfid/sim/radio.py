"""Simulates the radio link between a client and the vehicle: its losses and its delays."""

import math
from collections import deque
from typing import Annotated, NamedTuple, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from cfid.records.rig_file import Number, Positive, Spread
from cfid.sim.wander import Wander

FLOOR_WANDER_S = 60.0
CONGESTED_S, CLEAR_S = 2.0, 8.0

MOST_WAITING = 16

_CYCLES = 20  # before the first packet, so that it may meet a congestion
_REMEMBERED = 100_000  # pings


class RadioTruth(BaseModel):
    """One packet in one direction takes `latency_s` on average.

    The shortest time is `jitter_s` less; the rest is exponential, with `jitter_s` as mean and standard deviation. The
    fraction `loss` of all packets is lost.

    With `jitter_shape` the rest is a gamma distribution of that shape: at 1 the exponential; above 1 a delay has no
    sharp lower edge. The shortest time wanders with the standard deviation `floor_wander_s`, correlated over
    FLOOR_WANDER_S. In times of congestion, CONGESTED_S long and CLEAR_S apart on average, a packet takes longer by an
    exponential time of mean `congestion_s`. Each direction passes `packets_per_s` at most, where that is not zero:
    a packet waits behind MOST_WAITING others, or is lost.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    latency_s: Spread = 4e-4
    jitter_s: Spread = 1e-4
    loss: Annotated[Number, Field(ge=0, le=1)] = 0.0
    jitter_shape: Positive = 1.0
    floor_wander_s: Spread = 0.0
    congestion_s: Spread = 0.0
    packets_per_s: Spread = 0.0

    @model_validator(mode="after")
    def _comes_after_it_was_sent(self) -> Self:
        if self.jitter_s > self.latency_s:
            raise ValueError("jitter_s cannot exceed latency_s: a packet would come before it was sent")
        return self

    @property
    def mean_s(self) -> float:
        """The long-term mean time of a packet."""
        return self.latency_s + self.congestion_s * CONGESTED_S / (CONGESTED_S + CLEAR_S)


class Ping(NamedTuple):
    """A ping that was answered: its port, its payload and its round-trip time."""

    port: int
    payload: bytes
    round_trip_s: float


class Direction:
    """Packets one way, which never overtake each other."""

    def __init__(self, truth: RadioTruth, rng: np.random.Generator) -> None:
        """Draw from `rng`."""
        self._truth = truth
        self._rng = rng
        self._last_s = 0.0
        self._free_s = -math.inf
        self.lost = 0
        self._disturbing = rng.spawn(1)[0] if truth.floor_wander_s or truth.congestion_s else rng
        self._wander: Wander | None = None
        if truth.floor_wander_s:
            self._wander = Wander(truth.floor_wander_s, correlation_s=FLOOR_WANDER_S, rng=self._disturbing)
        self._congested: tuple[float, float] | None = None

    def arrival_s(self, sent_s: float) -> float | None:
        """Return when a packet arrives, None if it is lost."""
        truth = self._truth
        fate = self._rng.random()
        late_s = self._rng.gamma(truth.jitter_shape, truth.jitter_s / truth.jitter_shape)  # of a lost packet, too
        if truth.packets_per_s:
            waited_s = max(self._free_s - sent_s, 0.0)
            if waited_s * truth.packets_per_s > MOST_WAITING:
                self.lost += 1
                return None
            sent_s += waited_s
            self._free_s = sent_s + 1 / truth.packets_per_s
        if fate < truth.loss:
            self.lost += 1
            return None
        floor_s = truth.latency_s - truth.jitter_s
        if self._wander is not None:
            floor_s = max(floor_s + float(self._wander.at(sent_s)[0, 0]), 0.0)
        self._last_s = max(self._last_s, sent_s + floor_s + late_s + self._congestion_s(sent_s))
        return self._last_s

    def _congestion_s(self, sent_s: float) -> float:
        if not self._truth.congestion_s:
            return 0.0
        begin_s, end_s = self._congested or (-math.inf, sent_s - _CYCLES * (CONGESTED_S + CLEAR_S))
        while end_s <= sent_s:
            begin_s = end_s + self._disturbing.exponential(CLEAR_S)
            end_s = begin_s + self._disturbing.exponential(CONGESTED_S)
        self._congested = begin_s, end_s
        return self._disturbing.exponential(self._truth.congestion_s) if begin_s <= sent_s else 0.0


class Radio:
    """Both directions, and the pings that were answered."""

    def __init__(self, truth: RadioTruth, rng: np.random.Generator) -> None:
        """Draw each direction from its own generator."""
        up, down = rng.spawn(2)
        self.to_vehicle = Direction(truth, up)
        self.from_vehicle = Direction(truth, down)
        self.pings: deque[Ping] = deque(maxlen=_REMEMBERED)
