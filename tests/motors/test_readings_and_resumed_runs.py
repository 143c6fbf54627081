"""What an operator types is checked, a verdict names what the fit will lack, and a resumed run counts as one run."""

from collections.abc import Mapping
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cfid.console.run_summary import judged, verdict_line
from cfid.console.selection import chosen
from cfid.errors import ConfigError, DataError, FitError
from cfid.motors.maps import fit_speed, fit_thrust, fit_torque
from cfid.motors.maps.data import Stand
from cfid.motors.maps.verdict import of_forces, of_readings
from cfid.motors.plan import expected_of, missing
from cfid.motors.weighing import weighed_thrusts
from cfid.recordings.resumed import steps_left
from cfid.recordings.vehicle import shown_at_commands
from cfid.records.choose import labelled
from cfid.records.rig_file import RigFacts, Scales, Tachometer
from cfid.records.run import Run, Verdict, amend_run, read_run, write_header
from tests.lab import DATA, STARTED, Cfid, made_run, new_campaign
from tests.motors.stand_in_a_folder import BEGIN_S, climbed, write_run
from tests.motors.test_motor_fits import content_of, true_thrust_n

COMMANDS = (0, 20000, 30000, 40000, 50000)
MARKED = RigFacts(tachometer=Tachometer(markers=2))
HELD: dict[str, Any] = {"motors": [1, 3], "hold_s": 2.0, "rest_s": 1.0}


def felt(folder: Path, steps: tuple[int, ...], *, torque: float = 1.0, **requested: Any) -> Run:
    """Write a run with the load cell's record of some steps."""
    record = climbed(steps)
    record.wrench[:, 5] *= torque
    return write_run(folder, record, steps=steps, **HELD, **requested)


def typed(
    folder: Path,
    kind: str,
    readings: Mapping[int, float],
    *,
    state: Any = "complete",
    minute: int = 0,
    facts: RigFacts = MARKED,
    **requested: Any,
) -> Run:
    """Write a run with the speeds or weights that an operator typed at commands."""
    columns = {
        "t": BEGIN_S + 60 * minute + np.arange(len(readings)),
        "command": np.array(list(readings)),
        {"speed": "rpm", "scales": "grams"}[kind]: np.array(list(readings.values())),
    }
    return made_run(
        folder,
        kind,
        {"readings": columns},
        state=state,
        started=STARTED + timedelta(minutes=minute),
        facts=facts,
        requested={"steps": tuple(readings), **HELD, **requested},
    )


# Readings


def test_a_speed_is_compared_with_those_of_other_commands_by_the_markers_that_are_counted() -> None:
    one, two = (expected_of("rpm", motors=1, markers=markers, platform="crazyflie") for markers in (None, 2))
    others, commands = [0.0, 7500.0, 15300.0], [0, 10000, 30000]

    assert one is not None
    assert two is not None
    assert one.fault(30000) == two.fault(150000) == ""
    assert "0 to 95493 rpm" in one.fault(150000)
    assert one.fault(7290, [], command=2000) == ""
    assert one.fault(7290, [], command=0) != ""  # of a rotor that stands
    for speed, command, beside in ((190, 40000, "15300"), (1140, 20000, "7500"), (52000, 8000, "7500")):
        assert f"beside {beside} at command" in one.fault(speed, others, command=command, commands=commands)
    for speed, command in ((19000, 40000), (11400, 20000), (5000, 8000), (0, 0), (21000, 60000)):
        assert one.fault(speed, others, command=command, commands=commands) == ""


def test_a_weight_is_compared_with_the_others_since_scales_may_carry_a_stand() -> None:
    expected = expected_of("grams", motors=2, markers=None, platform="cf21")

    assert expected is not None
    assert expected.fault(28.0) == expected.fault(5010, [5028.0, 5020.0]) == ""
    assert expected.fault(5028, [5020.0], command=0) == ""
    assert expected.fault(77777) != ""
    assert expected.fault(50.2, [5028, 5020]) != ""
    assert expected_of("grams", motors=4, markers=None, platform="other") is None


