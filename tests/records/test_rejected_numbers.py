"""A rejection removes the numbers of its quantities everywhere: figures of merit, lines, covariances and rows.

Each experiment gives a result. Then each of its quantities is rejected alone, and the tests search the remaining
result for digits that only this quantity has.
"""

import functools
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

import cfid.friction
import cfid.inertia
import cfid.swing
from cfid import drag, latency, transfer
from cfid.findings import rejection
from cfid.inertia.data import Swing
from cfid.motors import rotor
from cfid.motors.maps.result import fit_thrust
from cfid.recordings.angle import AngleRecord, labelled
from cfid.records.parameters import Source, plain
from cfid.records.result import Dependent, Result
from cfid.records.rig_file import thesis_rig
from cfid.records.run import Label
from cfid.transfer.model import TransferFunction
from tests.drag.thesis_campaign import COMPLEX_AIR, measured
from tests.drawn import swing_record
from tests.estimate.test_common_causes import evidence
from tests.friction.test_drops_of_imperfect_labs import record as dropped
from tests.inertia.test_inertia_result import TABLE_2_3, known
from tests.latency.test_latency import ping_run
from tests.motors.rotor_plant import Plant, write_log
from tests.transfer.sines_in_a_folder import sines, write_run


def _swing(name: str = "encoder") -> AngleRecord:
    time_s, angle_rad = swing_record()
    return AngleRecord(
        path=Path(f"{name}.csv"),
        source=Source(f"{name}.csv", "0" * 64),
        label=Label(),
        time_s=time_s,
        angle_rad=angle_rad,
        findings=(),
    )


def swing(_: Path) -> Result:
    return cfid.swing.fit(_swing(), mass_kg=0.03, distance_m=0.02)


def inertia(_: Path) -> Result:
    swings: list[Swing] = [*known()[:5], labelled(_swing(), axis="yz")]
    return cfid.inertia.fit(swings, rig=thesis_rig())


def friction(_: Path) -> Result:
    return cfid.friction.fit([dropped(grams) for grams in (20.0, 30.0, 40.0)], rig=thesis_rig())


def thrust(_: Path) -> Result:
    return fit_thrust(evidence(np.random.default_rng(1)), gravity_mps2=9.81)


@functools.cache
def rotors_of_a_log() -> Result:
    with TemporaryDirectory() as name:
        path = Path(name) / "log.csv"
        log = write_log(path, Plant(), 7, rotors=2, row_s=0.01)
        log["rpm.m2"] = 18000 + 2000 * np.random.default_rng(2).standard_normal(len(log))
        log.to_csv(path, index=False)
        return rotor.fit(path)


def rotors(_: Path) -> Result:
    return rotors_of_a_log()


def drag_of_a_complex_vehicle(_: Path) -> Result:
    return drag.fit(measured(COMPLEX_AIR, np.random.default_rng(3)), intercepts=False)


def transfer_function(folder: Path) -> Result:
    runs = [write_run(folder, run, series="bench") for run in sines((2, 5, 10, 20, 40), samples=2000)]
    return transfer.fit(runs, thrust_poly=[1e-11, 1e-6, 0.0])


def verification(folder: Path) -> Result:
    runs = [write_run(folder, run) for run in sines((5, 10), samples=2000)]
    function = TransferFunction.of_coefficients([0, 6.0705967e-8], [1, -0.9745210], delay_s=-0.0274)
    return transfer.verify(runs, function)


def round_trips(folder: Path) -> Result:
    return latency.fit([ping_run(folder)])


# Figures of merit that a rejection of a quantity removes, although their numbers differ from those of the quantity.
LOST: Mapping[Callable[[Path], Result], tuple[str, set[str]]] = {
    round_trips: ("latency.rtt_mean_s", {"one_way_mean_s"}),
    swing: ("swing.natural_frequency_squared_s2", {"damped_cosine", "log_decrement", "budget_s2"}),
    inertia: ("inertia.matrix_kg_m2", {"eigenvalues_kg_m2", "raw_matrix_kg_m2", "budget_kg_m2"}),
    friction: ("friction.viscous_nms_per_rad", set()),
    thrust: ("motor.max_thrust_n", {"common_causes.motor.max_thrust_n", "max_thrust_at_v"}),
    rotors: ("dynamics.rising", set()),
    drag_of_a_complex_vehicle: ("drag.complex.normalised.k3", {"normalised_squared"}),
    transfer_function: ("tf.static_gain_n", {"thesis.static_gain_n", "static_gain_off_slope"}),
    verification: ("tf.verify.*.fit_percent", set()),
}

