"""Each recording is judged as it ends, by the code that will fit it, and the run keeps the verdict."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

import cfid.friction.verdict
import cfid.loadcell.verdict
import cfid.swing.verdict
from cfid.console.run_summary import Judge, judged, verdict_line
from cfid.errors import CfidError, ConfigError
from cfid.motors.plan import missing
from cfid.records.run import Run, Verdict, amend_run, list_runs, read_run, write_header
from tests.lab import Cfid, made_run
from tests.virtual_lab import Lab, LabCommand, lab_in

judge_swing, judge_drop = cfid.swing.verdict.verdict, cfid.friction.verdict.verdict

Rows = Callable[[pd.DataFrame], pd.DataFrame]


def runs_of(folder: Path, kind: str) -> list[Run]:
    found = [run for run in list_runs(folder / "runs") if isinstance(run, Run)]
    return [run for run in found if run.header.kind == kind]


def verdict_of(run: Run, judge: Judge = judge_swing) -> Verdict:
    """Return a run's verdict, which its run.toml keeps too."""
    verdict = judged(run, judge).header.verdict
    assert verdict is not None
    assert verdict == read_run(run.folder).header.verdict
    return verdict


def fine(run: Run) -> str:
    return "fine."


# Swings and drops


@pytest.mark.parametrize(
    ("kind", "judge", "usable", "said"),
    [
        ("swing", judge_swing, True, "peaks from"),
        ("swing", cfid.swing.verdict.of_no_mount, True, "turned over"),
        ("drop", judge_drop, True, "20 g"),
        ("drop", judge_swing, False, ""),
    ],
)
def test_a_sound_recording_is_good_for_what_it_is(
    bodies: Path, kind: str, judge: Judge, usable: bool, said: str
) -> None:
    run = runs_of(bodies, kind)[0]
    verdict = verdict_of(run, judge)

    assert verdict.usable == usable
    assert said in verdict.text
    assert verdict_line(read_run(run.folder)).startswith("good: " if usable else "NOT USABLE: ")


def freeze_at_fastest(rows: pd.DataFrame) -> pd.DataFrame:
    phi = rows["phi"].to_numpy()
    fastest = int(np.abs(phi[100:-2900] - phi[:-3000]).argmax()) + 100
    return rows.assign(phi=np.where(np.arange(len(phi)) < fastest, phi, phi[fastest]))


def freeze_after_a_third(rows: pd.DataFrame) -> pd.DataFrame:
    phi, begin = rows["phi"].to_numpy(), len(rows) // 3
    return rows.assign(phi=np.where(np.arange(len(phi)) < begin, phi, phi[begin]))


def repeat_eightfold(rows: pd.DataFrame) -> pd.DataFrame:
    places = np.arange(len(rows))
    return rows.assign(phi=rows["phi"].to_numpy()[places - places % 8])


def bunch_with_a_coarse_clock(rows: pd.DataFrame) -> pd.DataFrame:
    stamps_us = (1e3 * (rows["t"] - rows["t"][0])).astype(int) + np.arange(len(rows))  # stamps have to rise
    return rows.assign(t=0.1 * np.ceil(rows["t"] / 0.1), device_us=stamps_us)


@pytest.mark.parametrize(
    ("kind", "change", "usable", "said"),
    [
        ("drop", freeze_at_fastest, False, "the body turned"),  # a floor stops a weight, and its axis: nothing froze
        ("swing", freeze_after_a_third, False, "froze"),
        ("swing", repeat_eightfold, True, "repeated in about 8 rows"),
        ("swing", bunch_with_a_coarse_clock, False, "no steady clock"),
    ],
)
def test_what_ails_an_angle_is_named(bodies: Path, kind: str, change: Rows, usable: bool, said: str) -> None:
    run = runs_of(bodies, kind)[0]
    rows = change(pd.read_csv(run.device_file("encoder"), dtype={"t": np.float64}))
    rows.to_csv(run.device_file("encoder"), index=False, float_format="%.6f")
    device = run.header.devices["encoder"].model_copy(update={"columns": tuple(rows.columns)})
    write_header(run.folder, run.header.model_copy(update={"devices": {"encoder": device}}))
    verdict = verdict_of(read_run(run.folder))

    assert verdict.usable == usable
    assert said in verdict.text


