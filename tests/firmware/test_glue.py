"""The app's glue, compiled with prototypes of what it uses of the firmware, and run with stand-ins for these."""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from cfid.sim.app_core import find_source
from cfid.wire.app import PingChannel, SineRequest, ThrustRequest, encode_alive, encode_sine, encode_thrust, omega_of

HERE = Path(__file__).parent
GNU = ("-std=gnu11", "-Wall", "-Wextra", "-Werror")  # the dialect of the firmware's own build
BRUSHED: tuple[str, ...] = ()
BRUSHLESS = ("-DCONFIG_MOTORS_REQUIRE_ARMING=1",)
OWNER, OTHER = 7, 8

Glue = Callable[..., list[str]]


def compiled(folder: Path, *flags: str, prototypes: Path = HERE / "prototypes") -> subprocess.CompletedProcess[str]:
    gcc, core = shutil.which("gcc"), find_source()
    if gcc is None:
        pytest.skip("there is no gcc to compile the app with")
    assert core is not None
    sources = [str(core.with_name("cfid_app.c")), str(core), str(HERE / "run_glue.c")]
    includes = [f"-I{prototypes}", f"-I{core.parent}"]
    command = [gcc, *GNU, *flags, *includes, *sources, "-lm", "-o", str(folder / "glue")]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def brushed(tmp_path_factory: pytest.TempPathFactory) -> Glue:
    return run_with(BRUSHED, tmp_path_factory.mktemp("brushed"))


@pytest.fixture(scope="module")
def brushless(tmp_path_factory: pytest.TempPathFactory) -> Glue:
    return run_with(BRUSHLESS, tmp_path_factory.mktemp("brushless"))


@pytest.fixture(params=["brushed", "brushless"])
def glue(request: pytest.FixtureRequest) -> Glue:
    made: Glue = request.getfixturevalue(request.param)
    return made


def run_with(flags: tuple[str, ...], folder: Path) -> Glue:
    made = compiled(folder, *flags)
    assert made.returncode == 0, made.stderr

    def run(*lines: str) -> list[str]:
        ended = subprocess.run(
            [str(folder / "glue")],
            input="\n".join(lines) + "\n",
            capture_output=True,
            text=True,
            check=True,
            timeout=30,
        )
        return ended.stdout.splitlines()

    return run


def packet(port: int, channel: int, payload: bytes) -> str:
    return f"p {port} {channel} {payload.hex()}"


def alive(owner: int = OWNER) -> str:
    return packet(12, PingChannel.ALIVE, encode_alive(1, owner))


def thrust(command: int, motor: int = 4, owner: int = OWNER) -> str:
    return packet(10, 0, encode_thrust(ThrustRequest(command, motor), owner))


STOP = packet(12, PingChannel.STOP, encode_alive(2))


def seen(events: list[str], what: str) -> list[tuple[int, str]]:
    """Return the round and the rest of each event of this name."""
    parted = (event.split(" ", 2) for event in events)
    return [(int(part[0]), part[2] if len(part) > 2 else "") for part in parted if part[1] == what]


def test_a_release_whose_motors_would_not_obey_is_refused_when_it_is_compiled(tmp_path: Path) -> None:
    older = tmp_path / "prototypes"
    shutil.copytree(HERE / "prototypes", older)
    (older / "led_deck_controller.h").unlink()
    made = compiled(tmp_path, prototypes=older)

    assert made.returncode != 0
    assert "needs firmware 2025.12 or later" in made.stderr


def test_without_keep_alives_the_stock_controller_has_the_motors(glue: Glue) -> None:
    events = glue("v 1 0", "t 100", thrust(20000), "t 100")

    assert seen(events, "motors") == []
    assert [round_ for round_, _ in seen(events, "pid")] == [0]
    assert seen(events, "setpoint") == []


@pytest.mark.parametrize("command", [1, 255, 256, 7000, 20000, 30000, 65534, 65535])
def test_each_command_arrives_at_the_motors_as_itself(glue: Glue, command: int) -> None:
    events = glue("v 1 0", alive(), "t 2", thrust(command), "t 2")

    assert seen(events, "motors")[-1] == (2, f"{command} {command} {command} {command}")


