"""Commands that drive motors, as their operator sees them; whatever ends one of them stops the motors."""

import contextlib
import json
import re
import resource
import signal
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import pytest

from cfid.records.files import RIG_FILE
from cfid.records.rig_file import load_rig
from cfid.records.run import Run, list_runs
from cfid.rig.stop import MAY_BE_RUNNING
from cfid.sim.propulsion import Four
from cfid.sim.supervisor import SupervisorState
from tests.flying_in_a_folder import bench_in as served_in
from tests.virtual_bench import Bench, Pilot, bench_in

VEHICLES: dict[str, dict[str, Any]] = {
    "app": {"firmware": "app"},
    "stock": {"firmware": "stock"},
    "app, Brushless": {"firmware": "app", "platform": "cf21bl"},
    "stock, Brushless": {"firmware": "stock", "platform": "cf21bl"},
    "app, deck": {"firmware": "app", "rpm_deck": True},
    "stock, deck": {"firmware": "stock", "rpm_deck": True},
}
BARE = ("app", "stock", "app, Brushless", "stock, Brushless")
BOTH = pytest.mark.parametrize("firmware", ["app", "stock"])
STOPPED_WITHIN_S = 0.7
LOCKS_AFTER_S = 2.6  # longer than it takes until an old setpoint locks a vehicle
ALL = ("--motor", "1,2,3,4")
STEP = ("--from", 20000, "--to", 20000, "--hold", 0.8, "--rest", 0.5, *ALL, "--yes")
QUICK = ("--from", 10000, "--to", 30000, "--step", 10000, "--hold", 0.6, "--rest", 0.3, "--yes")
CONSOLE = "space, Enter, s"  # in the console's help, after which it listens


@pytest.fixture
def bench(tmp_path: Path) -> Any:
    with bench_in(tmp_path) as bench:
        yield bench


def runs_of(bench: Bench) -> list[Run]:
    return [run for run in list_runs(bench.folder / "runs") if isinstance(run, Run)]


def type_at_console(pilot: Pilot, text: str) -> None:
    pilot.wait_until_said(CONSOLE)
    pilot.type(text)


# Each command with its default options, on each vehicle that it is for


class Driving(NamedTuple):
    """A command's words, what is typed, the vehicles that it is for, and whether motors turn."""

    words: tuple[object, ...]
    typed: str = ""
    vehicles: tuple[str, ...] = ("app", "stock, Brushless")
    drives: bool = True


COMMANDS = {
    "log thrust": Driving(STEP),
    "log speed": Driving(STEP, "12000\n"),
    "log speed --tachometer deck": Driving(STEP, vehicles=("stock, deck",)),
    "log speed --tachometer brushless": Driving(STEP, vehicles=("app, Brushless",)),
    "log scales": Driving(STEP, "30\n"),
    "log sine": Driving(("--hz", "8,16", "--for", 1, "--yes"), vehicles=("app", "app, Brushless", "app, deck")),
    "log wind": Driving(
        ("--wind", 0, "--tachometer", "none", "--commands", 20000, "--hold", 0.8, "--rest", 0.5, "--yes")
    ),
    "log ping": Driving(("--count", 5), drives=False),
    "log gyro": Driving(("--axis", "x", "--for", 1), drives=False),
    "motors": Driving(("--yes",), "1 2 3 4 20000\n0\n"),
    "motors set": Driving((20000, "--for", 0.5, "--yes")),
    "motors stop": Driving((), drives=False),
}


@pytest.mark.parametrize(("name", "vehicle"), [(name, one) for name, c in COMMANDS.items() for one in c.vehicles])
def test_a_command_ends_well_with_its_default_options(tmp_path: Path, name: str, vehicle: str) -> None:
    command, radio = COMMANDS[name], {"latency_s": 0.004, "jitter_s": 0.001}
    with bench_in(tmp_path, crazyflie=VEHICLES[vehicle], battery={"kind": "lipo"}, radio=radio) as bench:
        pilot = bench.start(*name.split(), *command.words, typed=command.typed)
        assert pilot.end() == 0, f"{pilot.out}{pilot.err}"
        assert any(any(motors) for _, motors in bench.history) == command.drives
        assert not any(bench.motors)
        assert [run.header.state for run in runs_of(bench)] == ["complete"] * name.startswith("log ") * (
            2 if name == "log sine" else 1
        )


# Ways out: the motors are off 0.7 s later, and stay off


