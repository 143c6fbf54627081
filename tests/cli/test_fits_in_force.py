"""A poorer fit takes no number away: the campaign's file keeps the better one, and every reader takes the same."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import ANY

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cfid.records.parameters import Section
from tests.export.thesis_vehicle import sections
from tests.lab import Cfid, keep, sections_at

MANY, FEW = range(4000, 65536, 4000), (20000, 40000, 60000)
LARGEST_N = 2.4e-11 * 65535**2 + 6e-7 * 65535
SPEED = "motor.speed_poly"


def stand(path: Path, commands: range | tuple[int, ...], *, seed: int, noise_n: float = 2e-4) -> Path:
    """Write what a thrust stand on a supply showed: a quadratic of the command."""
    cmd = np.repeat(np.array(commands, dtype=float), 2 if isinstance(commands, range) else 1)
    thrust = 2.4e-11 * cmd**2 + 6e-7 * cmd + np.random.default_rng(seed).normal(0, noise_n, len(cmd))
    rows = np.column_stack([cmd, thrust, np.full(len(cmd), 3.7)])
    np.savetxt(path, rows, fmt="%.6f", delimiter=",", header="cmd,thrust_n,voltage_v", comments="")
    return path


@pytest.fixture
def lab(cfid: Cfid, tmp_path: Path) -> Path:
    """A campaign whose thrust was fitted to 32 points."""
    assert cfid("new", "lab", "--kind", "simulated").returncode == 0
    stand(tmp_path / "lab" / "many.csv", MANY, seed=1)
    stand(tmp_path / "lab" / "few.csv", FEW, seed=2)
    assert cfid("fit", "thrust", "many.csv", "--no-figures", folder=tmp_path / "lab").returncode == 0
    return tmp_path / "lab"


def thrust(lab: Path) -> Section:
    return sections_at(lab)["thrust"]


def fits(lab: Path) -> list[dict[str, Any]]:
    return [json.loads(path.read_text()) for path in sorted((lab / "fits").glob("*.json"), key=lambda path: path.stem)]


def test_a_fit_of_fewer_points_is_kept_beside_the_better_one_which_stays_in_force(cfid: Cfid, lab: Path) -> None:
    before = (lab / "parameters.toml").read_bytes()
    ended = cfid("fit", "thrust", "few.csv", "--no-figures", "--json", folder=lab)
    shown = json.loads(ended.stdout)

    assert (ended.returncode, shown["accepted"], shown["in_force"]) == (0, True, False)
    assert (lab / "parameters.toml").read_bytes() == before
    assert thrust(lab).parameters["motor.max_thrust_n"].value == pytest.approx(LARGEST_N, rel=0.01)
    kept = fits(lab)
    assert len(kept) == 2
    assert kept[-1]["section"]["sources"][0]["path"].endswith("few.csv")
    assert kept[-1]["section"]["parameters"]["motor.thrust_poly"] == shown["parameters"]["motor.thrust_poly"]


def test_why_lists_the_candidates_of_a_key(cfid: Cfid, lab: Path) -> None:
    cfid("fit", "thrust", "few.csv", "--no-figures", folder=lab)
    rows = json.loads(cfid("parameters", "--why", "motor.thrust_poly", "--json", folder=lab).stdout)["candidates"]

    assert [(row["fit"], row["taken"], row["unit"]) for row in rows] == [
        ("0001_thrust", True, "N(cmd)"), ("0002_thrust", False, "N(cmd)"),
    ]  # fmt: skip
    assert rows[0]["std_over_aim"] < 1
    assert rows[1]["why"].startswith("0001_thrust is more certain")
    assert "0001_thrust" in cfid("parameters", "--why", "motor.thrust_poly", folder=lab).stdout
    assert cfid("parameters", "--why", "nothing", folder=lab).returncode == 2


def test_a_dropped_fit_brings_the_next_best_back_and_stays_in_its_folder(cfid: Cfid, lab: Path) -> None:
    cfid("fit", "thrust", "few.csv", "--no-figures", folder=lab)
    dropped = cfid("fits", "drop", "0001_thrust", folder=lab)

    assert (dropped.returncode, "now come from 0002_thrust" in " ".join(dropped.stdout.split())) == (0, True)
    assert thrust(lab).sources[0].path.endswith("few.csv")
    assert (lab / "fits" / "0001_thrust.json").exists()
    listed = json.loads(cfid("fits", "--json", folder=lab).stdout)["fits"]
    assert [(row["fit"], row["state"]) for row in listed] == [("0001_thrust", "withdrawn"), ("0002_thrust", ANY)]
    assert "withdrawn" in cfid("fits", folder=lab).stdout
    assert cfid("fits", "drop", "1", folder=lab).returncode == 2


def test_a_fit_of_runs_is_repeated_with_the_same_numbers_and_one_of_files_is_refused(
    cfid: Cfid, bodies: Path, lab: Path
) -> None:
    assert cfid("fit", "friction", "--no-figures", folder=bodies).returncode == 0
    (stem,) = (path.stem for path in (bodies / "fits").glob("*_friction.json"))
    repeated = cfid("fits", "repeat", stem, "--json", folder=bodies)

    shown = {"command": "fits repeat", "fit": stem, "same": True, "moved": [], "gone": [], "new": []}
    assert (repeated.returncode, json.loads(repeated.stdout)) == (0, shown)
    assert cfid("fits", "repeat", "1", folder=lab).returncode == 4
    path = bodies / "fits" / f"{stem}.json"
    content = json.loads(path.read_text())
    content["section"]["parameters"]["friction.coulomb_nm"]["value"] *= 1.01
    path.write_text(json.dumps(content))
    assert "friction.coulomb_nm: " in cfid("fits", "repeat", stem, folder=bodies).stdout
    moved = cfid("fits", "repeat", stem, "--json", folder=bodies)
    shown = json.loads(moved.stdout)
    assert (moved.returncode, shown["same"]) == (5, False)
    assert [row["name"] for row in shown["moved"]] == ["friction.coulomb_nm"]


def test_a_value_set_by_hand_counts_before_a_fit(cfid: Cfid, lab: Path) -> None:
    assert cfid("set", "motor.max_thrust_n", "0.15", folder=lab).returncode == 0
    sections = json.loads(cfid("parameters", "--json", folder=lab).stdout)["sections"]

    assert sections["set"]["parameters"]["motor.max_thrust_n"]["value"] == 0.15
    assert "motor.max_thrust_n" not in sections["thrust"]["parameters"]
    (row,) = (line for line in (lab / "parameters.toml").read_text().splitlines() if "motor.max_thrust_n" in line)
    assert tomllib.loads(row)["motor.max_thrust_n"] == {"value": 0.15, "unit": "N", "from": "0002_set"}


def test_a_fit_gives_way_once_one_of_its_runs_is_excluded(cfid: Cfid, bodies: Path) -> None:
    drops = sorted(path.name for path in (bodies / "runs").glob("*_drop_*"))
    first = [next(name for name in drops if f"_{weight}g" in name) for weight in (20, 50)]
    assert cfid("fit", "friction", "--no-figures", folder=bodies).returncode == 0
    kept = cfid("fit", "friction", *first, "--no-figures", "--json", folder=bodies)
    assert (kept.returncode, json.loads(kept.stdout)["in_force"]) == (0, False)

    assert cfid("runs", "exclude", drops[-1], "--note", "test", folder=bodies).returncode == 0
    assert cfid("fit", "friction", *first, "--no-figures", folder=bodies).returncode == 0


def test_a_rejected_fit_replaces_no_accepted_one_even_by_force(cfid: Cfid, tmp_path: Path) -> None:
    """With half of the encoder's counts per turn, all angles of the same pendulum double."""
    assert cfid("new", "lab", "--kind", "simulated").returncode == 0
    lab = tmp_path / "lab"
    t_s = np.arange(0, 20, 0.002)
    swing = solve_ivp(lambda _, y: [y[1], -200 * np.sin(y[0]) - 0.05 * y[1]], (0, 20), [0.7, 0], t_eval=t_s, rtol=1e-9)
    angle = np.concatenate([np.zeros(400), np.linspace(0, 0.7, 300), np.full(300, 0.7), swing.y[0]])
    rows = np.column_stack([0.002 * np.arange(len(angle)), np.round(angle / (2 * np.pi) * 8192)])
    np.savetxt(lab / "swing.csv", rows, fmt=("%.3f", "%d"), delimiter=",", header="t,phi", comments="")
    for counts in (8192, 4096):
        made = cfid("import", "swing.csv", "--axis", "x", "--counts-per-turn", counts, folder=lab)
        assert made.returncode == 0, made.stderr
    right, halved = sorted((lab / "runs").iterdir())
    words = ("fit", "swing", "--no-figures", "--json")
    assert cfid(*words, right, folder=lab).returncode == 0
    before = (lab / "parameters.toml").read_bytes()

    ended = cfid(*words, halved, "--force", folder=lab)
    shown = json.loads(ended.stdout)
    assert (ended.returncode, shown["accepted"], shown["in_force"]) == (0, False, False)
    assert (lab / "parameters.toml").read_bytes() == before
    assert len(fits(lab)) == 2