def test_readings_that_the_fit_rejects_are_of_no_use_unless_the_vehicle_is_of_another_kind(tmp_path: Path) -> None:
    """The operator counted one marker of two; the scales' display stands still."""
    new_campaign(tmp_path / "lab")
    half = {20000: 11470.0, 25000: 13500.0, 30000: 15300.0}
    with pytest.raises(FitError, match=r"implausible.*`markers`"):
        of_readings(typed(tmp_path / "lab", "speed", half))
    assert of_readings(typed(tmp_path / "lab", "speed", {at: 2 * rpm for at, rpm in half.items()}))
    with pytest.raises(FitError, match="the display stands still"):
        of_readings(typed(tmp_path / "lab", "scales", dict.fromkeys(range(0, 40001, 10000), 60.0)))

    new_campaign(tmp_path / "other", ('platform = "cf2"', 'platform = "other"'))
    assert of_readings(typed(tmp_path / "other", "speed", half)).startswith("3 readings at 3 steps")


def test_a_run_in_which_no_reading_was_typed_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no reading was typed"):
        fit_speed(typed(tmp_path, "speed", {}))


@pytest.mark.parametrize(
    ("grams", "digit_g"), [((60.0, 57.5), 0.5), ((60, 58, 44), 2.0), ((65, 40), 5.0), ((60.02, 58), 0.02)]
)
def test_the_last_digit_of_scales_is_seen_in_their_readings(
    tmp_path: Path, grams: tuple[float, ...], digit_g: float
) -> None:
    run = typed(tmp_path, "scales", {10000 * at: value for at, value in enumerate(grams)}, motors=(1,))
    weighed = weighed_thrusts(run, gravity_mps2=9.81)

    assert weighed.points["thrust_std_n"][0] == pytest.approx(digit_g * 9.81e-3 / np.sqrt(6))


def test_a_table_of_scales_gives_the_map_of_a_run_with_the_same_readings(tmp_path: Path) -> None:
    readings = {at: round(weight_g, 1) for at, weight_g in grams(0, *range(8000, 64001, 8000)).items()}
    table = tmp_path / "scales.csv"
    table.write_text("cmd,grams\n" + "".join(f"{at},{weight_g}\n" for at, weight_g in readings.items()))

    by_run = fit_thrust(typed(tmp_path, "scales", readings, motors=(1, 3))).quantities["motor.thrust_poly"]
    by_table = fit_thrust(table, stand=Stand(motors=2)).quantities["motor.thrust_poly"]

    assert by_table.value == pytest.approx(by_run.value)
    assert by_table.std == pytest.approx(by_run.std)
    with pytest.raises(ConfigError, match="`motors`"):
        fit_thrust(table)


def test_scales_alone_give_a_map_whose_intervals_hold(tmp_path: Path) -> None:
    """Four motors on kitchen scales of 0.1 g whose display flickers; steps scatter, and the scales' gain is off."""
    rng, steps = np.random.default_rng(3), (0, *range(8000, 64001, 4000))
    true_n = float(true_thrust_n(65535))
    pulls, stds = [], []
    for draw in range(120):
        gain, rest_g = 1 + 0.002 * rng.standard_normal(), 180 + 30 * rng.random()
        readings = {}
        for at in steps:
            weight_g = 4e3 * float(true_thrust_n(at) if at else 0.0) / 9.81
            flicker = 1 + 3e-3 * rng.standard_normal()
            readings[at] = round(rest_g - gain * flicker * weight_g + 0.1 * rng.standard_normal(), 1)
        run = typed(
            tmp_path / str(draw),
            "scales",
            readings,
            facts=RigFacts(scales=Scales(linearity_std=0.002)),
            motors=(1, 2, 3, 4),
        )
        largest = fit_thrust(run).quantities["motor.max_thrust_n"]
        assert largest.std is not None
        pulls.append((largest.value - true_n) / largest.std)
        stds.append(largest.std / true_n)
    cover, rms = np.mean(np.abs(pulls) < 1.96), np.sqrt(np.mean(np.square(pulls)))
    print(f"cover {cover:.3f}, rms {rms:.2f}, std {100 * np.mean(stds):.2f} %")

    assert 0.90 <= cover <= 0.99
    assert np.mean(stds) < 0.006


def test_a_staircase_whose_torque_is_dead_is_good_for_thrust_and_gives_no_torque(tmp_path: Path) -> None:
    commands = tuple(range(0, 60001, 10000))
    record = climbed(commands)
    record.wrench[:, 5] = 2e-4 * np.random.default_rng(1).standard_normal(len(record.wrench))
    run = write_run(tmp_path, record, steps=commands, **HELD)
    (reason,) = (one.text for one in fit_torque(run).findings if one.code == "map-misfit")
    verdict = of_forces(run)

    assert verdict.startswith("6 of 6 steps are steady")
    assert reason in verdict


