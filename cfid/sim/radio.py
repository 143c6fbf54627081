"""Simulates the radio link between a client and the vehicle: its losses and its delays."""

from collections import deque
from typing import Annotated, NamedTuple, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from cfid.records.facts import Number
from cfid.records.rig_file import Spread

_REMEMBERED = 100_000  # pings


class RadioTruth(BaseModel):
    """One packet in one direction takes `latency_s` on average.

    The shortest time is `jitter_s` less; the rest is exponential, with `jitter_s` as mean and standard deviation. The
    part `loss` of all packets is lost.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    latency_s: Spread = 4e-4
    jitter_s: Spread = 1e-4
    loss: Annotated[Number, Field(ge=0, le=1)] = 0.0

    @model_validator(mode="after")
    def _comes_after_it_was_sent(self) -> Self:
        if self.jitter_s > self.latency_s:
            raise ValueError("jitter_s cannot exceed latency_s: a packet would come before it was sent")
        return self


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
        self.lost = 0

    def arrival_s(self, sent_s: float) -> float | None:
        """Return when a packet arrives, None if it is lost."""
        truth = self._truth
        fate, late_s = self._rng.random(), self._rng.exponential(truth.jitter_s)  # both, so that a loss shifts nothing
        if fate < truth.loss:
            self.lost += 1
            return None
        self._last_s = max(self._last_s, sent_s + truth.latency_s - truth.jitter_s + late_s)
        return self._last_s


class Radio:
    """Both directions, and the pings that were answered."""

    def __init__(self, truth: RadioTruth, rng: np.random.Generator) -> None:
        """Draw each direction from its own generator."""
        up, down = rng.spawn(2)
        self.to_vehicle = Direction(truth, up)
        self.from_vehicle = Direction(truth, down)
        self.pings: deque[Ping] = deque(maxlen=_REMEMBERED)