HOLD = ("motors", "set", 30000, "--yes")
STAIRS = ("log", "thrust", *ALL, "--from", 30000, "--to", 30000, "--hold", 20, "--rest", 0.3, "--yes")
SINES = ("log", "sine", "--motor", 1, "--hz", "2.5,3", "--for", 40, "--yes")
ORDER = "1 2 3 4 30000\n"

Act = Callable[[Bench, Pilot], None]


def wait(bench: Bench, pilot: Pilot) -> None:
    """Do nothing, since the command ends by itself."""
    pilot.wait_until(lambda: pilot.code is not None or not any(bench.motors), "an end")


def request(*names: str) -> Act:
    def act(bench: Bench, pilot: Pilot) -> None:
        for name in names:
            pilot.request_end(name)
            pilot.go_on_for(0.01)

    return act


def vehicle(**faults: Any) -> Act:
    return lambda bench, pilot: bench.vehicle_suffers(**faults)


def loadcell(**faults: Any) -> Act:
    return lambda bench, pilot: bench.loadcell_suffers(**faults)


def overload(bench: Bench, pilot: Pilot) -> None:
    bench.rig.loadcell.box.load_cell.overload()


def fill_disk(bench: Bench, pilot: Pilot) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))


def break_program(bench: Bench, pilot: Pilot) -> None:
    """Raise an error once, where the program asks its hardware how long it was suspended."""

    def broken() -> float:
        del bench.hardware.suspended_s
        raise RuntimeError("a bug")

    bench.hardware.suspended_s = broken  # type: ignore[method-assign]


def typing(text: str) -> Act:
    return lambda bench, pilot: pilot.type(text)


def hang_up(bench: Bench, pilot: Pilot) -> None:
    assert pilot.keyboard is not None
    pilot.keyboard.hang_up()


class Way(NamedTuple):
    """A way to end a command: its words, what happens while motors run, its exit code, and a word of its message."""

    words: tuple[object, ...]
    act: Act
    code: int
    told: str = ""
    keyboard: Mapping[str, Any] = {}
    vehicles: tuple[str, ...] = ("app", "stock, Brushless")
    own_delay_s: float = 0.0  # until the fault counts as one


SCRIPT, TERMINAL = {"script": True}, {"terminal": True}
WITH_APP = ("app", "app, Brushless")
LATE = 0.5
WAYS: dict[str, Way] = {
    "time over": Way((*HOLD, "--for", 0.5), wait, 0),
    "a bug": Way(HOLD, break_program, 1),
    "Ctrl-C": Way(HOLD, request("SIGINT"), 0, vehicles=BARE),
    "Ctrl-C twice": Way(HOLD, request("SIGINT", "SIGINT"), 0),
    "SIGHUP in a staircase": Way(STAIRS, request("SIGHUP"), 0),
    "SIGTERM in a sine": Way(SINES, request("SIGTERM"), 0, vehicles=WITH_APP),
    "Ctrl-C in wind": Way(
        ("log", "wind", "--wind", 0, "--commands", 30000, "--hold", 20, "--rest", 0.3, "--yes", "--tachometer", "none"),
        request("SIGINT"),
        0,
    ),
    "link silent": Way(HOLD, vehicle(silent_after_s=0), 3, vehicles=WITH_APP),
    "link closed": Way(HOLD, vehicle(closed_after_s=0), 3, vehicles=WITH_APP),
    "link silent in a sine": Way(SINES, vehicle(silent_after_s=0), 3, vehicles=WITH_APP),
    "battery low": Way((*HOLD, "--for", 30), vehicle(low_battery_after_s=0), 3, "battery", own_delay_s=LATE),
    "battery low in a sine": Way(
        SINES, vehicle(low_battery_after_s=0), 3, "battery", vehicles=WITH_APP, own_delay_s=LATE
    ),
    "load cell lost": Way(STAIRS, loadcell(silent_after_s=0), 3, own_delay_s=LATE),
    "load cell lost in a sine": Way(SINES, loadcell(silent_after_s=0), 3, vehicles=WITH_APP, own_delay_s=LATE),
    "overload": Way(STAIRS, overload, 3, "saturation"),
    "disk full": Way(STAIRS, fill_disk, 4, "too large"),
    "nonsense typed": Way(("motors", "--yes"), typing("1 99999\n"), 2, "99999", SCRIPT),
    "script over": Way(("motors", "--yes"), hang_up, 0, "", SCRIPT),
    "Ctrl-D": Way(("motors", "--yes"), typing("\x04"), 0, "", TERMINAL),
    "Ctrl-D in a line": Way(("motors", "--yes"), typing("2 4\x04"), 0, "", TERMINAL),
    "terminal hung up": Way(("motors", "--yes"), hang_up, 0, "", TERMINAL),
}
GONE_WRONG = {SupervisorState.LEVEL_OUT, SupervisorState.FREE_FALL, SupervisorState.LOCKED}


