"""`cfid fit thrust`, `speed` and `torque` turn runs, files and tables into maps and findings."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.estimate.voltage_cubic import cubic_fault
from cfid.records.rig_file import LoadCellMount, RigFacts, Tachometer
from cfid.sim.propulsion import BatteryTruth, RotorTruth
from tests.lab import DATA, Cfid, codes, made_run, new_campaign, sections_at, sentences
from tests.motors.stand_in_a_folder import climbed, write_run, write_thesis_file

STEPS = tuple(range(0, 64001, 4000))
TRUTH = RotorTruth()


def true_thrust_n(command: Any) -> Any:
    return (
        TRUTH.thrust_ns2_per_rad2
        * TRUTH.steady_rad_per_s(np.asarray(command, dtype=np.float64), volts=TRUTH.nominal_v) ** 2
    )


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    return new_campaign(tmp_path).folder


@pytest.fixture(scope="module")
def staircase(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign's run of a complete staircase, for fits that do not change it."""
    folder = tmp_path_factory.mktemp("staircase")
    new_campaign(folder)
    return write_run(folder, climbed(STEPS), steps=STEPS).folder


def content_of(cfid: Cfid, *words: object, code: int = 0) -> dict[str, Any]:
    said = cfid(*map(str, words), "--json")
    assert said.returncode == code, said.stderr
    content: dict[str, Any] = json.loads(said.stdout)
    return content


def test_a_run_gives_the_thrust_map_its_inverse_and_what_hovers(cfid: Cfid, staircase: Path) -> None:
    campaign = staircase.parents[1]
    content = content_of(cfid, "fit", "thrust", staircase, "--campaign", campaign)
    parameters = content["parameters"]

    poly = parameters["motor.thrust_poly"]["value"]
    for command in (16384, 32768, 60000):  # two seconds per step at 1 kHz; the goals hold for ten at 7 kHz
        assert np.polyval(poly, command) == pytest.approx(true_thrust_n(command), rel=0.01)
    root = parameters["motor.command_of_thrust"]["value"][0]
    assert root["round_trip_command"] < 1
    assert parameters["motor.max_thrust_n"]["value"] == pytest.approx(true_thrust_n(65535), rel=0.005)
    mass_kg = 4 * parameters["motor.max_thrust_n"]["value"] / 9.81
    assert parameters["motor.hover_mass_kg"]["value"] == pytest.approx(mass_kg)
    rows = parameters["motor.table"]["value"]
    assert [row["cmd"] for row in rows] == [step for step in STEPS if step]
    assert content["accepted"]
    assert {Path(source["path"]).name for source in content["sources"]} == {"loadcell.csv", "commands.csv"}
    assert "thrust" in sections_at(campaign)


def test_the_same_run_gives_the_torque_map(cfid: Cfid, staircase: Path) -> None:
    content = content_of(cfid, "fit", "torque", staircase, "--campaign", staircase.parents[1])
    poly = content["parameters"]["motor.torque_poly"]
    assert poly["value"][0] == pytest.approx(TRUTH.torque_m, rel=0.01)


def test_files_of_the_thesis_kind_give_the_same_map(cfid: Cfid, tmp_path: Path) -> None:
    words = []
    for command in range(8000, 64001, 8000):
        path = write_thesis_file(tmp_path / f"{command}.csv", climbed([command], hold_s=4.0, seed=command))
        words.append(f"{command}={path}")
    content = content_of(cfid, "fit", "thrust", *words, "--motors", 2)
    poly = content["parameters"]["motor.thrust_poly"]["value"]
    for command in (16384, 32768, 60000):
        assert np.polyval(poly, command) == pytest.approx(true_thrust_n(command), rel=0.01)

    thesis = content_of(cfid, "fit", "thrust", *words, "--motors", 2, "--method", "thesis", "--from", "2", "--to", "4")
    poly = thesis["parameters"]["motor.thrust_poly"]["value"]
    assert np.polyval(poly, 40000) == pytest.approx(true_thrust_n(40000), rel=0.06)  # biased by only 51 samples


