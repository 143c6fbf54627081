"""The card's configuration of the page on a Brushless logs what fits take, as many variables as the firmware logs."""

from pathlib import Path

import numpy as np

from cfid.flight.data import read_flight
from cfid.motors.rotor.data import followed
from cfid.sim.flying import VEHICLES, fly
from cfid.sim.pilot import manoeuvres
from tests.lab import ROOT
from tests.logs.usd_bytes import bytes_of, written

LINES = (ROOT / "docs/how-to/usd-brushless.txt").read_text(encoding="utf-8").splitlines(keepends=True)
HEAD, VARIABLES = [line.partition("#")[0].strip() for line in LINES[:7]], [line.strip() for line in LINES[7:]]
MOST = 20  # MAX_USD_LOG_VARIABLES_PER_EVENT of the firmware
SECONDS, HZ = 6.0, 500


def test_the_configuration_is_of_the_firmwares_form() -> None:
    version, buffer_bytes, name, starts, event, rate_hz, mode = HEAD

    assert (version, starts, event, rate_hz, mode) == ("1", "0", "on:fixedFrequency", str(HZ), "1")
    assert int(buffer_bytes) >= 4 * 100  # rows
    assert len(name) <= 10
    assert len(VARIABLES) == MOST
    assert all(line.endswith("\n") and len(line) <= 31 for line in LINES[7:])  # a line without its end is not read


def test_a_card_of_it_holds_a_flight_and_the_speeds_of_all_rotors(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    columns = fly([VEHICLES["brushless_38"]], manoeuvres(["tilts"], SECONDS, rng)[np.newaxis], rngs=[rng]).columns(0)
    event = (65535, "fixedFrequency", [f"{name}(f)" for name in VARIABLES])
    rows = zip(*(columns[name] for name in VARIABLES), strict=True)
    records = [(65535, 5_000_000 + 1_000_000 // HZ * at, row) for at, row in enumerate(rows)]
    log = written(tmp_path, bytes_of([event], records))

    flight = read_flight(log).flight
    assert flight.speeds is not None
    assert flight.velocity is not None
    assert set(followed(log).rotors) == {1, 3}  # for the commands of all there is no place
