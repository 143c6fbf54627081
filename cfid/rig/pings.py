"""Records round trips to the vehicle and back (section 3.4.4, C.2.6)."""

from collections.abc import Mapping
from typing import Any

from cfid.records.run import DeviceRecord
from cfid.rig.hardware import Hardware
from cfid.rig.instrument import Block, Instrument
from cfid.rig.motors import Firmware
from cfid.rig.vehicle import Vehicle
from cfid.wire import app, crtp
from cfid.wire.app import PingChannel
from cfid.wire.crtp import Packet


class Pings(Instrument):
    """A row for each answer: `t` when the ping left, the round trip, and the vehicle's time where it reports one."""

    name = "pings"

    def __init__(self, vehicle: Vehicle, firmware: Firmware, record: DeviceRecord) -> None:
        """Take a vehicle."""
        self.record = record
        self._vehicle, self._firmware = vehicle, firmware
        self.sent = self._lost = 0
        self._rows: list[tuple[float, ...]] = []

    @staticmethod
    def columns_of(firmware: Firmware) -> tuple[str, ...]:
        """Return the columns that a firmware's answers fill."""
        return ("t", "rtt_s", "vehicle_us") if firmware.kind == "app" else ("t", "rtt_s")

    def start(self, hardware: Hardware) -> None:
        """Begin to monitor the link: `ping` sends each ping."""
        self._hardware = hardware
        self._vehicle.begin()

    async def ping(self) -> float | None:
        """Send a ping and wait for its answer; return the round trip in seconds, None when it was lost."""
        self._vehicle.check()
        self.sent += 1
        number, request = self.sent, self._request()
        vehicle_us: list[int] = []

        def own(payload: bytes) -> bool | None:
            if self._firmware.kind == "stock":
                return crtp.decode_echo(payload) == number or None
            time_us = app.decode_ping_answer(request.payload, payload)
            if time_us is not None:
                vehicle_us.append(time_us)
            return True if time_us is not None else None

        # The thesis' mean is a seventeenth of this.
        times_s = await self._vehicle.times_of_answer(request, own, within_s=1.0)
        if times_s is None:
            self._lost += 1
            return None
        sent_s, arrived_s = times_s
        self._rows.append((sent_s, round(arrived_s - sent_s, 7), *vehicle_us[:1]))
        return arrived_s - sent_s

    def take(self) -> Block:
        """Return the round trips since the last call."""
        lost, self._lost = self._lost, 0
        rows, self._rows = self._rows, []
        return self.block(rows, lost)

    def facts(self) -> Mapping[str, Any]:
        """Return how many pings were sent."""
        return {"sent": self.sent}

    def _request(self) -> Packet:
        ports = self._firmware.ports
        if self._firmware.kind == "stock":
            return Packet(crtp.ECHO_PORT, crtp.ECHO_CHANNEL, crtp.encode_echo(self.sent))
        return Packet(ports.ping, PingChannel.PING, app.encode_alive(self.sent))
