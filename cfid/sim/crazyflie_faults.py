"""Simulates a Crazyflie behind a radio, with faults; no port and no clock."""

import math
from bisect import insort
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from cfid.sim.crazyflie import PROTOCOL, Crazyflie, LeavingPacket
from cfid.sim.crazyflie_stops import answer_only, is_stop, misnumbered
from cfid.sim.faults import CrazyflieFaults, within
from cfid.sim.netft import Address
from cfid.sim.propulsion import Four, Propulsion
from cfid.sim.radio import Ping, Radio
from cfid.sim.supervisor import GENERIC_SETPOINT_PORT, SETPOINT_PORT
from cfid.wire.app import PingChannel
from cfid.wire.crtp import ECHO_CHANNEL, ECHO_PORT, Packet, decode_packet

_HELLO = b"cfid"  # in the app's answer to a hello, before its version
_LOW_V = 2.9
_ACTIVE_S = 1.0  # since its last packet, a client counts as active
_ROUNDING_S = 1e-9

Datagram = tuple[bytes, Address]


@dataclass
class CrazyflieMishaps:
    """Counts of packets that did not pass, apart from those that the radio lost."""

    dropped: int = 0
    dropped_to_vehicle: int = 0
    silenced: int = 0
    refused: int = 0


class _InFlight(NamedTuple):
    """A packet on its way; `ping` is the ping that it carries or answers, and when the client sent that ping."""

    arrives_s: float
    packet: bytes
    ping: tuple[Packet, float] | None