def test_reports_exports_and_status_take_the_accepted_value_where_a_later_section_rejected_its_own(
    cfid: Cfid, tmp_path: Path
) -> None:
    assert cfid("new", "lab", "--kind", "simulated").returncode == 0
    lab = tmp_path / "lab"
    for name, section in sections().items():
        keep(lab, name, section)
    dynamics, value = sections()["dynamics"], sections()["speed"].parameters[SPEED]
    doubled = {**dynamics.parameters, SPEED: replace(value, value=[2 * one for one in value.value])}
    keep(lab, "dynamics", replace(dynamics, parameters=doubled, rejected={SPEED: "twice."}))

    ended = cfid("export", "webots", "--out", "-", folder=lab)
    assert (ended.returncode, "REJECTED" in ended.stdout) == (0, False)
    targets = json.loads(cfid("export", "list", "--json", folder=lab).stdout)["targets"]
    assert not any(row["rejected"] for row in targets)
    vehicle = json.loads(cfid("export", "json", "--out", "-", folder=lab).stdout)
    assert vehicle["quantities"][SPEED]["value"] == value.value
    assert cfid("report", "--out", "report.json", folder=lab).returncode == 0
    report = json.loads((lab / "report.json").read_text())
    rows = [
        row for group in report["sheet"] for one in group["quantities"] if SPEED in one["keys"] for row in one["rows"]
    ]
    assert [row["value"] for row in rows] == value.value


def test_an_export_refuses_where_a_kept_fit_is_torn_and_names_it(cfid: Cfid, lab: Path) -> None:
    assert cfid("set", "arm_m", "0.05", folder=lab).returncode == 0
    path = lab / "fits" / "0002_set.json"
    path.write_text(path.read_text()[:-20])

    for words in (("parameters",), ("status",)):
        assert path.name in cfid(*words, folder=lab).stderr
    ended = cfid("export", "json", folder=lab)
    assert ended.returncode == 4
    assert path.name in ended.stderr
