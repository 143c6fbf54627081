"""The app's core for protocol 1, with which the traces were recorded; the package no longer contains it."""

import ctypes
from functools import cache
from pathlib import Path

from cfid.sim.app_core import AppCore, CorePacket, Orders, Seen, compiled, declared

SOURCE = Path(__file__).parent / "app_protocol_1" / "cfid_core.c"
COMMANDS = ctypes.c_uint16 * 4


class CoreOfProtocol1(AppCore):
    """A core that knows only whether motors may run; its glue fed null setpoints while the core held the motors."""

    def receive(self, service: int, channel: int, payload: bytes, *, now_us: int, vehicle: Seen) -> None:
        self._library.cfid_core_receive(self._core, CorePacket.of(service, channel, payload), now_us, vehicle.can_fly)

    def tick(self, *, now_us: int, vehicle: Seen) -> Orders:
        commands = COMMANDS()
        held = self._library.cfid_core_tick(self._core, now_us, vehicle.can_fly, commands)
        return Orders(commands=commands, holds=held, feeds=held)


def load_core() -> CoreOfProtocol1:
    return CoreOfProtocol1(load_library())


@cache
def load_library() -> ctypes.CDLL:
    library = declared(compiled(SOURCE), vehicle=ctypes.c_bool, orders=ctypes.POINTER(ctypes.c_uint16))
    library.cfid_core_tick.restype = ctypes.c_bool
    return library