class FaultyCrazyflie:
    """The vehicle behind its radio. Answers go to the client that last sent anything but a setpoint."""

    def __init__(
        self,
        vehicle: Crazyflie,
        propulsion: Propulsion,
        radio: Radio,
        faults: CrazyflieFaults,
        *,
        ping_port: int,
        opened_s: float,
    ) -> None:
        """Count the faults' times from `opened_s`."""
        self.vehicle = vehicle
        self.radio = radio
        self.faults = faults
        self.mishaps = CrazyflieMishaps()
        self._propulsion = propulsion
        self._pings = ((ping_port, PingChannel.PING), (ECHO_PORT, ECHO_CHANNEL))
        self._opened_s = self._looked_s = opened_s
        self._client: Address | None = None
        self._received_s = opened_s
        self._heard = self._sent = 0
        self._rebooted = self._tumbled = self._stopped = False
        self._up: deque[_InFlight] = deque()
        self._down: deque[_InFlight] = deque()

    @property
    def motors(self) -> Four:
        """The commands that motors 1 to 4 obey."""
        return self.vehicle.motors

    def next_s(self, now_s: float) -> float | None:
        """Return when the next event is due, None while there is none."""
        times = [self.vehicle.next_s, *(queue[0].arrives_s for queue in (self._up, self._down) if queue)]
        times += self._turns(now_s, math.inf)
        return min((time_s for time_s in times if time_s is not None), default=None)

    def closed(self, now_s: float) -> bool:
        """Return whether the port is closed."""
        return within(now_s - self._opened_s, self.faults.closed_after_s, None)

    def received(self, datagram: bytes, client: Address, now_s: float) -> None:
        """Take a client's datagram."""
        if self.faults.busy and client != self._client and now_s - self._received_s < _ACTIVE_S and self._client:
            self.mishaps.refused += 1
            return
        packet = decode_packet(datagram)
        if packet is None or packet.port not in (SETPOINT_PORT, GENERIC_SETPOINT_PORT):
            self._client, self._received_s = client, now_s
        self._heard += 1
        if self._silent(now_s):
            self.mishaps.silenced += 1
        elif _is_turn(self._heard, self.faults.drop_to_vehicle_every):
            self.mishaps.dropped_to_vehicle += 1
        else:
            arrives_s = self.radio.to_vehicle.arrival_s(now_s)
            if arrives_s is not None:
                ping = (packet, now_s) if packet is not None and packet[:2] in self._pings else None
                self._up.append(_InFlight(arrives_s, datagram, ping))

    def due(self, now_s: float) -> list[Datagram]:
        """Advance up to now and return the datagrams that leave the radio by then."""
        self.advance(now_s)
        came: list[Datagram] = []
        while self._down and self._down[0].arrives_s <= now_s:
            _, packet, ping = self._down.popleft()
            if ping is not None:
                request, received_s = ping
                self.radio.pings.append(Ping(request.port, request.payload, now_s - received_s))
            if self._client is not None:
                came.append((packet, self._client))
        return came

    def advance(self, now_s: float) -> None:
        """Process every event up to now at its own time; times must not decrease."""
        while self._up and self._up[0].arrives_s <= now_s:
            arrives_s, packet, ping = self._up.popleft()
            self._advance_vehicle(arrives_s)
            self._deliver(packet, ping, arrives_s)
        self._advance_vehicle(now_s)

    def _deliver(self, datagram: bytes, ping: tuple[Packet, float] | None, at_s: float) -> None:
        """Pass a packet to the vehicle and its answers to the radio, with the faults that concern a stop."""
        faults = self.faults
        if not is_stop(datagram, self.vehicle, ping_port=self._pings[0][0]):
            self._send(self.vehicle.receive(datagram, at_s), ping)
            return
        ignored = faults.stop_ignored
        answers = answer_only(datagram, self.vehicle, at_s) if ignored else self.vehicle.receive(datagram, at_s)
        if faults.stop_misnumbered:
            answers = [misnumbered(answer) for answer in answers]
        self._send(answers, late_s=faults.stop_late_s)

    def _advance_vehicle(self, now_s: float) -> None:
        for turn_s in (*self._turns(self._looked_s, now_s), now_s):
            self._send(self.vehicle.advance(turn_s))
            self._apply_faults(turn_s)
        self._looked_s = now_s

    def _turns(self, after_s: float, until_s: float) -> list[float]:
        """Return the times between the two at which a fault of the vehicle begins or ends, or its port closes."""
        faults = self.faults
        tumble_s, for_s = faults.tumble_after_s, faults.tumble_for_s
        begins = (
            faults.closed_after_s,
            tumble_s,
            None if tumble_s is None or for_s is None else tumble_s + for_s,
            faults.emergency_after_s,
            faults.low_battery_after_s,
            faults.reboot_after_s,
        )
        times = (self._opened_s + begin_s for begin_s in begins if begin_s is not None)
        return sorted(time_s for time_s in times if after_s < time_s <= until_s)

    def _apply_faults(self, now_s: float) -> None:
        elapsed_s = now_s - self._opened_s + _ROUNDING_S  # so that rounding does not put a fault after its own time
        faults, vehicle = self.faults, self.vehicle
        if within(elapsed_s, faults.reboot_after_s, None) and not self._rebooted:
            self._rebooted = True
            vehicle.restart(now_s)
        vehicle.protocol = faults.protocol or PROTOCOL
        tumbled = within(elapsed_s, faults.tumble_after_s, faults.tumble_for_s)
        if tumbled != self._tumbled:
            self._tumbled = tumbled
            vehicle.turn(math.cos(math.radians(faults.tumble_deg)) if tumbled else 1.0)
        if within(elapsed_s, faults.emergency_after_s, None) and not self._stopped:
            self._stopped = True
            vehicle.supervisor.stopped = True
        low = within(elapsed_s, faults.low_battery_after_s, None)
        self._propulsion.battery.at_most_v = _LOW_V if low else math.inf

    def _silent(self, now_s: float) -> bool:
        return within(now_s - self._opened_s, self.faults.silent_after_s, self.faults.silent_for_s)

    def _send(
        self, leaving: list[LeavingPacket], ping: tuple[Packet, float] | None = None, *, late_s: float = 0.0
    ) -> None:
        for time_s, sent in leaving:
            packet, version = sent, self.faults.app_protocol
            if version and sent[1:5] == _HELLO:
                packet = sent[:5] + bytes([version]) + sent[6:]
            self._sent += 1
            if self._silent(time_s):
                self.mishaps.silenced += 1
            elif _is_turn(self._sent, self.faults.drop_every):
                self.mishaps.dropped += 1
            else:
                arrives_s = self.radio.from_vehicle.arrival_s(time_s)
                if arrives_s is not None:
                    insort(self._down, _InFlight(arrives_s + late_s, packet, ping), key=lambda packet: packet.arrives_s)


def _is_turn(number: int, every: int) -> bool:
    return every > 0 and number % every == 0