def test_a_sagging_battery_is_told_apart_by_its_voltage(cfid: Cfid, campaign: Path) -> None:
    steps = (*STEPS[1:], *STEPS[-2:0:-1])
    battery = BatteryTruth(kind="lipo", charge=0.9)
    run = write_run(campaign, climbed(steps, motors=(1, 2, 3, 4), battery=battery), steps=steps)
    content = content_of(cfid, "fit", "thrust", run.folder, "--campaign", campaign)

    quality = content["quality"]
    assert quality["better_form"] == "voltage"
    assert quality["voltage_rms_n"] < quality["command_rms_n"]
    poly = content["parameters"]["motor.thrust_voltage_poly"]["value"]
    assert cubic_fault(poly) == ""  # the true map is nearly square; the firmware takes the nearest rising cubic
    largest = true_thrust_n(3.5 / TRUTH.nominal_v * 65535)
    for volts in (1.5, 2.5, 3.0):
        truth = true_thrust_n(volts / TRUTH.nominal_v * 65535)
        assert np.polyval(poly[::-1], volts) == pytest.approx(truth, abs=0.01 * largest)


def test_a_voltage_cubic_that_no_firmware_could_invert_is_rejected_alone_and_the_reason_kept(
    cfid: Cfid, campaign: Path
) -> None:
    command = np.repeat(np.arange(4000.0, 65000.0, 4000.0), 2)
    volts = command / 65535 * 4.0
    thrust = 0.02 * volts**2 - 0.0026 * volts**3 + 1e-5 * np.random.default_rng(1).standard_normal(len(volts))
    rows = zip(command, thrust, strict=True)
    table = campaign / "folds.csv"
    table.write_text("cmd,thrust_n,vbat_v\n" + "".join(f"{c:.0f},{t:.6f},4.0\n" for c, t in rows))
    words = ("fit", "thrust", "--table", table, "--campaign", campaign)
    content = content_of(cfid, *words)
    cubic = "motor.thrust_voltage_poly"
    reason = next(
        one["text"] for one in content["findings"] if cubic in one["quantities"] and one["severity"] == "rejection"
    )

    assert "departs from the data by" in reason
    assert reason in sentences(content)
    assert cubic not in content["parameters"]
    section = sections_at(campaign)["thrust"]
    assert section.rejected[cubic] == reason
    assert cubic not in section.parameters
    assert section.covariance
    assert not any(cubic in kept.of for kept in section.covariance)
    assert cubic in content_of(cfid, *words, "--force")["parameters"]


def test_a_tachometers_readings_are_divided_by_the_markers(cfid: Cfid, tmp_path: Path) -> None:
    commands = np.arange(0, 64001, 2000)
    speeds = np.where(commands < 1000, 0, 0.04076521 * commands + 380.8359)  # eq. 3.4
    table = tmp_path / "rpm.csv"
    rpm = 2 * speeds * 60 / (2 * np.pi)
    table.write_text("cmd,rpm_1\n" + "".join(f"{c},{r:.9f}\n" for c, r in zip(commands, rpm, strict=True)))

    poly = content_of(cfid, "fit", "speed", "--table", table, "--markers", 2)["parameters"]["motor.speed_poly"]["value"]
    assert poly == pytest.approx([0.04076521, 380.8359], rel=1e-7)
    new_campaign(tmp_path)
    doubled = cfid("fit", "speed", "--table", str(table), "--markers", "1", "--campaign", str(tmp_path), "--no-figures")
    assert doubled.returncode == 5
    assert "implausible" in doubled.stderr


def test_a_tachometers_markers_are_those_of_the_run_then_of_rig_toml_and_a_question_elsewhere(
    cfid: Cfid, tmp_path: Path
) -> None:
    lab = new_campaign(tmp_path / "lab", ("markers = 2", "markers = 4")).folder
    command, rpm = np.array([10000, 20000, 30000, 40000]), np.array([2e4, 4e4, 6e4, 8e4])
    readings = {"t": np.arange(4.0), "command": command, "rpm": rpm}
    run = made_run(lab, "speed", {"readings": readings}, facts=RigFacts(tachometer=Tachometer(markers=2)))
    table, stand = tmp_path / "rpm.csv", tmp_path / "stand.csv"
    table.write_text("cmd,rpm_1\n" + "".join(f"{c},{r}\n" for c, r in zip(command, rpm, strict=True)))
    stand.write_text("cmd,thrust_n,rpm_mean\n" + "".join(f"{c},{1.03e-10 * c**2:.3f},{2 * c}\n" for c in command))

    def markers(*words: object) -> float:
        content = content_of(cfid, "fit", "speed", *words, "--campaign", lab, "--force", "--no-figures")
        (row, *_) = content["parameters"]["motor.table"]["value"]
        return round(20000 * 2 * np.pi / 60 / float(row["speed_rad_s"]), 6)

    assert markers(run.folder) == 2
    assert markers(run.folder, "--markers", 1) == 1
    assert markers("--table", table) == 4
    assert markers("--table", stand) == 1
    assert cfid("fit", "speed", "--table", table, "--no-figures").returncode == 2


