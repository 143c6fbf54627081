"""Each recording is judged as it ends, by the code that will fit it, and the run keeps the verdict."""

import json
import os
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

import cfid.friction.verdict
import cfid.loadcell.verdict
import cfid.swing.verdict
from cfid.console.verdicts import judged, verdict_line
from cfid.errors import ConfigError
from cfid.friction.verdict import verdict as judge_drop
from cfid.motors.missing_steps import missing
from cfid.records.run import DeviceRecord, Label, Run, Verdict, amend_run, list_runs, read_run, write_header
from cfid.records.run_writer import create_run
from cfid.rig.stalls import STOOD
from tests.campaigns import Cfid
from tests.records.test_sampled_runs import recorded
from tests.rig_in_a_folder import Command, Lab, lab_in

pytestmark = pytest.mark.usefixtures("in_time")


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    with lab_in(tmp_path) as lab:
        yield lab


def runs_of(folder: Path, kind: str) -> list[Run]:
    found = [run for run in list_runs(folder / "runs") if isinstance(run, Run)]
    return [run for run in found if run.header.kind == kind]


def test_a_sound_swing_is_good_and_says_how_far_it_swung(bodies: Path) -> None:
    run = judged(runs_of(bodies, "swing")[0], cfid.swing.verdict.verdict)

    assert verdict_line(run).startswith("good: ")
    assert "peaks from" in verdict_line(run)
    assert read_run(run.folder).header.verdict == run.header.verdict


def test_a_sound_drop_is_good_though_one_weight_alone_gives_no_friction(bodies: Path) -> None:
    run = judged(runs_of(bodies, "drop")[0], cfid.friction.verdict.verdict)

    assert verdict_line(run).startswith("good: 20 g:")


def test_a_drop_is_judged_alone_whatever_rig_toml_lacks_and_fitted_once_it_states_it(cfid: Cfid, bodies: Path) -> None:
    rig = (bodies / "rig.toml").read_text()
    before, _, after = rig.partition("[friction]")
    (bodies / "rig.toml").write_text(before + after[after.index("\n[") :])
    drops = [judged(run, judge_drop) for run in runs_of(bodies, "drop")]
    (bodies / "rig.toml").write_text(rig)

    assert all(run.header.verdict is not None and run.header.verdict.usable for run in drops)
    assert cfid("fit", "friction", "--no-figures", folder=bodies).returncode == 0


def test_a_fault_of_rig_toml_condemns_no_recording(bodies: Path) -> None:
    (bodies / "rig.toml").write_text("[vehicle\n")
    run = judged(runs_of(bodies, "swing")[0], cfid.swing.verdict.verdict)

    assert run.usable


def test_a_drop_is_no_swing_and_is_told_to_be_recorded_again(bodies: Path) -> None:
    run = judged(runs_of(bodies, "drop")[0], cfid.swing.verdict.verdict)

    assert verdict_line(run).startswith("NOT USABLE: ")
    assert verdict_line(run).endswith("Record it again.")
    assert read_run(run.folder).header.verdict is not None


def test_a_falling_weight_that_stops_at_once_is_named_as_a_body_that_turned(bodies: Path) -> None:
    """The floor stops the weight, and the axis with it, so a constant angle does not mean that the encoder froze."""
    run = runs_of(bodies, "drop")[0]
    path = run.device_file("encoder")
    header, *rows = path.read_text().splitlines()
    place, cells = run.header.devices["encoder"].columns.index("phi"), [row.split(",") for row in rows]
    fastest = max(range(len(cells) - 3000), key=lambda i: abs(int(cells[i + 100][place]) - int(cells[i][place]))) + 100
    for row in cells[fastest:]:
        row[place] = cells[fastest][place]
    path.write_text("\n".join([header, *map(",".join, cells), ""]))

    assert "the body turned, as under a falling weight" in verdict_line(judged(run, cfid.swing.verdict.verdict))