def test_the_setpoint_stays_fresh_until_the_vehicle_has_left_flying_and_is_relaxed_then(glue: Glue) -> None:
    stopped, left = 400, 2400
    events = glue("v 1 1", alive(), thrust(20000), "t 400", STOP, "t 2000", "v 1 0", "t 500")

    fed = [round_ for round_, _ in seen(events, "setpoint")]
    assert max(b - a for a, b in zip([0, *fed], [*fed, left], strict=True)) <= 20
    assert fed[-1] > stopped
    assert [round_ for round_, _ in seen(events, "relax")] == [left]
    assert not [round_ for round_ in fed if round_ >= left]


def test_a_setpoint_that_nobody_feeds_any_more_is_relaxed_once_keep_alives_end(glue: Glue) -> None:
    events = glue("v 1 0", alive(), "t 2000")

    assert [round_ for round_, _ in seen(events, "relax")] == [499]


def test_a_vehicle_that_has_to_be_armed_is_disarmed_by_every_way_its_motors_stop(brushless: Glue) -> None:
    begin = ("v 1 1", alive(), thrust(20000), "t 300")
    sine = packet(11, 0, encode_sine(SineRequest(0, 10000, omega_of(1, 50), 50), OWNER))

    assert seen(brushless(*begin, STOP, "t 100"), "disarm") == [(300, "")]
    assert seen(brushless(*begin, thrust(0), "t 100"), "disarm") == [(300, "")]
    assert seen(brushless(*begin, thrust(0, owner=OTHER), "t 100"), "disarm") == [(300, "")]
    assert seen(brushless(*begin, "t 600"), "disarm")[0] == (499, "")
    assert seen(brushless("v 1 1", alive(), sine, "t 99", alive(), "t 300"), "disarm") == [(100, "")]


def test_a_program_whose_motors_were_stopped_gets_no_hold_again_however_many_follow(brushed: Glue) -> None:
    others = [line for owner in range(100, 107) for line in (alive(owner), "t 1", STOP, "t 1")]
    events = brushed("v 1 0", alive(), "t 1", STOP, "t 1", *others, alive(), thrust(9000), "t 5")

    assert not any("9000" in message for _, message in seen(events, "motors"))


def test_a_brushed_vehicle_is_never_disarmed_and_its_idle_thrust_never_touched(brushed: Glue) -> None:
    events = brushed("v 1 1", alive(), thrust(20000), "t 300", STOP, "t 900")

    assert seen(events, "disarm") == seen(events, "idle") == []


@pytest.mark.parametrize(("command", "off"), [(4255, False), (4256, True), (7000, True), (65535, True)])
def test_idle_thrust_goes_only_while_every_motor_turns_fast_enough_without_it(
    brushless: Glue, command: int, off: bool
) -> None:
    events = brushless("v 1 0", alive(), thrust(command), "t 100", STOP, "t 100")

    assert seen(events, "idle") == ([(0, "0"), (100, "7000")] if off else [])


def test_idle_thrust_stays_while_a_motor_is_at_zero(brushless: Glue) -> None:
    events = brushless("v 1 0", alive(), thrust(20000, 0), "t 100", thrust(20000), "t 100", thrust(0, 2), "t 100")

    assert seen(events, "idle") == [(100, "0"), (200, "7000")]


def test_idle_thrust_comes_back_as_it_was_found_when_the_client_dies(brushless: Glue) -> None:
    events = brushless("i 6200", "v 1 0", alive(), thrust(20000), "t 900")

    assert seen(events, "idle") == [(0, "0"), (499, "6200")]


def test_another_clients_keep_alives_do_not_prolong_a_command(glue: Glue) -> None:
    events = glue("v 1 1", alive(), thrust(20000), "t 400", alive(OTHER), "t 400", alive(OTHER), "t 100")

    assert [(round_, found) for round_, found in seen(events, "motors") if round_ < 499] == [
        (0, "20000 20000 20000 20000")
    ]
    assert (499, "") in seen(events, "pid")
