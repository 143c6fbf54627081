"""A simulated flight written as ULog and as blackbox, with the axes, motors and units of PX4 and Betaflight."""

import struct
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import DataError
from cfid.flight.data import read_flight
from cfid.flight.result import fit
from cfid.recordings.crazyflie import channel
from tests.flight.flying import STEP, Fleet, fleet, fly
from tests.flight.test_flight_fits import body_of
from tests.lab import Cfid
from tests.logs.autopilot_bytes import message, signed, unsigned

Array = npt.NDArray[np.float64]

G = 9.80665
FRONT_RIGHT, REAR_RIGHT, REAR_LEFT, FRONT_LEFT = range(4)  # indices of the Crazyflie's motors


Flown = tuple[Fleet, Array, Array, Array]


@pytest.fixture(scope="module")
def flown() -> Flown:
    """A vehicle, its commands (n, 4) from 0 to 1, rates (n, 3) in rad/s and specific forces (n, 3) in m/s^2."""
    rng = np.random.default_rng(4)
    vehicles = fleet(1, rng)
    (log,) = fly(vehicles, rng, seconds=18.0)
    commands = np.column_stack([channel(log, f"motor.m{motor}").value / 65535 for motor in (1, 2, 3, 4)])
    rates, forces = (
        np.column_stack([channel(log, f"{name}.{axis}").value for axis in "xyz"]) for name in ("gyro", "acc")
    )
    return vehicles, commands, rates, forces


def corners_m(forward_m: float, right_m: float) -> list[tuple[float, float]]:
    """Return the positions of PX4's rotors, forward and right, at the corners of a rectangle."""
    return [(forward_m, right_m), (-forward_m, -right_m), (forward_m, -right_m), (-forward_m, right_m)]


def ulog(
    commands: Array,
    rates: Array,
    forces: Array,
    *,
    every: int = 1,
    places_m: Sequence[tuple[float, float]] = (),
    others: Sequence[float] = (),
) -> bytes:
    """Return a ULog of PX4's quad X, x forward, y right, z down, with motors in one of `every` rows.

    `places_m` are the rotors' positions in its parameters. `others` are the commands of further motors, divided by the
    mean command of the four.
    """
    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000) + message("B", bytes(40))
    head += message("F", b"sensor_combined:uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;")
    head += message("F", b"actuator_motors:uint64_t timestamp;float[12] control;")
    for at, place in enumerate(places_m):
        for axis, value in zip("XY", place, strict=True):
            key = f"float CA_ROTOR{at}_P{axis}".encode()
            head += message("P", bytes([len(key)]) + key + struct.pack("<f", value))
    head += message("A", struct.pack("<BH", 0, 0) + b"sensor_combined")
    head += message("A", struct.pack("<BH", 0, 1) + b"actuator_motors")
    order, down = [FRONT_RIGHT, REAR_LEFT, FRONT_LEFT, REAR_RIGHT], [1, -1, -1]
    rows = []
    for at, (command, rate, force) in enumerate(zip(commands[:, order], rates * down, forces * down, strict=True)):
        now_us = 10_000 + round(1e6 * STEP * at)
        rows.append(message("D", struct.pack("<HQ6f", 0, now_us, *rate, *force)))
        if at % every == 0:
            further = [*(float(np.mean(command)) * share for share in others), *(8 - len(others)) * [float("nan")]]
            rows.append(message("D", struct.pack("<HQ12f", 1, now_us, *command, *further)))
    return head + b"".join(rows)


def blackbox(
    commands: Array,
    rates: Array,
    forces: Array,
    *,
    others: int = 0,
    headers: Sequence[str] = (),
    tenths: bool = False,
) -> bytes:
    """Return a blackbox log of Betaflight's quad X, x forward, y left, z up; `others` more motors repeat the first.

    Rates are in deg/s, or in `tenths` of that.
    """
    names = [f"{name}[{place}]" for name in ("gyroADC", "accSmooth") for place in range(3)]
    motors = [f"motor[{place}]" for place in range(4 + others)]
    head = [
        "Product:Blackbox flight data recorder by Nicholas Sherlock",
        "Data version:2",
        "I interval:1",
        "P interval:1",
        "Field I name:" + ",".join(["loopIteration", "time", *names, *motors]),
        "Field I signed:0,0" + len(names) * ",1" + len(motors) * ",0",
        "Field I predictor:" + ",".join((2 + len(names) + len(motors)) * "0"),
        "Field I encoding:1,1" + len(names) * ",0" + len(motors) * ",1",
        "Field P predictor:" + ",".join((2 + len(names) + len(motors)) * "0"),
        "Field P encoding:1,1" + len(names) * ",0" + len(motors) * ",1",
        "motorOutput:0,2000",
        "motor_poles:14",
        "Firmware revision:Betaflight 2025.12.1",
        "gyro_scale:0x3f800000",
        "acc_1G:2048",
        *headers,
    ]
    order = [REAR_RIGHT, FRONT_RIGHT, REAR_LEFT, FRONT_LEFT, *others * [REAR_RIGHT]]
    shown = np.rint(np.column_stack([np.degrees(rates) * (10 if tenths else 1), 2048 * forces / G])).astype(int)
    driven = np.rint(2000 * commands[:, order]).astype(int)
    rows = b""
    for at, (sensors, outputs) in enumerate(zip(shown.tolist(), driven.tolist(), strict=True)):
        values = (*map(signed, sensors), *map(unsigned, outputs))
        rows += b"I" + unsigned(at) + unsigned(1000 + round(1e6 * STEP * at)) + b"".join(values)
    return "".join(f"H {line}\n" for line in head).encode() + rows + b"E\xffEnd of log\0"


