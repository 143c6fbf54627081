"""A core of the app on a stand: its clock, its keep-alives, and the packets that it sent."""

from typing import NamedTuple

import pytest

from cfid.errors import DeviceError
from cfid.sim.app_core import PING, SINE, THRUST, AppCore, Seen, load_core
from cfid.sim.propulsion import STILL, Four
from cfid.wire import app

BEGIN_US = 5_000_000_000  # more than 32 bits
TICK_US = 1000
KEEP_ALIVE_TICKS = 100


MAY_RUN = Seen(can_fly=True, flying=False, needs_arming=False, idle=0)
MAY_NOT_RUN = Seen(can_fly=False, flying=False, needs_arming=False, idle=0)


def new_core() -> AppCore:
    try:
        return load_core()
    except DeviceError:
        pytest.skip("there is no C compiler to make the app's core with")


class Heard(NamedTuple):
    """A packet that the app sent, and the time at which it did."""

    at_us: int
    service: int
    channel: int
    payload: bytes


class Stand:
    """A vehicle that is allowed to run its motors, and a client that sends keep-alives while `alive`."""

    def __init__(self, core: AppCore) -> None:
        self.core = core
        self.now_us = BEGIN_US
        self.vehicle = MAY_RUN
        self.alive = True
        self.heard: list[Heard] = []
        self._ticks = 0

    def tell(self, service: int, channel: int, payload: bytes = b"") -> bytes:
        """Send a packet and return the payload of the answer."""
        self.core.receive(service, channel, payload, now_us=self.now_us, vehicle=self.vehicle)
        *others, answer = self.core.sent()
        self._keep(others)
        assert answer[0] == service
        return answer[2]

    def say(self, service: int, channel: int, payload: bytes = b"") -> None:
        """Send a packet and keep the packets that the app sends."""
        self.core.receive(service, channel, payload, now_us=self.now_us, vehicle=self.vehicle)
        self._keep(self.core.sent())

    def keep_alive(self) -> app.AppState:
        state = app.decode_state(self.tell(PING, app.PingChannel.ALIVE, app.encode_alive(self._ticks)))
        assert state is not None
        return state

    def stop(self) -> None:
        self.say(PING, app.PingChannel.STOP, app.encode_alive(1))

    def thrust(self, command: int, motor: int) -> app.ThrustAnswer:
        payload = app.encode_thrust(app.ThrustRequest(command, motor))
        answer = app.decode_thrust_answer(self.tell(THRUST, app.ThrustChannel.SET, payload))
        assert answer is not None
        return answer

    def sine(self, motor: int, amplitude: int, omega: float, samples: int) -> app.SineAnswer:
        payload = app.encode_sine(app.SineRequest(motor, amplitude, omega, samples))
        answer = app.decode_sine_answer(self.tell(SINE, app.SineChannel.START, payload))
        assert answer is not None
        return answer

    def tick(self) -> Four | None:
        """Let a millisecond pass, and return the commands."""
        self.now_us += TICK_US
        if self.alive and self._ticks % KEEP_ALIVE_TICKS == 0:
            self.keep_alive()
        self._ticks += 1
        orders = self.core.tick(now_us=self.now_us, vehicle=self.vehicle)
        self._keep(self.core.sent())
        return orders.held

    def run(self, ms: int) -> list[Four]:
        """Return the commands of each millisecond; they are zero while the stock controller has the motors."""
        return [self.tick() or STILL for _ in range(ms)]

    def crossings(self) -> list[app.Crossing]:
        decoded = [app.decode_crossing(payload) for _, payload in self.on(app.SineChannel.CROSSING)]
        return [crossing for crossing in decoded if crossing is not None]

    def done(self) -> list[tuple[int, app.Done]]:
        return [(at_us, done) for at_us, p in self.on(app.SineChannel.DONE) if (done := app.decode_done(p))]

    def on(self, channel: int) -> list[tuple[int, bytes]]:
        """Return the times and payloads of the packets on a channel of the sine service."""
        return [(h.at_us, h.payload) for h in self.heard if (h.service, h.channel) == (SINE, channel)]

    def _keep(self, packets: list[tuple[int, int, bytes]]) -> None:
        self.heard += [Heard(self.now_us, *packet) for packet in packets]
