"""A whole simulated rig on real wires, and the file that states its true values."""

import re
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial
from twisted.internet.posixbase import PosixReactorBase

from cfid.errors import ConfigError
from cfid.records.rig_file import Rig, thesis_rig
from cfid.sim.devices import SimulatedRig
from cfid.sim.service import ServedRig
from cfid.sim.truth import load_truth
from cfid.wire.e201 import PositionReader
from cfid.wire.rdt import Command, Request, decode_records, encode_request
from cfid.wire.rls import decode_words

InReactor = Callable[[Callable[[], Any]], Any]


def rig_of(rig: Rig, *, seed: int = 7, seconds: Callable[[], float] = lambda: 0.0, **options: Any) -> SimulatedRig:
    return SimulatedRig(rig, seconds=seconds, seed=seed, **options)


def test_both_instruments_watch_something_that_moves(
    reactor: PosixReactorBase, in_reactor: InReactor, tmp_path: Path
) -> None:
    rig = rig_of(thesis_rig(), seconds=reactor.seconds, axis="y", commands=(40000,) * 4)
    served = ServedRig(rig, reactor=reactor, folder=tmp_path)
    addresses = in_reactor(served.open)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(2)
        client.sendto(encode_request(Request(Command.REAL_TIME, 3500)), (addresses.address, addresses.rdt_port))
        records = decode_records(b"".join(client.recv(2048) for _ in range(3500)))
    reader = PositionReader(word_bits=22)
    with serial.Serial(str(addresses.encoder_port), timeout=2) as port:
        readings = []
        for _ in range(300):
            port.write(b"!")
            readings += reader.feed(port.read_until(b"\r"))
            time.sleep(1e-3)  # together half a period, wherever in its swing the body is
    in_reactor(served.close)
    words = decode_words(np.array([reading.position for reading in readings]))

    assert records["counts"][-700:, 2].mean() / 1e6 == pytest.approx(1.4 + 4 * 0.0732, rel=0.02)
    assert len(readings) == 300
    assert words.valid.all()
    assert np.ptp(words.position) > 10
    assert reader.rejected == 0


def test_a_truth_says_what_it_says(tmp_path: Path) -> None:
    (tmp_path / "truth.toml").write_text(
        "[vehicle]\ninertia_kg_m2 = [[2e-5, 0, 0], [0, 2e-5, 0], [0, 0, 3e-5]]\n"
        "[axis]\ncoulomb_nm = 1e-4\n[rotors]\ntime_constant_s = 0.1\n[loadcell]\nbias = [0, 0, 0, 0, 0, 0]\n"
        "[crazyflie]\nfirmware = 'stock'\nrpm_deck = true\nclock_skew = -0.01\n[battery]\nkind = 'lipo'\ncharge = 0.5\n"
        "[radio]\nlatency_s = 0.028\njitter_s = 0.008\nloss = 0.01\n"
    )
    truth = load_truth(tmp_path / "truth.toml")
    assert truth.vehicle.inertia_kg_m2[2] == (0, 0, 3e-5)
    assert truth.axis.coulomb_nm == 1e-4
    assert truth.rotors.time_constant_s == 0.1
    assert truth.loadcell.bias == (0,) * 6
    assert truth.loadcell.counts_per_n == 1e6
    assert (truth.crazyflie.firmware, truth.crazyflie.rpm_deck, truth.crazyflie.clock_skew) == ("stock", True, -0.01)
    assert (truth.battery.kind, truth.battery.charge) == ("lipo", 0.5)
    assert (truth.radio.latency_s, truth.radio.jitter_s, truth.radio.loss) == (0.028, 0.008, 0.01)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[rotors]\ntime_constant = 0.1", "rotors.time_constant"),
        ("[rotors]\ntime_constant_s = '0.1'", "rotors.time_constant_s"),
        ("[loadcell]\nbias = [0, 0]", "loadcell.bias"),
        ("[motors]", "motors"),
        ("[crazyflie]\nfirmware = 'new'", "crazyflie.firmware"),
        ("[battery]\nkind = 'lead'", "battery.kind"),
        ("[radio]\nlatency_s = 0.001\njitter_s = 0.002", "before it was sent"),
        ("[vehicle]\ninertia_kg_m2 = [[1, 1, 0], [0, 1, 0], [0, 0, 1]]", "symmetric"),
        ("[vehicle]\ninertia_kg_m2 = [[1, 0, 0], [0, 1, 0], [0, 0, 3]]", "no body"),
        ("nonsense", "TOML"),
        (None, "no such file"),
    ],
)
def test_a_wrong_truth_names_file_and_key(tmp_path: Path, text: str | None, expected: str) -> None:
    path = tmp_path / "truth.toml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigError, match=re.escape(expected)) as caught:
        load_truth(path)
    assert str(path) in str(caught.value)
