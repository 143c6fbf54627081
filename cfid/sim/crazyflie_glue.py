"""Connects the app to the simulated firmware: passes it the vehicle's state, and carries out its orders.

It does what `firmware_patches/cfid_app/src/cfid_app.c` does around the core.
"""

from cfid.sim.crazyflie_commander import Commander, Priority
from cfid.sim.crazyflie_modules import App, Orders, Seen
from cfid.sim.crazyflie_params import Parameters
from cfid.sim.crazyflie_supervisor import SimulatedSupervisor

IDLE = "powerDist.idleThrust"

_FEED_TICKS = 20


class Glue:
    """An app on a vehicle; one loop calls `tick` and `receive`."""

    def __init__(
        self,
        app: App,
        *,
        supervisor: SimulatedSupervisor,
        commander: Commander,
        parameters: Parameters,
        needs_arming: bool,
    ) -> None:
        """Start with the vehicle's idle thrust unchanged."""
        self.app = app
        self._supervisor, self._commander, self._parameters = supervisor, commander, parameters
        self._needs_arming = needs_arming
        self._fed_ticks = 0
        self._idles_off = False
        self._idle = 0

    def receive(self, service: int, channel: int, payload: bytes, *, now_us: int) -> None:
        """Pass a request to the app."""
        self.app.receive(service, channel, payload, now_us=now_us, vehicle=self._look())

    def tick(self, *, now_us: int) -> Orders:
        """Advance the app by a millisecond, carry out its orders other than commands, and return all of them."""
        orders = self.app.tick(now_us=now_us, vehicle=self._look())
        self._feed(orders.feeds)
        if self._needs_arming:
            self._carry_out(orders)
        return orders

    def _look(self) -> Seen:
        if self._needs_arming and not self._idles_off:
            self._idle = int(self._parameters[IDLE])
        supervisor = self._supervisor
        return Seen(supervisor.can_fly, supervisor.flying, self._needs_arming, self._idle)

    def _feed(self, fresh: bool) -> None:
        """Give the commander fresh null setpoints; afterwards pass control to the high-level commander."""
        if fresh:
            if self._fed_ticks % _FEED_TICKS == 0:
                self._commander.set(Priority.CLIENT)
            self._fed_ticks += 1
        elif self._fed_ticks:
            self._commander.relax()
            self._fed_ticks = 0

    def _carry_out(self, orders: Orders) -> None:
        if orders.idles_off != self._idles_off:
            self._parameters[IDLE] = 0 if orders.idles_off else self._idle
        self._idles_off = orders.idles_off
        if orders.disarms:
            self._supervisor.request_arming(False)