# Interrupted and resumed


def test_an_interrupted_run_is_chosen_with_the_one_that_completes_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    campaign = new_campaign(tmp_path)

    def run(minute: int, state: Any, **requested: Any) -> str:
        columns: dict[str, dict[str, list[float]]] = {"loadcell": {"t": [], "Fz": []}}
        started, wanted = STARTED + timedelta(minutes=minute), {"steps": [1, 2], "motors": [1], **requested}
        return made_run(tmp_path, "thrust", columns, state=state, started=started, requested=wanted).folder.name

    def names(*words: str) -> list[str]:
        return chosen(words, campaign, suits=labelled("thrust"), wanted="runs")

    first = run(1, "interrupted")
    second = run(2, "interrupted", resumes=first)
    third = run(3, "complete", resumes=second)
    alone = run(4, "interrupted")

    assert names() == names(third) == names("last") == [first, second, third]
    assert f"left out: {alone}" in capsys.readouterr().err
    amend_run(read_run(campaign.runs_folder / first), excluded="the cable touched")
    assert names() == [second, third]


def test_parts_of_a_staircase_are_judged_together(tmp_path: Path) -> None:
    def interrupted(folder: Path, steps: tuple[int, ...]) -> str:
        run = felt(folder, steps)
        write_header(run.folder, run.header.model_copy(update={"state": "interrupted"}))
        return run.folder.name

    first = interrupted(tmp_path / "a", COMMANDS[:3])
    second = felt(tmp_path / "a", COMMANDS[3:4], resumes=first)
    assert f"a map together with {first}" in of_forces(second)
    assert fit_thrust([read_run(tmp_path / "a" / "runs" / first), second]).accepted

    short = interrupted(tmp_path / "b", COMMANDS[:2])
    rest = felt(tmp_path / "b", COMMANDS[2:3], resumes=short)
    assert of_forces(rest).endswith("and here are 2.")
    amend_run(read_run(tmp_path / "b" / "runs" / short), excluded="the cable touched")
    assert of_forces(rest).endswith("and here is 1.")

    weak = interrupted(tmp_path / "c", COMMANDS[:4])
    assert "`cfid fit torque` rejects it" in of_forces(felt(tmp_path / "c", COMMANDS[4:], torque=3.0, resumes=weak))


def test_speeds_typed_in_parts_are_judged_together(tmp_path: Path) -> None:
    new_campaign(tmp_path)
    first = typed(tmp_path, "speed", {20000: 22940.0, 25000: 27000.0}, state="interrupted")
    second = typed(tmp_path, "speed", {30000: 30600.0}, resumes=first.folder.name)
    assert f"a map together with {first.folder.name}" in of_readings(second)
    assert fit_speed([first, second], stand=Stand(markers=2)).accepted

    half = typed(tmp_path, "speed", {20000: 11470.0, 25000: 13500.0}, state="interrupted")
    with pytest.raises(FitError, match=r"together with .*implausible"):
        of_readings(typed(tmp_path, "speed", {30000: 15300.0}, resumes=half.folder.name))

    slipped = typed(tmp_path, "speed", {20000: 20000.0, 30000: 18000.0}, state="interrupted")
    rest = typed(tmp_path, "speed", {at: float(at) for at in COMMANDS[3:]}, resumes=slipped.folder.name)
    with pytest.raises(FitError, match=rf"{slipped.folder.name} \(commands 20000 to 30000\).*most at command 30000"):
        of_readings(rest)

    empty = typed(tmp_path, "speed", {}, state="interrupted")
    alone = typed(tmp_path, "speed", {30000: 30600.0}, resumes=empty.folder.name)
    assert "Too short for a map of its own" in of_readings(alone)