def imported(cfid: Cfid, log: Path) -> Path:
    """Import a log into a new campaign and return the run's folder."""
    assert cfid("new", "lab", "--kind", "simulated").returncode == 0
    assert cfid("import", log, "--kind", "flight", folder=log.parent / "lab").returncode == 0
    (run,) = (log.parent / "lab" / "runs").iterdir()
    return run


@pytest.mark.parametrize(
    ("library", "written"), [("pyulog", partial(ulog, places_m=corners_m(0.0325, 0.0325))), ("orangebox", blackbox)]
)
def test_a_flight_of_another_autopilot_gives_the_vehicle_back(
    tmp_path: Path, flown: Flown, library: str, written: Callable[..., bytes]
) -> None:
    pytest.importorskip(library, reason=f"{library} is not installed")
    vehicles, *signals = flown
    (tmp_path / "log").write_bytes(written(*signals))
    result = fit([read_flight(tmp_path / "log")], body=body_of(vehicles, 0))
    assert result.accepted
    assert not any("moment" in finding.code or "way" in finding.code for finding in result.findings)
    for axis, moment in zip(("roll", "pitch", "yaw"), vehicles.moments[0].tolist(), strict=True):
        found = result.quantities[f"flight.inertia_kg_m2.{axis}"]
        assert found.value == pytest.approx(moment, abs=3 * found.std)
        assert found.std < 0.08 * moment


def test_px4_s_usual_rate_of_motors_is_refused_with_the_profile_that_serves(tmp_path: Path, flown: Flown) -> None:
    pytest.importorskip("pyulog", reason="pyulog is not installed")
    (tmp_path / "log").write_bytes(ulog(*flown[1:], every=50))
    with pytest.raises(DataError, match=r"readings 100 ms apart .*SDLOG_PROFILE"):
        read_flight(tmp_path / "log")


def test_moments_of_rotors_that_the_log_places_off_a_square_are_refused(
    tmp_path: Path, cfid: Cfid, flown: Flown
) -> None:
    """With the lever of a square, one would be 11 % too small and the other 16 % too large, with 1 % stated."""
    pytest.importorskip("pyulog", reason="pyulog is not installed")
    (tmp_path / "log.ulg").write_bytes(ulog(*flown[1:], places_m=corners_m(0.050, 0.065)))
    run = imported(cfid, tmp_path / "log.ulg")
    result = fit([read_flight(run)], body=body_of(flown[0], 0))
    (refused,) = [one for one in result.findings if one.severity == "rejection"]
    assert refused.code == "flight-rotors-off-square"
    assert refused.quantities == ("flight.inertia_kg_m2.roll", "flight.inertia_kg_m2.pitch")


@pytest.mark.parametrize(
    ("library", "written", "own"),
    [("pyulog", partial(ulog, others=(1.0, 1.0)), "control"), ("orangebox", partial(blackbox, others=2), "motor")],
)
def test_a_hexarotor_s_flight_is_neither_fitted_nor_predicted(
    tmp_path: Path, cfid: Cfid, flown: Flown, library: str, written: Callable[..., bytes], own: str
) -> None:
    """Fitted as a quadrocopter's, its thrust and its moment about yaw would be 50 % too large."""
    pytest.importorskip(library, reason=f"{library} is not installed")
    (tmp_path / "log").write_bytes(written(*(signal[:6000] for signal in flown[1:])))
    run = imported(cfid, tmp_path / "log")
    for log in ("log", run):
        for command in (("fit", "flight", log, "--mass-kg", 0.03), ("validate", log, "--with", "gym-pybullet-drones")):
            done = cfid(*command)
            assert done.returncode == 5
            assert f"{own}[4], {own}[5]" in " ".join(done.stderr.split())


