"""Coverage of the 95 % intervals on rigs that are not ideal, with a row for each imperfection.

    python -m tests.nightly.coverage --n 200 --out coverage.jsonl
    python -m tests.nightly.coverage --out coverage.jsonl --table

Each line of the file is one fit. Fits in the file are not repeated, so that a run can be ended and continued. The
seeds of a row are 0 to n - 1: each draws the values of the row's imperfections from their distributions, and then the
recording. The rows take turns, 20 seeds at a time, so that a run that was ended has about as many fits of each row.
"""

import argparse
import json
import math
import os
import time
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.stats import binomtest

from cfid.console.campaign import make_campaign
from cfid.demo.truth import DEMO_TRUTH
from cfid.errors import CfidError
from cfid.records.campaign import find_campaign
from cfid.records.files import RIG_FILE
from cfid.records.result import Result
from cfid.records.rig_file import change_rig
from cfid.sim.truth import SimTruth, as_mounted, draw, imperfection
from cfid.units import COVERAGE_95
from tests.nightly import experiments as on

LIPO = {"battery": {"kind": "lipo"}}
_TURN = 20  # seeds
WRONG = 4.0  # standard uncertainties: a larger error of an accepted value counts as wrong


@dataclass(frozen=True, kw_only=True)
class Row:
    """An experiment with imperfections (key and size, None for the usual size), and other content of the truth file.

    `rig` contains keys of rig.toml, as "table.key", that state how well the lab knows its scales; None states nothing.
    """

    name: str
    run: on.Experiment
    drawn: Mapping[str, float | None] = field(default_factory=dict)
    stated: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    rig: Mapping[str, Any] = field(default_factory=dict)
    fits: int = 200

    def truth(self, rng: np.random.Generator) -> SimTruth:
        """Draw the truth of one rig."""
        content = {"radio": DEMO_TRUTH.radio.model_dump(exclude_unset=True)}
        for section, values in self.stated.items():
            content[section] = {**content.get(section, {}), **values}
        truth = SimTruth.model_validate(content)
        return draw(truth, [imperfection(key, size=size) for key, size in self.drawn.items()], rng=rng)


def _row(
    name: str,
    run: on.Experiment,
    *keys: str,
    stated: Mapping[str, Any] | None = None,
    rig: Mapping[str, Any] | None = None,
    **sizes: float,
) -> Row:
    drawn = {**dict.fromkeys(keys), **{key.replace("__", "."): size for key, size in sizes.items()}}
    return Row(name=name, run=run, drawn=drawn, stated=stated or {}, rig=rig or {}, fits=1000 if run in _QUICK else 200)


_QUICK = (on.swing, on.speed, on.pings)
_GAIN_OF_1_PERCENT = {"loadcell.gain_std": [0.01] * 6}
_NO_LINE = {"friction.line_mm": None}