@pytest.mark.parametrize(("name", "kind"), [(name, kind) for name, way in WAYS.items() for kind in way.vehicles])
def test_the_motors_stop_whatever_ends_the_command(tmp_path: Path, name: str, kind: str) -> None:
    way = WAYS[name]
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    with contextlib.ExitStack() as undone:
        bench = undone.enter_context(bench_in(tmp_path, crazyflie=VEHICLES[kind], battery={"kind": "lipo"}))
        undone.callback(resource.setrlimit, resource.RLIMIT_FSIZE, limit)
        pilot = bench.start(*way.words, **way.keyboard)
        if way.keyboard:
            type_at_console(pilot, ORDER)
        pilot.wait_until(lambda: any(motors > 7000 for motors in bench.motors), "motors")
        pilot.go_on_for(0.2)
        began_s = bench.hardware.seconds()
        way.act(bench, pilot)
        if way.act is wait:
            began_s = bench.hardware.seconds()
        if way.act is break_program:
            with pytest.raises(RuntimeError, match="a bug"):
                pilot.end()
        else:
            assert pilot.end() == way.code, f"{pilot.out}{pilot.err}"
        assert way.told in pilot.err
        if way.act is fill_disk:
            began_s = bench.history[-1][0]
        bench.hardware.pause(STOPPED_WITHIN_S)  # the app stops the motors by itself where no link is left
        assert bench.stopped_after(began_s + way.own_delay_s) < STOPPED_WITHIN_S
        last = bench.history[-1]
        assert MAY_BE_RUNNING not in pilot.err
        bench.hardware.pause(LOCKS_AFTER_S)
        assert bench.history[-1] == last
        assert bench.rig.crazyflie.vehicle.supervisor.state not in GONE_WRONG


@pytest.mark.parametrize("words", [HOLD, STAIRS], ids=["set", "thrust"])
@pytest.mark.parametrize("fault", ["silent_after_s", "closed_after_s"])
def test_stock_firmware_without_a_link_is_the_exception_and_the_operator_is_told(
    tmp_path: Path, fault: str, words: tuple[object, ...]
) -> None:
    with bench_in(tmp_path, crazyflie=VEHICLES["stock"], battery={"kind": "lipo"}) as bench:
        pilot = bench.start(*words)
        pilot.wait_until_motors_run()
        driven = bench.motors
        bench.vehicle_suffers(**{fault: 0})
        assert pilot.end() == 3
        assert MAY_BE_RUNNING in pilot.err
        assert bench.motors == driven  # the motors do still run


@pytest.mark.parametrize(
    ("numbers", "codes"),
    [
        ((signal.SIGINT, signal.SIGINT), (0, 130, -signal.SIGINT)),  # the second may arrive as the interpreter exits
        ((signal.SIGTSTP,), (0,)),
        ((signal.SIGKILL,), (-signal.SIGKILL,)),
    ],
    ids=["Ctrl-C twice", "Ctrl-Z", "SIGKILL"],
)
def test_a_signal_to_the_process_stops_the_motors(
    tmp_path: Path, numbers: tuple[int, ...], codes: tuple[int, ...]
) -> None:
    with served_in(tmp_path) as bench:
        pilot = bench.start(*HOLD)
        pilot.wait_until_motors_run()
        began_s = time.monotonic()
        pilot.send(*numbers)
        assert pilot.end() in codes, pilot.err
        assert bench.stopped_after(began_s) < STOPPED_WITHIN_S


