"""Defines the interface between the simulated vehicle and the app on it."""

from typing import NamedTuple

from cfid.sim.propulsion import Four

THRUST, SINE, PING = range(3)

Sent = tuple[int, int, bytes]  # service, channel, payload


class Seen(NamedTuple):
    """The vehicle's state as the app sees it; `idle` is powerDist.idleThrust as its owner set it."""

    can_fly: bool
    flying: bool
    needs_arming: bool
    idle: int


class Orders(NamedTuple):
    """An app's orders until its next tick.

    `commands` are those of the four motors, None to leave them to the stock controller; `feeds` gives fresh null
    setpoints, `idles_off` switches idle thrust off, and `disarms` disarms now.
    """

    commands: Four | None = None
    feeds: bool = False
    idles_off: bool = False
    disarms: bool = False


class App:
    """The three services on a vehicle, which give orders once a millisecond; this one, of stock firmware, has none."""

    def receive(self, service: int, channel: int, payload: bytes, *, now_us: int, vehicle: Seen) -> None:
        """Take a request."""

    def tick(self, *, now_us: int, vehicle: Seen) -> Orders:
        """Advance by a millisecond."""
        return Orders()

    def sent(self) -> list[Sent]:
        """Return the packets to send."""
        return []

    def alive(self, *, now_us: int) -> bool:
        """Return whether its client's keep-alives are fresh, or a sine plays."""
        return False