ROWS = (
    _row("swing: ideal", on.swing),
    _row("swing: eccentric 0.3 deg", on.swing, "swing.eccentricity_deg"),
    _row("swing: eccentric 1 deg", on.swing, swing__eccentricity_deg=1.0),
    _row("swing: cable of 1 % of gravity", on.swing, "swing.spring_nm_per_rad"),
    _row("swing: Stribeck friction", on.swing, "swing.stribeck_nm"),
    _row("swing: friction varies with angle", on.swing, "swing.ripple_nm"),
    _row("matrix: ideal", on.matrix),
    _row("matrix: cube of 1.2 g neglected", on.matrix, "vehicle.fixture_kg"),
    _row("matrix: axle of 0.5 g neglected", on.matrix, vehicle__fixture_kg=5e-4),
    _row("matrix: centre of mass 0.5 mm off", on.matrix, "vehicle.centre_of_mass_error_mm"),
    _row("matrix: axes 1 deg off", on.matrix, "swing.tilt_deg"),
    _row("matrix: mass 0.1 g off", on.matrix, "vehicle.mass_error_kg"),
    _row("matrix: two swings swapped", on.swapped_matrix),
    _row("friction: ideal", on.friction),
    _row("friction: line's thickness neglected", on.friction, "axis.line_diameter_mm", rig=_NO_LINE),
    _row("friction: line in layers", on.friction, "axis.line_diameter_mm", "axis.turns_per_layer", rig=_NO_LINE),
    _row("friction: 20 and 50 g exchanged", on.swapped_friction),
    _row("maps: ideal", on.thrust_and_torque),
    _row("maps: thrust scatters 0.5 %", on.thrust_and_torque, "rotors.thrust_scatter"),
    _row("maps: thrust scatters 2 %", on.thrust_and_torque, rotors__thrust_scatter=0.02),
    _row("maps: load cell's gain 1 % off", on.thrust_and_torque, "loadcell.gain_error", rig=_GAIN_OF_1_PERCENT),
    _row("maps: cross-talk", on.thrust_and_torque, "loadcell.crosstalk"),
    _row("maps: warm-up 2 %", on.up_and_down, "loadcell.warm_up"),
    _row("maps: warm-up 2 %, commands held for 10 s", on.slow_up_and_down, "loadcell.warm_up"),
    _row("maps: up and down", on.up_and_down),
    _row("speed map: ideal", on.speed),
    _row("speed map: error in proportion", on.speed, "rotors.tachometer_std"),
    _row(
        "speed map: tachometer's gain 0.5 % off",
        on.speed,
        "rotors.tachometer_gain",
        rig={"tachometer.scale_std": 0.005},
    ),
    _row("maximum thrust: ideal", on.maximum_thrust),
    _row("maximum thrust: battery sags", on.maximum_thrust, "battery.charge", stated=LIPO),
    _row("steps: ideal", on.step_response),
    _row("steps: speed wanders", on.step_response, "rotors.speed_wander"),
    _row("steps: battery sags", on.step_response, "battery.charge", stated=LIPO),
    _row("steps: slower fall", on.step_response, "rotors.slower_fall"),
    _row("transfer: ideal", on.transfer_function),
    _row("transfer: 1 % of reports lost", on.transfer_function, "radio.loss"),
    _row("transfer: 3 % of reports lost", on.transfer_function, radio__loss=0.03),
    _row("transfer: 10 % of reports lost", on.transfer_function, radio__loss=0.1),
    _row("transfer: arm 1 % off", on.transfer_function, "rotors.arm_error", rig={"loadcell.arm_std_mm": 0.46}),
    _row("transfer: gain 1 % off", on.transfer_function, "loadcell.gain_error", rig=_GAIN_OF_1_PERCENT),
    _row("transfer: slower fall", on.transfer_function, "rotors.slower_fall"),
    _row("transfer: latency floor wanders 5 ms", on.transfer_function, "radio.floor_wander_s"),
    _row("drag: ideal", on.drag),
    _row("drag: anemometer's gain 4 % off", on.drag, "wind.anemometer_gain", rig={"wind.speed_scale_std": 0.04}),
    _row("drag: battery sags", on.drag, "battery.charge", stated=LIPO),
    _row("drag: tare wanders 6 mN", on.drag, "loadcell.bias_wander"),
    _row("pings: ideal", on.pings),
    _row("pings: congestion", on.pings, "radio.congestion_s"),
    _row("pings: delay without an edge", on.pings, "radio.jitter_shape"),
    _row("pings: floor wanders", on.pings, "radio.floor_wander_s"),
    _row("pings: floor wanders, ten minutes", on.pings_for_long, "radio.floor_wander_s"),
)


def measure(place: int, seed: int) -> dict[str, Any]:
    """Draw a rig, record, and fit; return a line of the file."""
    row, began_s = ROWS[place], time.monotonic()
    for_truth, for_recording = np.random.default_rng(seed).spawn(2)
    line: dict[str, Any] = {"row": row.name, "seed": seed, "numbers": {}, "rejected": {}, "warnings": []}
    with TemporaryDirectory(prefix="cfid-coverage-") as folder:
        make_campaign(Path(folder) / "lab", kind="simulated")
        for key, value in row.rig.items():
            table, name = key.split(".")
            _state(Path(folder) / "lab", table, name, value)
        campaign = find_campaign(Path(folder) / "lab", start=Path(folder))
        assert campaign is not None
        truth = as_mounted(row.truth(for_truth), campaign.rig)
        try:
            measured = row.run(campaign, truth, for_recording)
        except CfidError as error:
            line["rejected"] = {"*": str(error).replace(folder, "")}
        else:
            line["numbers"] = {
                name: [measured.truth[name], value, std]
                for result in measured.results
                for name, value, std in _given(result)
                if name in measured.truth
            }
            line["rejected"] = {key: why for result in measured.results for key, why in _refused(result).items()}
            line["warnings"] = sorted(
                {one.code for found in measured.results for one in found.findings if one.severity == "warning"}
                - {"recording"}  # it only reports that the recording is simulated
            )
    return {**line, "seconds": round(time.monotonic() - began_s, 2)}


