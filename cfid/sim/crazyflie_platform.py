"""What the vehicle's platform port answers: who it is, and the older way to arm it."""

from cfid.sim.crazyflie_supervisor import Supervisor

COMMAND_CHANNEL, VERSION_CHANNEL = 0, 1

_ARM, _RECOVER, _NOTIFY = 1, 2, 3


def answer_version(payload: bytes, *, protocol: int, brushless: bool) -> bytes | None:
    """Return the protocol, the firmware or the device, None where another thing is asked for."""
    asked = payload[:1]
    device = b"Crazyflie 2.1 Brushless" if brushless else b"Crazyflie 2.1"
    told = {b"\0": protocol.to_bytes(4, "little"), b"\1": b"2026.08", b"\2": device}
    return asked + told[asked] if asked in told else None


def answer_command(payload: bytes, supervisor: Supervisor) -> bytes:
    """Arm, disarm or recover as the supervisor port does; any other command comes back as it is."""
    command = payload[:1]
    if command == bytes([_ARM]):
        granted = len(payload) > 1 and supervisor.request_arming(payload[1] != 0)
        return command + bytes([granted, supervisor.armed])
    if command == bytes([_RECOVER]):
        return command + bytes([supervisor.recover(), not supervisor.crashed])
    return b"" if command == bytes([_NOTIFY]) else payload
