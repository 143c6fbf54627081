"""The C core under the address and undefined-behaviour sanitizers, with every warning an error."""

import random
import struct
import subprocess
from pathlib import Path

from cfid.sim.propulsion import STILL
from cfid.wire import app
from tests.firmware.compiling import SANITISED, program
from tests.firmware.events import BEGIN_US, Event, outcomes
from tests.firmware.stand import new_core

EVENTS = 20_000
DRAINED_EVERY = 5
RECORD = struct.Struct("<Q6B30s")


def test_random_packets_find_no_fault_in_the_core_and_it_does_what_the_simulation_s_build_does(tmp_path: Path) -> None:
    happening = random_events(random.Random(4))
    driver = program("drive_core.c", tmp_path, *SANITISED)
    done = subprocess.run([driver], input=records(happening), capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout == written(happening)


def random_events(rng: random.Random) -> list[Event]:
    return [
        Event(rng.choice((0, 1000, 1000, rng.randrange(200_000))), rng.random() < 0.97, a_packet(rng))
        for _ in range(EVENTS)
    ]


def a_packet(rng: random.Random) -> tuple[int, int, bytes] | None:
    kind = rng.randrange(40)
    samples = rng.randrange(1, 100)
    sine = app.SineRequest(
        rng.randrange(6), rng.randrange(65536), app.omega_of(rng.randrange(samples // 2 + 1), samples), samples
    )
    if kind == 0:
        return 0, 0, app.encode_thrust(app.ThrustRequest(rng.randrange(65536), rng.randrange(-1, 6)))
    if kind == 1:
        return 1, 0, app.encode_sine(sine)
    if kind < 6:
        return 2, 2, rng.randbytes(4)
    if kind < 9:
        return rng.randrange(4), rng.randrange(4), rng.randbytes(rng.choice((0, 4, 6, 12, 30, rng.randrange(31))))
    return None


def records(happening: list[Event]) -> bytes:
    now_us, packed = BEGIN_US, []
    for number, (after_us, allowed, packet) in enumerate(happening):
        now_us += after_us
        service, channel, payload = packet or (0, 0, b"")
        drained = number % DRAINED_EVERY == 0
        packed.append(RECORD.pack(now_us, drained, allowed, packet is None, service, channel, len(payload), payload))
    return b"".join(packed)


def written(happening: list[Event]) -> bytes:
    """Return what the driver writes if its core behaves like the one that the simulation compiles."""
    out = bytearray()
    for event, (commands, sent) in zip(
        happening, outcomes(new_core(), happening, drained_every=DRAINED_EVERY), strict=True
    ):
        if event.packet is None:
            out += struct.pack("<B4H", commands is not None, *(commands or STILL))
        for service, channel, payload in sent:
            out += bytes([service, channel, len(payload)]) + payload
    return bytes(out)
