"""Simulates faulty answers to a stop: acknowledged but ignored, or with another request's number."""

from cfid.sim.crazyflie import Crazyflie, LeavingPacket
from cfid.wire.app import AppState, Flags, PingChannel, encode_state
from cfid.wire.crtp import PARAMETER_PORT, WRITE_CHANNEL, decode_packet

_ENABLE = "motorPowerSet.enable"
_NUMBER_BYTES = 4


def is_stop(datagram: bytes, vehicle: Crazyflie, *, ping_port: int) -> bool:
    """Return whether a datagram is the app's stop, or zero for motorPowerSet.enable."""
    packet = decode_packet(datagram)
    if packet is None:
        return False
    enable = vehicle.parameter_number(_ENABLE).to_bytes(2, "little")
    return packet[:2] == (ping_port, PingChannel.STOP) or packet == (PARAMETER_PORT, WRITE_CHANNEL, enable + b"\0")


def answer_only(datagram: bytes, vehicle: Crazyflie, at_s: float) -> list[LeavingPacket]:
    """Return the answer of a vehicle that ignores a stop: the value as if set, or the commands still in force."""
    header, payload = datagram[0], datagram[1:]
    if header >> 4 == PARAMETER_PORT:
        return [LeavingPacket(at_s, datagram)]
    number = int.from_bytes(payload[:_NUMBER_BYTES], "little")
    flags = Flags.MOTORS_ALLOWED | Flags.KEEP_ALIVE_FRESH
    state = AppState(number, flags, vehicle.motors, int(at_s * 1e6) % (1 << 32))
    return [LeavingPacket(at_s, bytes([header]) + encode_state(state))]


def misnumbered(answer: LeavingPacket) -> LeavingPacket:
    """Return an answer renumbered to the next request, or the next parameter."""
    header, number, rest = answer.packet[:1], answer.packet[1 : 1 + _NUMBER_BYTES], answer.packet[1 + _NUMBER_BYTES :]
    following = (int.from_bytes(number, "little") + 1) % (1 << 8 * len(number))
    return LeavingPacket(answer.time_s, header + following.to_bytes(len(number), "little") + rest)