def test_an_encoder_that_freezes_in_the_middle_of_a_swing_is_named(bodies: Path) -> None:
    run = runs_of(bodies, "swing")[0]
    path = run.device_file("encoder")
    header, *rows = path.read_text().splitlines()
    place, cells = run.header.devices["encoder"].columns.index("phi"), [row.split(",") for row in rows]
    begin = len(cells) // 3
    for row in cells[begin:]:
        row[place] = cells[begin][place]
    path.write_text("\n".join([header, *map(",".join, cells), ""]))

    line = verdict_line(judged(run, cfid.swing.verdict.verdict))

    assert line.startswith("NOT USABLE: the angle does not change in the last ")
    assert "the encoder froze, or something held the pendulum. Record it again." in line


def test_readings_that_are_repeated_in_several_rows_are_named_beside_what_a_swing_is_good_for(bodies: Path) -> None:
    run = runs_of(bodies, "swing")[0]
    path = run.device_file("encoder")
    header, *rows = path.read_text().splitlines()
    place, cells = run.header.devices["encoder"].columns.index("phi"), [row.split(",") for row in rows]
    for i, row in enumerate(cells):
        row[place] = cells[i - i % 8][place]
    path.write_text("\n".join([header, *map(",".join, cells), ""]))

    line = verdict_line(judged(run, cfid.swing.verdict.verdict))

    assert line.startswith("good: ")
    assert "Each reading of the angle is repeated in about 8 rows" in line


def test_a_clock_in_milliseconds_is_named_beside_why_a_swing_of_bunched_lines_is_of_no_use(bodies: Path) -> None:
    run = runs_of(bodies, "swing")[0]
    path, record = run.device_file("encoder"), run.header.devices["encoder"]
    rows = pd.read_csv(path, dtype={"t": np.float64})
    rows["device_us"] = (1e3 * (rows["t"] - rows["t"][0])).astype(int) + np.arange(len(rows))  # stamps have to rise
    rows["t"] = 0.1 * np.ceil(rows["t"] / 0.1)
    rows.to_csv(path, index=False, float_format="%.6f")
    kept = record.model_copy(update={"columns": tuple(rows.columns)})
    write_header(run.folder, run.header.model_copy(update={"devices": {**run.header.devices, "encoder": kept}}))

    line = verdict_line(judged(read_run(run.folder), cfid.swing.verdict.verdict))

    assert line.startswith("NOT USABLE: ")
    assert "no steady clock in microseconds" in line


def counting(run: Run, **counts: Any) -> Run:
    """Return a run whose device has the given counts of its samples."""
    (name, record), *_ = run.header.devices.items()
    devices = {name: record.model_copy(update={"rows": 1000, "lost": 0, **counts})}
    return Run(folder=run.folder, header=run.header.model_copy(update={"devices": devices}))


def test_lost_samples_stand_beside_what_a_recording_is_good_for(bodies: Path) -> None:
    few, many = (counting(runs_of(bodies, "swing")[0], lost=lost) for lost in (5, 500))

    assert "lost" not in verdict_line(judged(few, lambda _: "fine."))
    assert verdict_line(judged(many, lambda _: "fine.")).startswith(
        "good: fine. 500 of 1500 samples of encoder are lost"
    )


def test_half_of_the_samples_never_taken_stand_beside_what_a_recording_is_good_for(bodies: Path) -> None:
    run = runs_of(bodies, "swing")[0]
    few, many = (counting(run, rate_hz=1000.0, skipped=skipped) for skipped in (50, 1000))

    assert "was read at" not in verdict_line(judged(few, lambda _: "fine."))
    assert verdict_line(judged(many, lambda _: "fine.")).endswith(
        "fine. encoder was read at 500 of 1000 Hz: end other programs."
    )


def test_what_was_missed_while_the_program_was_suspended_is_laid_to_no_other_program(bodies: Path) -> None:
    stood = [{"from_s": 100.0, "to_s": 114.0, "reason": STOOD}]
    late = [{"from_s": 100.0, "to_s": 100.4, "reason": STOOD}, {"from_s": 101.0, "to_s": 114.0, "reason": "no reply"}]
    run = runs_of(bodies, "swing")[0]
    suspended, slow = (counting(run, rate_hz=1000.0, skipped=14000, gaps=gaps) for gaps in (stood, late))

    assert verdict_line(judged(suspended, lambda _: "fine.")).endswith(
        "fine. cfid itself was suspended or kept waiting for 14.0 s: encoder has no rows of them."
    )
    assert verdict_line(judged(slow, lambda _: "fine.")).endswith("of 1000 Hz: end other programs.")