@pytest.mark.parametrize(("library", "written"), [("pyulog", ulog), ("orangebox", blackbox)])
def test_an_imported_flight_of_another_autopilot_is_that_of_its_file(
    tmp_path: Path, cfid: Cfid, flown: Flown, library: str, written: Callable[..., bytes]
) -> None:
    pytest.importorskip(library, reason=f"{library} is not installed")
    (tmp_path / "log").write_bytes(written(*(signal[:6000] for signal in flown[1:])))
    run = imported(cfid, tmp_path / "log")
    expected = read_flight(tmp_path / "log").flight
    found = read_flight(run).flight
    for name in ("rates", "force", "drive"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("library", "written", "gone", "instead", "stated"),
    [
        ("pyulog", ulog, b"actuator_motors", b"actuator_unused", "no topic actuator_motors"),
        ("orangebox", blackbox, b"H motorOutput:0,2000\n", b"", "motorOutput"),
        ("orangebox", blackbox, b"motor[", b"servo[", "blackbox_disable_motors = OFF"),
    ],
)
def test_a_log_without_commands_is_refused_with_what_its_format_lacks(
    tmp_path: Path, flown: Flown, library: str, written: Callable[..., bytes], gone: bytes, instead: bytes, stated: str
) -> None:
    pytest.importorskip(library, reason=f"{library} is not installed")
    content = written(*(signal[:2000] for signal in flown[1:]))
    (tmp_path / "log").write_bytes(content.replace(gone, instead))
    with pytest.raises(DataError, match=stated):
        read_flight(tmp_path / "log")


def test_a_blackbox_log_that_has_the_gyro_unfiltered_alone_is_read(tmp_path: Path, flown: Flown) -> None:
    pytest.importorskip("orangebox", reason="orangebox is not installed")
    content = blackbox(*(signal[:6000] for signal in flown[1:]))
    (tmp_path / "usual").write_bytes(content)
    (tmp_path / "unfiltered").write_bytes(content.replace(b"gyroADC", b"gyroUnfilt"))
    usual, unfiltered = read_flight(tmp_path / "usual"), read_flight(tmp_path / "unfiltered")
    np.testing.assert_array_equal(unfiltered.flight.rates, usual.flight.rates)


def test_a_blackbox_log_of_high_resolution_counts_tenths_also_when_imported(
    tmp_path: Path, cfid: Cfid, flown: Flown
) -> None:
    pytest.importorskip("orangebox", reason="orangebox is not installed")
    signals = [signal[:6000] for signal in flown[1:]]
    (tmp_path / "usual").write_bytes(blackbox(*signals, headers=["blackbox_high_resolution:0"]))
    (tmp_path / "log").write_bytes(blackbox(*signals, headers=["blackbox_high_resolution:1"], tenths=True))
    run = imported(cfid, tmp_path / "log")
    expected = read_flight(tmp_path / "usual").flight.rates
    for path in (tmp_path / "log", run):
        np.testing.assert_allclose(read_flight(path).flight.rates, expected, atol=np.radians(0.6))


def test_rotors_that_turn_the_other_way_unstated_are_named_and_can_be_given(tmp_path: Path, flown: Flown) -> None:
    pytest.importorskip("orangebox", reason="orangebox is not installed")
    vehicles, commands, rates, forces = flown
    (tmp_path / "log").write_bytes(blackbox(commands, rates * [1, 1, -1], forces))
    result = fit([read_flight(tmp_path / "log")], body=body_of(vehicles, 0))
    (refused,) = [one for one in result.findings if one.severity == "rejection"]
    assert (refused.code, refused.quantities) == ("flight-wrong-way", ("flight.inertia_kg_m2.yaw",))
    given = fit([read_flight(tmp_path / "log", props_out=True)], body=body_of(vehicles, 0))
    assert not given.rejected
    found = given.quantities["flight.inertia_kg_m2.yaw"]
    assert found.value == pytest.approx(float(vehicles.moments[0, 2]), abs=3 * found.std)


def test_a_flight_under_four_motors_while_others_stand_still_is_fitted(tmp_path: Path, flown: Flown) -> None:
    pytest.importorskip("pyulog", reason="pyulog is not installed")
    vehicles, *signals = flown
    (tmp_path / "log").write_bytes(ulog(*signals, others=(0.0,)))
    result = fit([read_flight(tmp_path / "log")], body=body_of(vehicles, 0))
    assert result.accepted
    assert not {"flight.inertia_kg_m2.roll", "flight.inertia_kg_m2.pitch"} & set(result.rejected)