@pytest.mark.parametrize(("firmware", "before_s"), [("app", 0.02), ("stock", 0.12)])
def test_an_end_shortly_before_a_step_leaves_no_motor_on(tmp_path: Path, firmware: str, before_s: float) -> None:
    """Actions that the procedure was about to take when the end was requested must not come after the stop."""
    radio = {"latency_s": 0.0285, "jitter_s": 0.008}
    with bench_in(tmp_path, crazyflie={"firmware": firmware}, radio=radio) as bench:
        pilot = bench.start("log", "thrust", *QUICK)
        pilot.wait_until_motors_run(0.0)
        pilot.go_on_for(0.6 + 0.3 - before_s)
        pilot.request_end()
        assert pilot.end() == 0, pilot.err
        bench.hardware.pause(1.0)
        assert not any(bench.motors)


def test_a_stop_counts_where_nothing_can_be_printed(bench: Bench) -> None:
    with Path("/dev/full").open("w") as full:
        ended = bench.start("motors", "set", 20000, "--for", 0.3, "--yes", stdout=full)
        assert ended.end() == 0, ended.err
        with contextlib.suppress(OSError):
            full.close()
    assert "motors stopped, confirmed in" in ended.err
    assert not any(bench.motors)


# Before anything turns


@pytest.mark.parametrize(("typed", "code"), [("y\n", 0), ("n\n", 2), ("", 2)])
@pytest.mark.parametrize("words", [("motors", "set", 20000, "--for", 0.3), ("log", "thrust", *QUICK[:-1])])
def test_the_operator_confirms_before_a_motor_turns(
    bench: Bench, words: tuple[object, ...], typed: str, code: int
) -> None:
    pilot = bench.start(*words, typed=typed)
    assert pilot.end() == code, pilot.err
    assert bench.uri in pilot.err
    assert ("fastened" in pilot.err) == ("[y/N]" in pilot.err) is True
    assert (len(bench.history) > 1) == (code == 0)
    assert (bench.folder / "runs").exists() == (code == 0 and words[0] == "log")


@pytest.mark.parametrize(
    "words",
    [
        *("log sine --hz 1,x", "log sine --hz 251", "log sine --for 4 --hz 2,0.3", "log sine --hz 4,4"),
        *(
            "log sine --hz 4 --amplitude 30001",
            "log sine --hz 4 --for 0",
            "log sine --motor 1,5",
            "log sine --amplitude 0",
        ),
        *("log sine --hz 4 --plan thesis-first", "log thrust some-run"),
        *("log thrust --from 3000 --to 2000", "log thrust --hold 0", "log thrust --hold 1e99"),
        *(
            "log thrust --step 100000",
            "log thrust --to 70000",
            "log speed --port /dev/x",
        ),
        *("motors set 70000", "motors set 1000 --motor 5"),
    ],
)
def test_what_cannot_be_meant_so_is_told_first(bench: Bench, words: str) -> None:
    assert bench.start(*words.split()).end() == 2
    assert len(bench.history) == 1


@pytest.mark.parametrize(
    ("words", "state"), [(("log", "thrust", *QUICK), "locked"), (HOLD, "tumbled"), (("motors", "--yes"), "locked")]
)
def test_a_vehicle_that_cannot_run_is_refused_by_its_state_before_a_run_folder_exists(
    bench: Bench, words: tuple[object, ...], state: str
) -> None:
    bench.vehicle_suffers(**{"emergency_after_s" if state == "locked" else "tumble_after_s": 0})
    bench.hardware.pause(1.0)
    pilot = bench.start(*words)
    assert pilot.end() == 3
    assert f"the vehicle is {state}: " in pilot.err
    assert runs_of(bench) == []
    supervisor = checked(bench)["supervisor"]
    assert (supervisor["answer"], supervisor["state"], bool(supervisor["advice"])) == (state, "fault", True)


def checked(bench: Bench) -> dict[str, dict[str, str]]:
    """Return what `cfid rig check` answers about the vehicle, by what it asked."""
    pilot = bench.start("rig", "check", "--json")
    pilot.end()
    return {answer["asked"]: answer for answer in json.loads(pilot.out)["devices"]["crazyflie"]}


@pytest.mark.parametrize("faults", [{"protocol": 9}, {"app_protocol": 3}])
def test_rig_check_calls_no_vehicle_ok_that_motors_set_refuses(bench: Bench, faults: dict[str, int]) -> None:
    bench.vehicle_suffers(**faults)
    assert bench.start(*HOLD).end() == 3
    answers = checked(bench)
    assert (answers["link"]["state"], answers["motors"]["state"]) == ("ok", "fault")


