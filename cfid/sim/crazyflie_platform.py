"""Simulates the vehicle's platform port: its versions, and the older way to arm it."""

from cfid.sim.crazyflie_supervisor import SimulatedSupervisor

COMMAND_CHANNEL, VERSION_CHANNEL = 0, 1

_ARM, _RECOVER, _NOTIFY = 1, 2, 3


def answer_version(payload: bytes, *, protocol: int, brushless: bool) -> bytes | None:
    """Return the version of the protocol or the firmware, or the device's name; None for any other question."""
    question = payload[:1]
    device = b"Crazyflie 2.1 Brushless" if brushless else b"Crazyflie 2.1"
    answers = {b"\0": protocol.to_bytes(4, "little"), b"\1": b"2026.08", b"\2": device}
    return question + answers[question] if question in answers else None


def answer_command(payload: bytes, supervisor: SimulatedSupervisor) -> bytes:
    """Arm, disarm or recover as the supervisor port does; return any other command unchanged."""
    command = payload[:1]
    if command == bytes([_ARM]):
        granted = len(payload) > 1 and supervisor.request_arming(payload[1] != 0)
        return command + bytes([granted, supervisor.armed])
    if command == bytes([_RECOVER]):
        return command + bytes([supervisor.recover(), not supervisor.crashed])
    return b"" if command == bytes([_NOTIFY]) else payload