def test_losses_stand_beside_why_a_recording_is_of_no_use(bodies: Path) -> None:
    """Previously, the only advice on a drop that a busy computer read at 713 of 1000 Hz was to let it fall farther."""
    run = counting(runs_of(bodies, "drop")[0], rate_hz=1000.0, skipped=1000)

    line = verdict_line(judged(run, cfid.swing.verdict.verdict))
    assert line.startswith("NOT USABLE: ")
    assert line.endswith(" encoder was read at 500 of 1000 Hz: end other programs. Record it again.")


def test_a_recording_without_a_mount_says_over_what_it_turned_and_who_takes_it(bodies: Path) -> None:
    run = runs_of(bodies, "swing")[0]
    line = verdict_line(judged(run, cfid.swing.verdict.of_no_mount))

    assert line.startswith("good: turned over ")
    assert "`cfid fit swing` does with its name and its `axis`, where it is a swing." in line


def test_a_run_that_was_cut_is_not_judged(bodies: Path) -> None:
    run = runs_of(bodies, "swing")[0]
    cut = Run(folder=run.folder, header=run.header.model_copy(update={"state": "interrupted"}))

    assert judged(cut, cfid.swing.verdict.verdict).header.verdict is None
    assert verdict_line(cut) == (
        "not judged, since it was ended early: fits leave it out. Record it again, or name it to a fit: "
        f"{run.folder.name}."
    )


@pytest.mark.parametrize("held_s", [0.5, 0.99])
def test_a_staircase_that_ended_early_is_to_be_resumed_only_where_it_lacks_a_step(
    tmp_path: Path, held_s: float
) -> None:
    with create_run(
        tmp_path,
        kind="thrust",
        label=Label(),
        devices={"commands": DeviceRecord(file="commands.csv", columns=("t", "m1", "m2", "m3", "m4"))},
        requested={"steps": [20000], "motors": [1], "hold_s": 1.0, "rest_s": 1.0},
        started=datetime(2026, 1, 1, tzinfo=UTC),
        cfid_version="0.2.0",
    ) as writer:
        writer.append("commands", ([1.7e9, 1.7e9 + held_s], [20000, 0], [0, 0], [0, 0], [0, 0]))
        run = writer.close("interrupted")
    lacks = held_s < 0.98

    assert ("--resume" in verdict_line(run)) == lacks
    assert f"name it to a fit: {run.folder.name}." in verdict_line(run) or lacks
    if not lacks:
        with pytest.raises(ConfigError, match="has every step, though it ended early; nothing is left to record"):
            missing(run.folder, kind="thrust")


def silence(lab: Lab, log: Command) -> None:
    lab.loadcell_suffers(silent_after_s=0)
    log.wait_until_said("is silent; requesting the stream again")


def saturate(lab: Lab, log: Command) -> None:
    lab.box.box.load_cell.overload()


def unplug(lab: Lab, log: Command) -> None:
    lab.pull_plug()
    log.wait_until_said("unplugged; waiting for the encoder")


@pytest.mark.parametrize(
    ("words", "ruin", "verdict"),
    [
        (("loadcell",), silence, "sent nothing more for"),
        (("loadcell",), saturate, "saturation"),
        (("encoder", "--axis", "x"), unplug, "and not plugged in again"),
    ],
)
def test_a_recording_that_a_fault_ends_keeps_the_fault_as_its_verdict(
    lab: Lab, words: tuple[str, ...], ruin: Callable[[Lab, Command], None], verdict: str
) -> None:
    log = lab.start("log", *words, "--for", 60, "--json")
    log.wait_for_rows(20)
    ruin(lab, log)
    said = log.end() if ruin is saturate else log.ask_to_end()
    kept = lab.run().header.verdict

    assert said.code == 3
    assert kept is not None
    assert not kept.usable
    assert verdict in kept.text
    assert json.loads(said.out)["verdict"] == {"usable": False, "text": kept.text}