def _state(folder: Path, table: str, name: str, value: object) -> None:
    if value is not None:
        change_rig(folder, table, {name: value})
        return
    path = folder / RIG_FILE
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    left = [line for line in lines if not line.startswith(f"{name} =")]
    assert len(left) == len(lines) - 1, name
    path.write_text("".join(left), encoding="utf-8")


def _given(result: Result) -> Iterable[tuple[str, float, float]]:
    if not result.accepted:
        return
    for key, parameter in result.without_rejected().quantities.items():
        for number in parameter.numbers(key):
            if number.value is not None and number.std is not None:
                yield number.name, number.value, number.std


def _refused(result: Result) -> Mapping[str, str]:
    if result.accepted:
        return result.rejected
    texts = [one.text for one in result.findings if one.severity == "rejection"]
    return {"*": " ".join(texts)}


def table(lines: Iterable[Mapping[str, Any]]) -> str:
    """Return a Markdown table with a line for each number of each row."""
    by_row: dict[str, list[Mapping[str, Any]]] = {}
    for line in lines:
        by_row.setdefault(line["row"], []).append(line)
    text = [
        "| row | number | n | bias | ratio | cover (95 % interval of it) | rejected | accepted though wrong | warned |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name in (row.name for row in ROWS if row.name in by_row):
        own = by_row[name]
        warned = f"{100 * np.mean([bool(line['warnings']) for line in own]):.0f} %"
        names = list(dict.fromkeys(number for line in own for number in line["numbers"]))
        text += [f"| {name} | {_shown(number, own)} | {warned} |" for number in names]
        if not names:
            text.append(f"| {name} | | {len(own)} | | | | 100 % | 0 % | {warned} |")
    return "\n".join(text) + "\n"


def _shown(number: str, lines: list[Mapping[str, Any]]) -> str:
    found = np.array([line["numbers"][number] for line in lines if number in line["numbers"]])
    true, value, std = found.T
    error = value - true
    score = error / std
    held = binomtest(int((np.abs(score) <= COVERAGE_95).sum()), len(score))
    low, high = held.proportion_ci(0.95, method="exact")
    bias = f"{100 * np.mean(error / true):+.2g} %" if true.all() else f"{error.mean():+.2g}"
    rejected = 1 - len(found) / len(lines)
    wrong = (np.abs(score) > WRONG).sum() / len(lines)
    cover = f"{100 * held.statistic:.0f} % ({100 * low:.0f} to {100 * high:.0f})"
    ratio = math.sqrt(np.mean(score**2))
    return f"{number} | {len(lines)} | {bias} | {ratio:.2f} | {cover} | {100 * rejected:.0f} % | {100 * wrong:.0f} %"


def main() -> None:
    """Measure the fits that the file lacks, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=int, help="fits a row; default: 1000 of quick ones, else 200")
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin no further fits after this time")
    parser.add_argument("--rows", default="", help="only rows whose name begins so")
    parser.add_argument("--out", type=Path, default=Path("coverage.jsonl"), help="file of results, continued")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--table", action="store_true", help="only print the table")
    arguments = parser.parse_args()
    if not arguments.table:
        _measure_all(arguments)
    print(table(_lines(arguments.out)))


def _measure_all(arguments: argparse.Namespace) -> None:
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    known = {(line["row"], line["seed"]) for line in _lines(arguments.out)}
    ends_s = time.monotonic() + 60 * arguments.minutes
    with arguments.out.open("a", encoding="utf-8") as file, ProcessPoolExecutor(arguments.jobs) as pool:
        for place, turn in turns(arguments.rows, arguments.n):
            if time.monotonic() > ends_s:
                return
            seeds = [seed for seed in turn if (ROWS[place].name, seed) not in known]
            for line in pool.map(measure, [place] * len(seeds), seeds):
                file.write(json.dumps(line) + "\n")
                file.flush()


def turns(begin: str, fits: int | None) -> Iterator[tuple[int, range]]:
    """Yield the index of a row and its next seeds, for rows whose names start with `begin`, until each has its fits."""
    rows = [(place, fits or row.fits) for place, row in enumerate(ROWS) if row.name.startswith(begin)]
    for first in range(0, max((count for _, count in rows), default=0), _TURN):
        yield from ((place, range(first, min(first + _TURN, count))) for place, count in rows)


def _lines(path: Path) -> list[dict[str, Any]]:
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


if __name__ == "__main__":
    main()