def test_rotor_speeds_are_heard_in_the_vibration(cfid: Cfid, campaign: Path) -> None:
    steps = (10000, 30000, 60000)
    run = write_run(campaign, climbed(steps, motors=(1,), rate_hz=3500.0, hold_s=4.0), steps=steps)
    content = content_of(cfid, "fit", "speed", "--vibration", run.folder, "--campaign", campaign)
    speeds = content["parameters"]["rotor.speed_rad_s"]
    truth = TRUTH.steady_rad_per_s(np.array(steps, dtype=float), volts=TRUTH.nominal_v)

    assert speeds["value"] == pytest.approx(truth, rel=1e-3)
    assert all(abs(v - t) < 3 * s for v, t, s in zip(speeds["value"], truth, speeds["std"], strict=True))
    assert [row["cmd"] for row in content["parameters"]["rotor.windows"]["value"]] == list(steps)


@pytest.mark.skipif(not DATA.exists(), reason="the public thrust-stand records are not here (CFID_DATA)")
def test_public_steps_have_their_known_time_constants(cfid: Cfid) -> None:
    content = content_of(cfid, "fit", "dynamics", "--table", DATA / "bitcraze_2021" / "cf21_stock2.csv")
    rows = content["parameters"]["dynamics.time_constant_s"]["value"]
    found_s = {(row["cmd_from"], row["cmd_to"]): (row["time_constant_s"], row["std_s"]) for row in rows}

    for step, alone_s in (((15000, 20000), 0.178), ((40000, 45000), 0.087)):  # of single steps
        tau_s, std_s = found_s[step]
        assert abs(tau_s - alone_s) < 2.5 * std_s
        assert std_s < 0.3 * tau_s
    assert len(content["parameters"]["dynamics.rising"]["value"]) == 2


def test_without_a_tachometer_a_thrust_run_tells_speeds_by_its_vibration(cfid: Cfid, campaign: Path) -> None:
    steps = (10000, 20000, 30000, 60000)
    run = write_run(campaign, climbed(steps, motors=(1,), rate_hz=3500.0), steps=steps)
    content = content_of(cfid, "fit", "speed", run.folder, "--campaign", campaign, "--expect", "400,3500")
    parameters = content["parameters"]

    assert parameters["motor.speed_poly"]["value"] == pytest.approx(
        [TRUTH.rad_per_s_per_command, TRUTH.idle_rad_per_s], rel=1e-3
    )
    assert parameters["motor.thrust_per_speed_squared_n_s2"]["value"] == pytest.approx(
        TRUTH.thrust_ns2_per_rad2, rel=0.005
    )
    assert all(row["thrust_n"] and row["speed_rad_s"] for row in parameters["motor.table"]["value"])
    assert any("estimated from the load cell's vibration" in said for said in sentences(content))


def test_speeds_that_the_vehicle_told_beside_the_load_cell_are_taken(cfid: Cfid, campaign: Path) -> None:
    record = climbed(STEPS[:8])
    rpm = record.speed_rad_per_s[:, [0, 2]] * 60 / (2 * np.pi)
    run = write_run(campaign, record, steps=STEPS[:8], told_rpm=rpm)
    content = content_of(cfid, "fit", "thrust", run.folder, "--campaign", campaign)
    k = content["parameters"]["motor.thrust_per_speed_squared_n_s2"]["value"]

    assert k == pytest.approx(TRUTH.thrust_ns2_per_rad2, rel=0.01)


# Faulty input


def test_a_step_that_never_settles_is_told_and_left_out_or_ends_the_fit(cfid: Cfid, campaign: Path) -> None:
    slow = RotorTruth(time_constant_s=1.5)
    run = write_run(campaign, climbed(STEPS[4:7], rotors=slow), steps=STEPS[4:7])
    said = cfid("fit", "thrust", str(run.folder), "--campaign", str(campaign), "--no-figures")
    assert said.returncode == 5
    assert "none of 3 steps settles" in said.stderr
    assert run.folder.name in said.stderr

    words = [f"4000={write_thesis_file(campaign / 'slow.csv', climbed([40000], rotors=slow, hold_s=4.0, rest_s=6.0))}"]
    for command in (20000, 40000, 60000):
        path = write_thesis_file(campaign / f"{command}.csv", climbed([command], hold_s=3.0, seed=command))
        words.append(f"{command}={path}")
    content = content_of(cfid, "fit", "thrust", *words, "--motors", "2", "--no-figures")
    assert [row["cmd"] for row in content["parameters"]["motor.table"]["value"]] == [20000, 40000, 60000]
    assert "step-left-out" in codes(content)
    assert cfid("fit", "thrust", words[0], "--motors", "2", "--no-figures").returncode == 5