def test_the_summary_of_a_run_that_a_fault_ended_says_the_fault_once(bodies: Path) -> None:
    run = runs_of(bodies, "swing")[0]
    failed = Run(folder=run.folder, header=run.header.model_copy(update={"state": "failed", "reason": "the plug."}))
    stairs = Run(folder=run.folder, header=failed.header.model_copy(update={"requested": {"steps": [0, 2000]}}))

    assert verdict_line(failed) == "NOT USABLE: the fault below ended it. Record it again."
    assert verdict_line(stairs).endswith(f"`cfid log swing --resume {run.folder.name}` records what it lacks.")


def test_a_verdict_that_cannot_be_kept_costs_no_recording(bodies: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = runs_of(bodies, "swing")[0]
    (run.folder / "run.toml").unlink()

    def judge(_: Run) -> str:
        return "fine"

    assert judged(run, judge) is run
    assert "the verdict was not kept" in capsys.readouterr().err


def test_a_command_ends_with_the_verdict_and_lists_tell_what_is_not_usable(lab: Lab, cfid: Cfid) -> None:
    # An axis that turns steadily is no swing.
    said = lab.cfid("log", "encoder", "--axis", "x", "--for", 0.5, "--json")
    verdict = json.loads(said.out)["verdict"]

    assert said.code == 0
    assert not verdict["usable"]
    assert verdict["text"]
    listed = json.loads(cfid("runs", "--campaign", lab.folder, "--json").stdout)["runs"]
    assert "not usable: " in listed[-1]["note"]
    assert lab.cfid("log", "loadcell", "--for", 0.5).out.splitlines()[-1].startswith("good: Fz ")


def test_the_list_of_runs_states_what_is_not_usable_and_show_says_why(bodies: Path, cfid: Cfid) -> None:
    spoilt, stopped, *_ = runs_of(bodies, "swing")
    text = "the waveform differs from a pendulum's by 2.4 % of the release angle (limit 0.16 %): a cable, or a hand."
    amend_run(spoilt, verdict=Verdict(usable=False, text=text))
    header = stopped.header.model_copy(update={"state": "failed", "reason": text})
    write_header(stopped.folder, header)
    judged(read_run(stopped.folder), None)
    listed = {line.split()[0]: line for line in cfid("runs", "--campaign", bodies).stdout.splitlines() if line.strip()}
    shown = cfid("show", spoilt.folder, "--no-figures", "--json").stdout
    row = next(
        row
        for row in json.loads(cfid("runs", "--campaign", bodies, "--json").stdout)["runs"]
        if row["run"] == spoilt.folder.name
    )

    assert " not usable " in listed[spoilt.folder.name]
    assert " failed " in listed[stopped.folder.name]
    assert "a cable, or a hand" not in str(listed)
    assert text in str(json.loads(shown)["findings"])
    assert (row["state"], row["usable"]) == ("complete", False)
    assert row["note"].endswith(f"not usable: {text}")
    assert cfid("report", "--campaign", bodies, "--out", bodies / "report.md", "--format", "md").returncode == 0
    (line,) = [line for line in (bodies / "report.md").read_text().splitlines() if "| not usable |" in line]
    assert spoilt.folder.name in line.replace("\\", "")


def test_a_cell_whose_force_never_changes_is_not_usable(tmp_path: Path) -> None:
    values = [np.full(200, 5_000_000)] * 6
    facts = {"counts_per_n": 1e6, "counts_per_nm": 1e6}
    frozen = recorded(tmp_path, "loadcell", (1.7e9 + np.arange(200) / 80, *values), "t,Fx,Fy,Fz,Tx,Ty,Tz", **facts)
    run = judged(read_run(frozen), cfid.loadcell.verdict.verdict)

    assert verdict_line(run).startswith("NOT USABLE: Fz is 5000 in all 200 samples: press on the cell")


def of_one_axis(folder: Path, counts: npt.NDArray[np.float64]) -> Run:
    """Return a judged run of a bar load cell that reads `counts` (n,) at 80 Hz."""
    times = 1.7e9 + np.arange(len(counts)) / 80
    run = recorded(folder, "loadcell", (times, 2.3e-5 * counts), "t,Fz", units="n,nm")
    return judged(read_run(run), cfid.loadcell.verdict.verdict)


def noisy_counts(size: int = 800) -> npt.NDArray[np.float64]:
    """Return counts (n,) of the amplifier of a bar load cell under 1 N."""
    return np.rint(43500 + np.random.default_rng(1).normal(0, 20, size))


@pytest.mark.parametrize("value", [0, 43512])
def test_a_cell_that_shows_one_value_from_the_middle_on_is_not_usable(tmp_path: Path, value: int) -> None:
    counts = noisy_counts()
    counts[400:] = value
    line = verdict_line(of_one_axis(tmp_path, counts))

    assert line.startswith("NOT USABLE: Fz repeats one value in 40")
    assert f"of 800, as {2.3e-2 * value:.6g} mN from 5 s on: the load cell hung. Check its wires" in line


def test_a_cell_that_hangs_for_a_moment_is_named_beside_its_noise(tmp_path: Path) -> None:
    counts = noisy_counts()
    counts[400:440] = counts[400]
    line = verdict_line(of_one_axis(tmp_path, counts))

    assert line.startswith("good: Fz 10")
    assert "Fz repeats one value in 40 samples of 800" in line


def test_scales_whose_steps_are_coarser_than_their_noise_do_not_hang(tmp_path: Path) -> None:
    """The scales read a constant zero without a load, and flicker by one step under a load."""
    counts = np.rint(500 + np.random.default_rng(2).normal(0, 0.4, 800))
    counts[:400] = 0
    assert "repeats" not in verdict_line(of_one_axis(tmp_path, counts))


def test_a_recording_that_lost_a_tenth_is_not_called_good(tmp_path: Path) -> None:
    values = (1.7e9 + np.arange(200) / 80, np.arange(200))
    lossy = recorded(tmp_path, "encoder", values, "t,phi", counts_per_turn=8192.0)
    header = lossy / "run.toml"
    header.write_text(header.read_text("utf-8").replace("lost = 0", "lost = 20"), "utf-8")
    run = judged(read_run(lossy), lambda run: "9 peaks.")

    assert verdict_line(run).startswith("usable, but with losses: 9 peaks. 20 of 220 samples of encoder are lost")


def test_a_verdict_stays_when_a_note_is_written(bodies: Path) -> None:
    run = judged(runs_of(bodies, "swing")[0], cfid.swing.verdict.verdict)
    noted = amend_run(run, note="the second battery")

    assert noted.header.verdict == run.header.verdict
    assert read_run(run.folder).header.label.note == "the second battery"


def test_a_recording_of_no_use_is_left_out_unless_it_is_named(bodies: Path, cfid: Cfid) -> None:
    swings = runs_of(bodies, "swing")
    amend_run(swings[0], verdict=Verdict(usable=False, text="no release"))
    by_name = cfid("fit", "swing", swings[0].folder.name, "--campaign", bodies)
    every = cfid("fit", "inertia", "--campaign", bodies)

    assert by_name.returncode == 0
    assert f"left out: {swings[0].folder.name} (not usable)" in every.stderr


def test_a_recording_of_an_hour_is_not_judged_at_its_end(bodies: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = runs_of(bodies, "swing")[0]
    os.truncate(run.device_file("encoder"), 500_000_000)  # sparse, without a byte on the disk

    def judge(_: Run) -> str:
        raise AssertionError("this would be read")

    assert judged(run, judge).header.verdict is None
    assert "not judged: 500 MB" in capsys.readouterr().err


def test_ctrl_c_while_a_recording_is_judged_leaves_the_summary_to_be_printed(bodies: Path) -> None:
    run = runs_of(bodies, "swing")[0]

    def judge(_: Run) -> str:
        raise KeyboardInterrupt

    assert judged(run, judge) is run