# Losses


@pytest.mark.parametrize(
    ("counts", "said"),
    [
        ({"lost": 5}, ""),
        ({"lost": 500}, "500 of 1500"),
        ({"skipped": 1000}, "500 of 1000 Hz"),
        ({"skipped": 14000, "gaps": [{"from_s": 0.0, "to_s": 14.0, "reason": "", "stood_s": 14.0}]}, "14.0 s"),
        ({"skipped": 14000, "gaps": [{"from_s": 0.0, "to_s": 14.0, "reason": "", "stood_s": 0.4}]}, "1000 Hz"),
    ],
)
def test_losses_stand_beside_a_verdict_with_their_cause(bodies: Path, counts: dict[str, Any], said: str) -> None:
    run = runs_of(bodies, "swing")[0]
    device = run.header.devices["encoder"].model_copy(update={"rows": 1000, "lost": 0, "rate_hz": 1000.0, **counts})
    write_header(run.folder, run.header.model_copy(update={"devices": {"encoder": device}}))

    for judge, usable in ((refuse, False), (fine, True)):
        verdict = verdict_of(read_run(run.folder), judge)
        assert verdict.usable == usable
        assert (verdict.text == "fine.") == (said == "")
        assert said in verdict.text
    assert verdict_line(read_run(run.folder)).startswith("usable, but with losses: " if said else "good: ")


def refuse(run: Run) -> str:
    raise CfidError("fine.")


# Load cells


def of_a_load_cell(folder: Path, counts: npt.NDArray[np.float64]) -> Verdict:
    """Return the verdict on a bar load cell that reads `counts` (n,) at 80 Hz."""
    columns = {"t": 1.7e9 + np.arange(len(counts)) / 80, "Fz": 2.3e-5 * counts}
    run = made_run(folder, "loadcell", {"loadcell": columns}, facts_of={"loadcell": {"units": "n,nm"}})
    return verdict_of(run, cfid.loadcell.verdict.verdict)


@pytest.mark.parametrize(
    ("begin", "end", "value", "usable"),
    [(0, 800, 43512, False), (400, 800, 0, False), (400, 440, 43512, True)],
)
def test_a_cell_that_hangs_is_named(tmp_path: Path, begin: int, end: int, value: int, usable: bool) -> None:
    counts = np.rint(43500 + np.random.default_rng(1).normal(0, 20, 800))  # of an amplifier under 1 N
    counts[begin:end] = value
    verdict = of_a_load_cell(tmp_path, counts)

    assert verdict.usable == usable
    assert f"{2.3e-2 * value:.6g}" in verdict.text or usable
    assert f"{end - begin}" in verdict.text or value == 0  # some counts before are zero by chance


# What is not judged


def test_a_run_that_was_cut_is_not_judged(bodies: Path) -> None:
    run = runs_of(bodies, "swing")[0]
    cut = Run(folder=run.folder, header=run.header.model_copy(update={"state": "interrupted"}))

    assert judged(cut, judge_swing).header.verdict is None
    assert run.folder.name in verdict_line(cut)


@pytest.mark.parametrize("held_s", [0.5, 0.99])
def test_a_staircase_that_ended_early_is_to_be_resumed_only_where_it_lacks_a_step(
    tmp_path: Path, held_s: float
) -> None:
    columns = {"t": [1.7e9, 1.7e9 + held_s], "m1": [20000, 0], "m2": [0, 0], "m3": [0, 0], "m4": [0, 0]}
    wanted = {"steps": [20000], "motors": [1], "hold_s": 1.0, "rest_s": 1.0}
    run = made_run(tmp_path, "thrust", {"commands": columns}, state="interrupted", requested=wanted)
    lacks = held_s < 0.98

    assert ("--resume" in verdict_line(run)) == lacks
    if not lacks:
        with pytest.raises(ConfigError, match="nothing is left to record"):
            missing(run.folder, kind="thrust")


