"""ULog and blackbox files, composed byte by byte according to the descriptions of their formats."""

import struct
from collections.abc import Sequence

COUNT = 200
BLACKBOX_END = b"E\xffEnd of log\0"
_MOTORS = [f"{name}[{place}]" for name in ("motor", "eRPM") for place in range(4)]


def message(kind: str, data: bytes) -> bytes:
    return struct.pack("<Hc", len(data), kind.encode()) + data


def ulog(*, geometry: str = "", unconnected: bool = False) -> bytes:
    """Return a ULog file; `geometry` lists the places of the rotors in order, such as "FR RL FL RR".

    With `unconnected`, the file has two batteries, of which the first is not connected.
    """
    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000)
    head += message("B", bytes(40))
    head += message("F", b"vehicle_angular_velocity:uint64_t timestamp;float[3] xyz;")
    head += message("F", b"battery_status:uint64_t timestamp;float voltage_v;uint8_t warning;")
    head += message("F", b"actuator_motors:uint64_t timestamp;float[12] control;")
    head += message("F", b"vehicle_acceleration:uint64_t timestamp;float[3] xyz;")
    key = b"char[4] ver_hw"
    head += message("I", bytes([len(key)]) + key + b"FMU6")
    for rotor, place in enumerate(geometry.split()):
        for axis, at in (("X", 0.1 if place[0] == "F" else -0.1), ("Y", 0.1 if place[1] == "R" else -0.1)):
            key = f"float CA_ROTOR{rotor}_P{axis}".encode()
            head += message("P", bytes([len(key)]) + key + struct.pack("<f", at))
    head += message("A", struct.pack("<BH", 0, 0) + b"vehicle_angular_velocity")
    head += message("A", struct.pack("<BH", int(unconnected), 1) + b"battery_status")
    if unconnected:
        head += message("A", struct.pack("<BH", 0, 4) + b"battery_status")
    head += message("A", struct.pack("<BH", 0, 2) + b"actuator_motors")
    head += message("A", struct.pack("<BH", 0, 3) + b"vehicle_acceleration")
    rows = b""
    for at in range(COUNT):
        rows += message("D", struct.pack("<HQ3f", 0, 10_000 + 4000 * at, at / 8, -at, 0.5))
        if at % 10 == 0:
            rows += message("D", struct.pack("<HQfB", 1, 10_000 + 4000 * at, 16.5, at % 3))
            if unconnected:
                rows += message("D", struct.pack("<HQfB", 4, 10_000 + 4000 * at, 0.0, 0))
            motors = (0.1, 0.2, 0.3, 0.4, *8 * [float("nan")])
            rows += message("D", struct.pack("<HQ12f", 2, 10_000 + 4000 * at, *motors))
            rows += message("D", struct.pack("<HQ3f", 3, 10_000 + 4000 * at, 0, 0, -9.81))
    return head + rows + message("O", struct.pack("<H", 25))


def unsigned(value: int) -> bytes:
    out = b""
    while value > 127:
        out += bytes([value & 127 | 128])
        value >>= 7
    return out + bytes([value])


def signed(value: int) -> bytes:
    return unsigned((value << 1) ^ (value >> 31))


def blackbox_head() -> bytes:
    fields = ("loopIteration", "time", "gyroADC[0]", "gyroADC[1]", "gyroADC[2]", "accSmooth[2]", *_MOTORS)
    many = len(_MOTORS)
    head = [
        "Product:Blackbox flight data recorder by Nicholas Sherlock",
        "Data version:2",
        "I interval:1",
        "P interval:1",
        "Field I name:" + ",".join(fields),
        "Field I signed:0,0,1,1,1,1" + many * ",0",
        "Field I predictor:0,0,0,0,0,0" + many * ",0",
        "Field I encoding:1,1,0,0,0,0" + many * ",1",
        "Field P predictor:0,0,0,0,0,0" + many * ",0",
        "Field P encoding:1,1,0,0,0,0" + many * ",1",
        "motorOutput:1000,2000",
        "motor_poles:14",
        "Firmware revision:Betaflight 2025.12.1",
        "gyro_scale:0x3f800000",
        "acc_1G:2048",
    ]
    return "".join(f"H {line}\n" for line in head).encode()


def blackbox_row(
    at: int, *, gyro: Sequence[int], motors: Sequence[int], turning: Sequence[int] = (70, 71, 72, 73)
) -> bytes:
    """Return a row; `turning` is in hundreds of electrical revolutions per minute."""
    values = (unsigned(at), unsigned(1000 + 500 * at), *map(signed, gyro), signed(2048))
    return b"I" + b"".join((*values, *map(unsigned, motors), *map(unsigned, turning)))


def blackbox_with_voltage(*, firmware: str, reference: int, counts: Sequence[int]) -> bytes:
    """Return a log of times and the battery's voltage, as 14-bit differences from a `reference`."""
    head = [
        "Product:Blackbox flight data recorder by Nicholas Sherlock",
        "Data version:2",
        "I interval:1",
        "P interval:1",
        "Field I name:loopIteration,time,vbatLatest",
        "Field I signed:0,0,0",
        "Field I predictor:0,0,9",
        "Field I encoding:1,1,3",
        "Field P predictor:0,0,9",
        "Field P encoding:1,1,3",
        f"Firmware revision:{firmware}",
        f"vbatref:{reference}",
    ]
    rows = b"".join(
        b"I" + unsigned(at) + unsigned(1000 + 500 * at) + unsigned(reference - count & 0x3FFF)
        for at, count in enumerate(counts)
    )
    return "".join(f"H {line}\n" for line in head).encode() + rows + BLACKBOX_END


def blackbox() -> bytes:
    rows = (
        blackbox_row(at, gyro=(at - 100, -at, 0), motors=[1000 + at + 100 * place for place in range(4)])
        for at in range(COUNT)
    )
    return blackbox_head() + b"".join(rows) + BLACKBOX_END