def shown(folder: Path, state: Any, held_s: Mapping[int, float], device: str, **requested: Any) -> Run:
    """Write a run with the readings of an instrument under commands held for `held_s`, where 4 s were requested.

    The instrument follows with a lag of 1 s: it shows half of the command in rpm, or the grams of a lifting vehicle.
    """
    column, scale, rest = {"tachometer": ("rpm", 0.5, 0.0), "scales": ("grams", -1e-4, 60.0)}[device]
    change_s = np.cumsum([0.0, *(one for held in held_s.values() for one in (6.0, held))])
    commands = np.array([0, *(one for step in held_s for one in (step, 0))], dtype=float)
    time_s = np.arange(0, change_s[-1] + 1, 0.1)
    value = np.zeros(len(time_s))
    for at in range(1, len(time_s)):
        driven = commands[np.searchsorted(change_s[1:], time_s[at], side="right")]
        value[at] = value[at - 1] + 0.1 * (scale * driven - value[at - 1])
    still = np.zeros(len(commands))
    devices = {
        "commands": {"t": BEGIN_S + change_s, "m1": commands, "m2": still, "m3": still, "m4": still},
        device: {"t": BEGIN_S + time_s, column: rest + value},
    }
    wanted = {"steps": list(held_s), "motors": [1], "hold_s": 4.0, "rest_s": 6.0, **requested}
    kind = "speed" if device == "tachometer" else "scales"
    return made_run(folder, kind, devices, state=state, requested=wanted)


@pytest.mark.parametrize(("device", "column"), [("tachometer", "rpm"), ("scales", "grams")])
@pytest.mark.parametrize("held_s", [0.3, 0.9, 3.0])
def test_an_instrument_counts_at_no_command_that_was_ended_and_is_held_again(
    tmp_path: Path, device: str, column: str, held_s: float
) -> None:
    first = shown(tmp_path, "interrupted", {20000: 4.0, 30000: 4.0, 40000: held_s}, device)
    second = shown(tmp_path, "complete", {40000: 4.0, 50000: 4.0}, device, resumes=first.folder.name)

    commands = [shown_at_commands(run, device, column)[1].tolist() for run in (first, second)]
    assert [[at for at in one if at] for one in commands] == [[20000, 30000], [40000, 50000]]
    ended = shown(tmp_path, "interrupted", {20000: 2.0}, "tachometer")
    with pytest.raises(DataError, match="no command was held to its end"):
        fit_speed(ended)


# Scales


UP = tuple(range(0, 40001, 10000))


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    """A campaign with a table of forces, whose map the scales verify."""
    new_campaign(tmp_path)
    rows = [f"{command},{float(true_thrust_n(command)):.6f}" for command in range(16000, 64001, 4000)]
    (tmp_path / "forces.csv").write_text("\n".join(["cmd,thrust_n", "0,0", *rows]) + "\n")
    return tmp_path


def grams(*commands: int, rest_g: float = 60.0) -> dict[int, float]:
    """Return the grams on scales while motors 1 and 3 run at commands."""
    return {at: rest_g - 2e3 * float(true_thrust_n(at) if at else 0.0) / 9.81 for at in commands}


def weighed(folder: Path, minute: int, readings: Mapping[int, float], *, state: Any = "complete", **more: Any) -> Run:
    return typed(folder, "scales", readings, state=state, minute=minute, **{"steps": UP, "motors": (1, 3), **more})


def two_parts(campaign: Path) -> tuple[Run, Run]:
    first = weighed(campaign, 1, grams(*UP[:2]), state="interrupted")
    return first, weighed(campaign, 2, grams(*UP[2:]), steps=UP[2:], resumes=first.folder.name)


def verified(cfid: Cfid, campaign: Path, *runs: Run) -> tuple[str, dict[str, Any]]:
    """Return what a fit that is verified by runs prints, and what it found."""
    verify = [word for run in runs for word in ("--verify", run.folder.name)] + ["--verbose"]
    words = ("fit", "thrust", campaign / "forces.csv", *verify, "--no-figures")
    ended = cfid(*words)
    assert ended.returncode == 0, ended.stderr
    return " ".join((ended.stdout + ended.stderr).split()), content_of(cfid, *words)["quality"]


def test_a_map_is_verified_by_all_parts_of_a_run_of_scales(cfid: Cfid, campaign: Path) -> None:
    first, second = two_parts(campaign)

    assert f"with {first.folder.name}, which it completes" in of_readings(second)
    for runs in ((second,), (second, first)):
        printed, quality = verified(cfid, campaign, *runs)
        assert "verification: 5 readings" in printed
        assert quality["verification_rms_n"] < 1e-3
    for word in (first.folder, first.folder.name):
        ended = cfid("log", "scales", "--resume", word, "--dry-run")
        assert ended.returncode == 2
        assert f"{second.folder.name} completes it" in ended.stderr
    amend_run(first, excluded="the vehicle slid")
    assert "Alone it verifies no map" in of_readings(read_run(second.folder))