def test_thrust_that_points_down_is_told_and_turned_round_when_asked(cfid: Cfid, campaign: Path) -> None:
    record = climbed(STEPS[:6])
    record.wrench[:, 2] *= -1
    run = write_run(campaign, record, steps=STEPS[:6])
    said = cfid("fit", "thrust", str(run.folder), "--campaign", str(campaign), "--no-figures")
    assert said.returncode == 5
    assert "negative throughout" in said.stderr
    turned = cfid("fit", "thrust", str(run.folder), "--campaign", str(campaign), "--no-figures", "--flip-fz")
    assert turned.returncode == 0, turned.stderr
    noted = write_run(campaign, record, steps=STEPS[:6], facts=RigFacts(loadcell=LoadCellMount(flip_fz=True)))
    words = ("fit", "thrust", str(noted.folder), "--campaign", str(campaign), "--no-figures")
    assert cfid(*words).returncode == 0
    assert cfid(*words, "--no-flip-fz").returncode == 5


def test_a_saturated_load_cell_is_told(cfid: Cfid, campaign: Path) -> None:
    record = climbed(STEPS[:5])
    record.status[3000:6000] = 0x80020000
    run = write_run(campaign, record, steps=STEPS[:5])
    said = cfid("fit", "thrust", str(run.folder), "--campaign", str(campaign), "--no-figures")
    assert said.returncode == 4
    assert "saturated" in said.stderr


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("fit thrust", 2),
        ("fit thrust abc=file.csv", 2),
        ("fit thrust 2000=missing.csv", 4),
        ("fit thrust 2000=x.csv --from 5 --to 4", 2),
        ("fit speed --table missing.csv", 4),
        ("fit speed missing --expect 5", 2),
    ],
)
def test_what_cannot_be_meant_so_is_refused(cfid: Cfid, words: str, code: int) -> None:
    said = cfid(*words.split(), "--no-figures")
    assert said.returncode == code, said.stderr
    assert "Traceback" not in said.stderr


def test_without_a_word_the_campaigns_complete_staircases_are_taken(cfid: Cfid, campaign: Path) -> None:
    run = write_run(campaign, climbed((0, 16000, 32000, 48000), hold_s=1.5), steps=(0, 16000, 32000, 48000))
    assert cfid("fit", "thrust", run.folder, "--from", 2).returncode == 2  # a run has its own windows
    named = content_of(cfid, "fit", "thrust", run.folder, "--campaign", campaign)["parameters"]
    taken = cfid("fit", "thrust", "--campaign", str(campaign), "--json")

    assert "takes 1 complete run of cfid log thrust." in taken.stderr
    assert json.loads(taken.stdout)["parameters"]["motor.thrust_poly"] == named["motor.thrust_poly"]
    none = cfid("fit", "speed", "--campaign", str(campaign))
    assert none.returncode == 2
    assert "no complete runs of cfid log speed" in none.stderr


def test_a_run_without_a_steady_step_is_left_out_and_does_not_condemn_the_others(cfid: Cfid, campaign: Path) -> None:
    steps = (0, 16000, 32000, 48000)
    run = write_run(campaign, climbed(steps, hold_s=1.5), steps=steps)
    alone = content_of(cfid, "fit", "thrust", run.folder, "--campaign", campaign)["parameters"]
    short = write_run(campaign, climbed((16000,), hold_s=0.05), steps=(16000,))
    refused = cfid("fit", "thrust", short.folder, "--campaign", campaign, "--no-figures")
    taken = content_of(cfid, "fit", "thrust", short.folder, run.folder, "--campaign", campaign)

    assert refused.returncode in (4, 5)
    assert taken["parameters"] == alone
    (left_out,) = [one["text"] for one in taken["findings"] if one["code"] == "run-left-out"]
    assert short.folder.name in left_out