@pytest.mark.parametrize(
    ("words", "truth", "told"),
    [
        (("log", "sine", "--hz", 3, "--yes"), {"firmware": "stock"}, "cfid's app"),
        (("log", "speed", "--tachometer", "deck", "--yes"), {}, "no RPM deck"),
    ],
)
def test_a_vehicle_that_lacks_something_is_told_what(
    tmp_path: Path, words: tuple[object, ...], truth: dict[str, Any], told: str
) -> None:
    with bench_in(tmp_path, crazyflie=truth) as bench:
        pilot = bench.start(*words)
        assert pilot.end() == 3
        assert told in pilot.err
        assert len(bench.history) == 1


# What is recorded


def test_a_staircase_is_felt_by_the_load_cell(bench: Bench) -> None:
    pilot = bench.start("log", "thrust", *QUICK[:7], 1, *QUICK[8:], "--json")
    assert pilot.end() == 0, pilot.err
    lost = {name: device["lost"] for name, device in json.loads(pilot.out)["devices"].items()}
    assert lost == dict.fromkeys(("commands", "loadcell", "crazyflie", "supervisor"), 0)
    run = bench.run()
    up_and_down = [10000, 20000, 30000, 20000, 10000]
    assert run.header.requested["steps"] == up_and_down
    commands, cell = (pd.read_csv(run.device_file(name)) for name in ("commands", "loadcell"))
    steps = commands[commands.m1 > 0]
    assert steps.m1.tolist() == steps.m3.tolist() == up_and_down
    means = [
        [cell[cell.t.between(begin_s + from_s, begin_s + to_s)].Fz.mean() for from_s, to_s in ((-0.5, 0), (0.4, 0.98))]
        for begin_s in steps.t
    ]
    thrust_n = [2 * 1.8e-8 * (381 + 0.0408 * step) ** 2 for step in up_and_down]
    assert [(running - at_rest) / 1e6 for at_rest, running in means] == pytest.approx(thrust_n, rel=0.1)


def move_run(folder: Path) -> None:
    folder.rename(folder.parent.parent / "elsewhere")


def block_header(folder: Path) -> None:
    header = folder / "run.toml"
    header.rename(folder / "begun.toml")
    header.mkdir()  # no file can replace a folder, not even for an administrator


@pytest.mark.parametrize(
    ("spoil", "fault", "code"), [(move_run, False, 4), (block_header, False, 4), (block_header, True, 3)]
)
def test_a_run_that_cannot_be_finished_ends_with_how_the_motors_stopped(
    bench: Bench, spoil: Callable[[Path], None], fault: bool, code: int
) -> None:
    pilot = bench.start("log", "thrust", *QUICK)
    pilot.wait_until_motors_run()
    (folder,) = (bench.folder / "runs").iterdir()
    spoil(folder)
    if fault:
        bench.vehicle_suffers(low_battery_after_s=0)
    assert pilot.end() == code, pilot.err
    assert re.search(r"motors stopped, confirmed in \d+ ms", pilot.err)
    assert str(folder) in pilot.err
    assert not any(bench.motors)


@pytest.mark.parametrize(
    ("words", "truth", "lacking"),
    [
        (("thrust",), {}, [20000, 30000, 20000, 10000]),
        (("speed", "--tachometer", "deck"), {"rpm_deck": True}, [30000, 20000]),
    ],
)
def test_an_interrupted_staircase_is_resumed_where_it_ended(
    tmp_path: Path, words: tuple[str, ...], truth: dict[str, Any], lacking: list[int]
) -> None:
    with bench_in(tmp_path, crazyflie=truth) as bench:
        pilot = bench.start("log", *words, *QUICK)
        pilot.wait_until(lambda: bench.motors[0] == lacking[0], "the second step")
        pilot.request_end()
        assert pilot.end() == 0
        again = bench.start("log", words[0], "--resume", "--yes")
        assert again.end() == 0, again.err
        first, second = runs_of(bench)
        assert (first.header.state, second.header.state) == ("interrupted", "complete")
        assert second.header.requested["steps"] == lacking
        assert second.header.requested["hold_s"] == 0.6
        assert first.header.devices.keys() == second.header.devices.keys()
        table = {"thrust": "loadcell", "speed": "tachometer"}[words[0]]
        assert first.header.rig == second.header.rig == load_rig(bench.folder / RIG_FILE).facts.of(table)
        nothing = bench.start("log", words[0], "--resume", second.folder, "--yes")
        assert nothing.end() == 2
        assert "is complete" in nothing.err