def test_readings_count_by_the_weight_at_rest_of_their_own_part_or_run(cfid: Cfid, campaign: Path) -> None:
    """Between the parts, the vehicle was taken off the scales and put back with its cable over the edge."""
    first = weighed(campaign, 1, grams(*UP[:4]), state="interrupted")
    again = weighed(campaign, 2, grams(40000, 0, rest_g=57.0), steps=(40000, 0), resumes=first.folder.name)
    heavy, light = (weighed(campaign, 3 + rest_g // 100, grams(*UP, rest_g=rest_g)) for rest_g in (412, 60))

    assert verified(cfid, campaign, again)[1]["verification_rms_n"] < 1e-3
    printed, quality = verified(cfid, campaign, heavy, light)
    assert "verification: 10 readings" in printed
    assert quality["verification_rms_n"] < 1e-3


def test_parts_that_verify_no_map_together_are_named(cfid: Cfid, campaign: Path) -> None:
    empty = weighed(campaign, 1, {}, state="interrupted")
    second = weighed(campaign, 2, grams(*UP[2:]), steps=UP[2:], resumes=empty.folder.name)
    printed, quality = verified(cfid, campaign, second)
    assert "the map is not verified" in printed
    assert quality["verification_rms_n"] is None

    still = weighed(campaign, 3, dict.fromkeys(UP[:3], 60.0), state="interrupted")
    rest = weighed(campaign, 4, dict.fromkeys(UP[3:], 60.0), steps=UP[3:], resumes=still.folder.name)
    line = verdict_line(judged(rest, of_readings))
    assert "NOT USABLE" in line
    assert f"`cfid log scales --resume {still.folder.name}` records the rest again" in line


def test_what_all_usable_parts_lack_is_recorded_and_completes_the_last_of_them(campaign: Path) -> None:
    first = weighed(campaign, 1, grams(*UP[:2]), state="interrupted")
    second = weighed(campaign, 2, grams(UP[2]), state="interrupted", steps=UP[2:], resumes=first.folder.name)
    third = weighed(campaign, 3, {}, state="failed", steps=UP[3:], resumes=second.folder.name)
    plan = missing(first.folder, kind="scales")

    assert (plan.steps, plan.resumes) == (UP[3:], third.folder.name)
    assert missing(third.folder, kind="scales") == plan


@pytest.mark.parametrize(
    "change", [{"excluded": "the vehicle slid"}, {"verdict": Verdict(usable=False, text="the display stands still")}]
)
def test_a_later_part_of_no_use_is_recorded_again(campaign: Path, change: dict[str, Any]) -> None:
    first, second = two_parts(campaign)
    amend_run(second, **change)
    plan = missing(first.folder, kind="scales")

    assert (plan.steps, plan.resumes) == (UP[2:], first.folder.name)


def test_what_was_typed_until_the_recorder_was_killed_is_not_asked_for_again(campaign: Path) -> None:
    def killed(readings: Mapping[int, float]) -> Run:
        run = weighed(campaign, 1, readings, state="interrupted")
        devices = {name: one.model_copy(update={"rows": None}) for name, one in run.header.devices.items()}
        write_header(run.folder, run.header.model_copy(update={"state": "recording", "devices": devices}))
        return read_run(run.folder)

    run = killed(grams(*UP[:2]))
    assert missing(run.folder, kind="scales").steps == UP[2:]
    with (run.folder / "readings.csv").open("a") as file:
        file.write("1763712345.5,20000,5")  # the recorder was killed while it wrote a row
    assert missing(run.folder, kind="scales").steps == UP[2:]
    assert steps_left(killed({})) == UP


@pytest.mark.skipif(not DATA.exists(), reason="the public thrust table of 2015 is not here (CFID_DATA)")
def test_a_public_table_weighed_on_scales_gives_the_map_of_the_table_itself(tmp_path: Path) -> None:
    """Bitcraze weighed four motors in 2015, on a supply that sagged."""
    path = DATA / "bitcraze_2015/cf20_pwm_thrust_2015.csv"
    table = pd.read_csv(path)
    readings = {
        int(65535 * pwm / 100): 500.0 - grams
        for pwm, grams in zip(table.pwm_percent, table.thrust_total_g, strict=True)
    }
    run = typed(tmp_path, "scales", readings, motors=(1, 2, 3, 4))
    weighed, ours = (fit_thrust(measured).quantities["motor.thrust_poly"] for measured in (run, path))
    command = np.array([16384.0, 32768.0, 61440.0])

    assert np.polyval(weighed.value, command) == pytest.approx(np.polyval(ours.value, command), rel=0.02)