def test_ctrl_c_while_a_recording_is_judged_leaves_the_summary_to_be_printed(bodies: Path) -> None:
    def judge(_: Run) -> str:
        raise KeyboardInterrupt

    run = runs_of(bodies, "swing")[0]
    assert judged(run, judge) is run


def test_a_verdict_that_cannot_be_kept_costs_no_recording(bodies: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = runs_of(bodies, "swing")[0]
    (run.folder / "run.toml").unlink()

    assert judged(run, fine) is run
    assert "not kept" in capsys.readouterr().err


# Recorded by a command


def silence(lab: Lab, log: LabCommand) -> None:
    lab.loadcell_suffers(silent_after_s=0)
    log.go_on_for(1.5)


def saturate(lab: Lab, log: LabCommand) -> None:
    lab.box.box.load_cell.overload()


def unplug(lab: Lab, log: LabCommand) -> None:
    lab.pull_plug()
    log.go_on_for(1)


@pytest.mark.parametrize(
    ("words", "ruin", "verdict"),
    [
        (("loadcell",), silence, "sent nothing more"),
        (("loadcell",), saturate, "saturation"),
        (("encoder", "--axis", "x"), unplug, "unplugged"),
    ],
)
def test_a_recording_that_a_fault_ends_keeps_the_fault_as_its_verdict(
    tmp_path: Path, words: tuple[str, ...], ruin: Callable[[Lab, LabCommand], None], verdict: str
) -> None:
    with lab_in(tmp_path) as lab:
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


def test_a_command_ends_with_the_verdict_and_lists_tell_what_is_not_usable(tmp_path: Path) -> None:
    with lab_in(tmp_path) as lab:  # whose axis turns steadily, which is no swing
        said = lab.cfid("log", "encoder", "--axis", "x", "--for", 0.5, "--json")
        verdict = json.loads(said.out)["verdict"]
        listed = json.loads(lab.cfid("runs", "--json").out)["runs"]
        loaded = lab.cfid("log", "loadcell", "--for", 0.5)

    assert said.code == loaded.code == 0
    assert not verdict["usable"]
    assert verdict["text"] in listed[-1]["note"]
    assert loaded.out.splitlines()[-1].startswith("good: Fz ")


# What becomes of a verdict


def test_the_list_of_runs_states_what_is_not_usable_and_show_says_why(bodies: Path, cfid: Cfid) -> None:
    spoilt, stopped, *_ = runs_of(bodies, "swing")
    amend_run(spoilt, verdict=Verdict(usable=False, text="a cable, or a hand."))
    write_header(stopped.folder, stopped.header.model_copy(update={"state": "failed", "reason": "a cable, or a hand."}))
    judged(read_run(stopped.folder), None)
    listed = {line.split()[0]: line for line in cfid("runs", "--campaign", bodies).stdout.splitlines() if line.strip()}
    shown = json.loads(cfid("show", spoilt.folder, "--no-figures", "--json").stdout)
    rows = {row["run"]: row for row in json.loads(cfid("runs", "--campaign", bodies, "--json").stdout)["runs"]}
    report = bodies / "report.md"

    assert " not usable " in listed[spoilt.folder.name]
    assert " failed " in listed[stopped.folder.name]
    assert "a cable, or a hand." in str(shown["findings"])
    assert (rows[spoilt.folder.name]["state"], rows[spoilt.folder.name]["usable"]) == ("complete", False)
    assert cfid("report", "--campaign", bodies, "--out", report, "--format", "md").returncode == 0
    (line,) = [line for line in report.read_text().splitlines() if "| not usable |" in line]
    assert spoilt.folder.name in line.replace("\\", "")