@pytest.mark.parametrize("silent", [False, True])
def test_a_staircase_that_ends_in_the_pause_after_its_last_step_is_complete(bench: Bench, silent: bool) -> None:
    pilot = bench.start("log", "thrust", "--from", 20000, "--to", 20000, "--hold", 1, "--rest", 3, "--yes")
    pilot.wait_until_motors_run()
    pilot.wait_until(lambda: not any(bench.motors), "the last pause")
    if silent:
        bench.vehicle_suffers(silent_after_s=0)
    else:
        pilot.request_end()
    assert pilot.end() == (3 if silent else 0), pilot.err
    run = bench.run()
    assert run.header.state == "complete"
    assert ("no keep-alive" in run.header.reason) == silent
    assert run.header.verdict is not None
    assert "--resume" not in pilot.out


def test_sines_are_played_one_after_the_other_and_resumed(bench: Bench) -> None:
    words = ("log", "sine", "--hz", "10,40,80", "--for", 0.5, "--yes")
    pilot = bench.start(*words)
    played = lambda: len(list((bench.folder / "runs").glob("*"))) == 2 and any(bench.motors)  # noqa: E731
    pilot.wait_until(played, "the second sine")
    pilot.request_end("SIGTERM")
    assert pilot.end() == 0
    assert not any(bench.motors)
    stopped = max((bench.folder / "runs").iterdir()).name
    again = bench.start("log", "sine", "--yes", "--resume", stopped, "--json")
    assert again.end() == 0, again.err
    assert json.loads(again.out)["wanted"] == [20, 40]
    states = [(run.header.requested["l"], run.header.state) for run in runs_of(bench)]
    assert states == [(5, "complete"), (20, "interrupted"), (20, "complete"), (40, "complete")]
    last = bench.start(*words, "--resume")
    assert last.end() == 2
    assert "nothing is left" in last.err


# The console


def motors_are(bench: Bench, motors: Four) -> bool:
    return bench.motors == motors


def test_the_console_obeys_keys_at_a_terminal_and_space_stops_at_once(bench: Bench) -> None:
    pilot = bench.start("motors", "--yes", terminal=True)
    pilot.wait_until_said(CONSOLE)
    for keys, motors in [
        ("1 3 20000\n", (20000, 0, 20000, 0)),
        ("\x1b[A", (20500, 0, 20500, 0)),
        ("\x1b[B\x1b[B", (19500, 0, 19500, 0)),
        (" ", (0, 0, 0, 0)),
        ("all 14x\x7f2000\r", (12000,) * 4),
        ("\r", (0, 0, 0, 0)),
        ("7 100\n", (0, 0, 0, 0)),
        ("2 9000\n", (0, 9000, 0, 0)),
        ("4 100s", (0, 0, 0, 0)),
        ("2 9000\n", (0, 9000, 0, 0)),
        ("4  ", (0, 0, 0, 0)),
        ("3 9000\n", (0, 0, 9000, 0)),
        ("1 4\x1b", (0, 0, 0, 0)),
        ("[A", (0, 0, 0, 0)),
        ("1 9000\n", (9000, 0, 0, 0)),
        ("4 30x00 2\n", (0, 0, 0, 0)),
        ("1 9000\n", (9000, 0, 0, 0)),
    ]:
        pilot.type(keys)
        pilot.go_on_for(0.3)
        pilot.wait_until(partial(motors_are, bench, motors), repr(keys))
    pilot.type("q")
    assert pilot.end() == 0
    assert not any(bench.motors)
    assert "not 7" in pilot.err


@BOTH
def test_a_stop_goes_before_all_keys_that_wait(tmp_path: Path, firmware: str) -> None:
    radio = {"latency_s": 0.0285, "jitter_s": 0.008}
    with bench_in(tmp_path, crazyflie={"firmware": firmware}, radio=radio) as bench:
        pilot = bench.start("motors", "--yes", terminal=True)
        type_at_console(pilot, "a 30000\n")
        pilot.wait_until(lambda: bench.motors == (30000,) * 4, "motors")
        for _ in range(60):
            pilot.type("\x1b[A")
            pilot.go_on_for(0.02)
        began_s = bench.hardware.seconds()
        pilot.type(" ")
        pilot.go_on_for(1.5)
        assert bench.stopped_after(began_s) < STOPPED_WITHIN_S
        pilot.type("q")
        assert pilot.end() == 0, pilot.err