# Data that no rejection of a quantity removes: known axis inertias, and points to which a map is fitted.
GIVEN = {f"inertia.{kind}_kg_m2.{axis}" for kind in ("axis", "centre") for axis in TABLE_2_3} | {"motor.table"}


@pytest.fixture(scope="module", params=LOST, ids=lambda make: make.__name__)
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Result]:
    return request.param, request.param(tmp_path_factory.mktemp("given"))


def test_no_digit_of_a_rejected_quantity_is_left(made: tuple[Any, Result]) -> None:
    _, result = made
    for key, quantity in result.quantities.items():
        if key in GIVEN:
            continue
        others = {digits for name, one in result.quantities.items() if name != key for digits in _digits_of(one)}
        own = {digits for digits in _digits_of(quantity) if len(digits) > 3} - others
        left = _without(result, key)

        assert key not in left.quantities
        assert not own & set(_digits(_text(left))), key
        assert not any(_states(line, own) for line in left.summary()), key


def test_what_follows_from_a_rejected_quantity_goes_with_it_and_the_rest_stays(made: tuple[Any, Result]) -> None:
    make, result = made
    key, lost = LOST[make]
    rejected = re.compile(re.escape(key).replace(r"\*", ".*"))
    (key, *_) = (one for one in result.quantities if rejected.fullmatch(one))
    before, after = set(_paths(plain(result.quality))), set(_paths(plain(_without(result, key).quality)))
    gone = {re.sub(r"^runs\.[^.]*\.", "runs.*.", path) for path in before - after}

    assert {path for path in lost if not any(one.startswith(path) for one in gone)} == set()
    assert {one for one in gone if not one.startswith((*lost, f"common_causes.{key}"))} == set()


def test_a_rejected_row_keeps_its_place_and_loses_what_was_measured() -> None:
    result = rotors_of_a_log()
    all_rows, given = (one.quantities["dynamics.time_constant_s"].value for one in (result, result.without_rejected()))

    assert result.accepted
    assert {row["accepted"] for row in given} == {True, False}
    for whole, row in zip(all_rows, given, strict=True):
        assert math.isfinite(whole["time_constant_s"])
        unknown = {"time_constant_s", "std_s", "delay_s"}
        assert row == (whole if row["accepted"] else {**whole, **dict.fromkeys(unknown)})


def test_something_may_stand_instead_of_a_lost_line_and_a_rejection_of_everything_takes_all() -> None:
    lines = (Dependent("W is 150.1", "a.w", instead="rejected"), Dependent("I is 3.1", "a.i"), "10 peaks")
    result = Result(
        command="fit a", method="default", quantities={}, lines=lines, merits={"n": [Dependent(1.5, "a.i")]}
    )

    assert result.summary() == ("W is 150.1", "I is 3.1", "10 peaks")
    assert replace(result, findings=(rejection("a", "no.", "a.w"),)).without_rejected().summary() == (
        "rejected",
        "I is 3.1",
        "10 peaks",
    )
    nothing = replace(result, findings=(rejection("a", "no."),)).without_rejected()
    assert nothing.summary() == ("rejected", "10 peaks")
    assert nothing.quality == {"n": []}


def _without(result: Result, key: str) -> Result:
    return replace(result, findings=(*result.findings, rejection("a-code", "no.", key))).without_rejected()


def _text(result: Result) -> str:
    content = [result.quality, result.common, [one.matrix for one in result.covariances]]
    return json.dumps(plain(content))


def _paths(content: Any, before: str = "") -> Iterator[str]:
    items = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    yield before
    for name, one in items:
        yield from _paths(one, f"{before}.{name}".removeprefix("."))


def _digits_of(quantity: Any) -> Iterator[str]:
    return _digits(json.dumps(plain([quantity.value, quantity.std])))


def _digits(text: str) -> Iterator[str]:
    """Yield the first eight significant digits of each number, without its power of ten."""
    for number in re.findall(r"\d+\.?\d*(?:e[-+]?\d+)?", text):
        yield number.split("e")[0].replace(".", "").strip("0")[:8]


def _states(line: str, own: set[str]) -> bool:
    """Return whether a line states one of the numbers, rounded to four to seven digits."""
    shown = {digits for digits in _digits(line) if len(digits) > 3}
    rounded = {f"{float('0.' + digits):.{places}g}"[2:] for digits in own for places in range(4, 8)}
    return bool(shown & rounded)
