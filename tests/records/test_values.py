"""The rule for a campaign's values: of all kept fits of a quantity, the accepted, current and most certain one."""

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from cfid.experiments import EXPERIMENTS
from cfid.records.campaign import open_campaign
from cfid.records.fits import Fit, withdraw
from cfid.records.parameters import Parameter, Section, Source
from cfid.records.parameters_file import is_as_written, text_of
from cfid.records.rig_file import thesis_rig
from cfid.records.stale import stale_in
from cfid.records.values import Values, judging_weights, part_of
from tests.lab import keep, new_campaign

MOST, HELD, POLY, CUBIC = (
    "motor.max_thrust_n", "motor.hover_mass_kg", "motor.thrust_poly", "motor.thrust_voltage_poly",
)  # fmt: skip


def fit(
    number: int, stds: Mapping[str, Any], *, runs: str = "", name: str = "thrust",
    rejected: Mapping[str, str] | None = None, revision: int = 1, **changed: Any,
) -> Fit:  # fmt: skip
    """Return a fit of runs named by letters, whose values are its number and whose standard uncertainties are given."""
    section = Section(
        method="default", found=datetime(2026, 1, 30 - number, tzinfo=UTC), cfid_version="0", accepted=not rejected,
        sources=tuple(Source(f"runs/{run}/data.csv", run * 64) for run in runs),
        parameters={key: Parameter(value=_like(std, number), std=std) for key, std in stds.items()},
        rejected=rejected or {},
    )  # fmt: skip
    return Fit(
        name=name, command=f"fit {name}", section=replace(section, **changed), quality={}, number=number,
        stem=f"{number:04d}_{name}", revision=revision,
    )  # fmt: skip


def _like(std: Any, number: int) -> Any:
    return [float(number)] * len(std) if isinstance(std, list) else float(number)


def values(*fits: Fit, stale: tuple[int, ...] = ()) -> Values:
    ages = {each.section.found for each in fits if each.number in stale}
    return Values(fits, thesis_rig(), lambda section: ("Changed: fit again.",) if section.found in ages else ())


def taken(found: Values, key: str = MOST) -> int:
    quantity = found.find(key)
    assert quantity is not None
    return quantity.fit.number


def why(found: Values, number: int, key: str = MOST) -> str:
    return next(each.why for each in found.candidates(key) if each.fit.number == number)


GOOD, POOR = {MOST: 0.01, HELD: 0.01}, {MOST: 0.5, HELD: 0.5}


def test_the_most_certain_fit_counts_whatever_came_later() -> None:
    assert taken(values(fit(1, GOOD, runs="a"), fit(2, POOR, runs="b"))) == 1
    assert taken(values(fit(1, POOR, runs="a"), fit(2, GOOD, runs="b"))) == 2


@pytest.mark.parametrize(("runs", "number"), [("a", 2), ("ab", 2), ("b", 1), ("", 1)])
def test_a_later_fit_of_the_same_or_more_runs_replaces_an_earlier_one_that_was_more_certain(
    runs: str, number: int
) -> None:
    assert taken(values(fit(1, GOOD, runs="a"), fit(2, POOR, runs=runs))) == number


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"rejected": {MOST: "it scatters."}}, "rejected: it scatters."),
        ({"method": "thesis"}, "the thesis' method"),
        ({"revision": EXPERIMENTS["thrust"].revision + 1}, "another revision"),
    ],
)
def test_a_fit_that_is_rejected_of_the_thesis_or_of_another_revision_counts_only_where_it_is_alone(
    changed: dict[str, Any], reason: str
) -> None:
    other = fit(2, GOOD, runs="ab", **changed)
    both = values(fit(1, POOR, runs="a"), other)

    assert taken(both) == 1
    assert reason in why(both, 2)
    assert taken(values(other)) == 2


def test_a_fit_without_standard_uncertainties_counts_only_where_it_is_alone() -> None:
    unknown = fit(2, {MOST: None, HELD: None}, runs="ab")

    assert taken(values(fit(1, POOR, runs="a"), unknown)) == 1
    assert taken(values(unknown)) == 2


def test_a_fit_whose_runs_changed_gives_way_to_the_next_best_and_is_marked_where_it_is_alone() -> None:
    fits = fit(1, GOOD, runs="a"), fit(2, POOR, runs="b")

    assert taken(values(*fits, stale=(1,))) == 2
    alone = values(fits[0], stale=(1,)).find(MOST)
    assert alone is not None
    assert alone.outdated == ("Changed: fit again.",)


def test_a_rejected_value_stays_marked_where_no_accepted_one_is_known_and_marks_no_accepted_one() -> None:
    forced = fit(2, GOOD, runs="b", rejected={MOST: "it scatters."})
    alone, both = values(forced).find(MOST), values(fit(1, POOR, runs="a"), forced).find(MOST)

    assert alone is not None
    assert both is not None
    assert (alone.accepted, alone.rejection, both.accepted) == (False, "it scatters.", True)


def test_what_a_later_fit_of_the_same_runs_rejected_is_rejected_in_the_earlier_one_too() -> None:
    cubic = [0.1, 0.1, 0.1, 0.1]
    first = fit(1, {**GOOD, CUBIC: cubic}, runs="a")
    second = fit(2, GOOD, runs="a", accepted=True, rejected={CUBIC: "it folds."})
    quantity = values(first, second).find(CUBIC)

    assert quantity is not None
    assert (quantity.fit.number, quantity.rejection) == (1, "it folds.")


def test_what_one_fit_gives_jointly_comes_from_one_fit_by_its_worst_number_over_its_aim() -> None:
    """The first has the better maximum; its hover mass is 10 times its aim."""
    first = fit(1, {POLY: [0.1, 0.1], MOST: 0.001, HELD: 0.2}, runs="a")
    second = fit(2, {POLY: [0.1, 0.1], MOST: 0.06, HELD: 0.04}, runs="b")
    found = values(first, second)

    assert {taken(found, key) for key in (POLY, MOST, HELD)} == {2}
    ratios = {each.fit.number: each.over_aim for each in found.candidates(MOST)}
    assert ratios == {1: pytest.approx(0.2 / 0.02), 2: pytest.approx(0.06 / 2 / 0.03)}


def test_a_poorer_map_may_give_what_the_better_one_lacks_but_nothing_that_belongs_to_the_map() -> None:
    found = values(fit(1, GOOD, runs="a"), fit(2, {**POOR, POLY: [0.1, 0.1], CUBIC: [0.1] * 4}, runs="b"))

    assert (taken(found), taken(found, CUBIC)) == (1, 2)
    assert found.find(POLY) is None
    assert "0001_thrust is more certain, and gives this jointly with others" in why(found, 2, POLY)
    assert set(found.sections()) == {"thrust", "thrust (2)"}


def test_swings_about_two_axes_are_two_quantities() -> None:
    key = "swing.axis_inertia_kg_m2"
    found = values(fit(1, {key: 0.1}, runs="a", name="swing x"), fit(2, {key: 0.1}, runs="b", name="swing y"))

    assert {name: section.parameters[key].value for name, section in found.sections().items()} == {
        "swing x": 1.0, "swing y": 2.0,
    }  # fmt: skip


def test_a_value_set_by_hand_counts_before_fits_and_the_last_one_before_others() -> None:
    by_hand = [fit(number, {MOST: 0.9}, name="set") for number in (2, 3)]
    found = values(fit(1, GOOD, runs="a"), *by_hand)

    assert (taken(found), taken(found, HELD)) == (3, 1)
    assert why(found, 1) == "0003_set was set by hand"


def test_fits_are_ordered_by_the_counter_and_not_by_the_clock() -> None:
    """The clock was set back: each later fit has an earlier time."""
    assert taken(values(fit(2, GOOD, runs="a"), fit(1, POOR, runs="a"))) == 2


def test_a_polynomial_is_judged_where_it_is_used() -> None:
    assert judging_weights("motor.speed_poly", 2, thesis_rig()) == [30000.0, 1.0]
    assert judging_weights("motor.thrust_voltage_poly", 4, thesis_rig()) == [1.0, 3.0, 9.0, 27.0]
    slope = judging_weights("motor.torque_poly", 2, thesis_rig())
    assert slope == [1.0, 0.0]
    assert judging_weights("inertia.matrix_kg_m2", 6, thesis_rig()) is None


def test_a_part_of_a_fit_keeps_the_covariance_of_what_is_left() -> None:
    whole = replace(
        fit(1, {"a": [1.0, 1.0], "b": 1.0}).section,
        covariance=(_covariance(("a", "b"), ((1.0, 0.2, 0.3), (0.2, 1.0, 0.4), (0.3, 0.4, 1.0))),),
        common={"gain": {"b": [0.1]}, "arm": {"a": [0.1, 0.2]}},
    )
    part = part_of(whole, ["a"])

    assert [(block.of, block.matrix) for block in part.covariance] == [(("a",), ((1.0, 0.2), (0.2, 1.0)))]
    assert part.common == {"arm": {"a": [0.1, 0.2]}}


def _covariance(of: tuple[str, ...], matrix: tuple[tuple[float, ...], ...]) -> Any:
    from cfid.records.covariances import Covariance

    return Covariance(of, matrix)


# parameters.toml


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    new_campaign(tmp_path)
    keep(tmp_path, "thrust", fit(1, {**GOOD, POLY: [0.1, 0.1]}, runs="a").section)
    open_campaign(tmp_path).write_parameters()
    return tmp_path


def test_a_torn_or_edited_parameters_file_changes_no_number_and_is_written_anew(folder: Path) -> None:
    path, before = folder / "parameters.toml", open_campaign(folder).values().find(MOST)
    whole = path.read_text()
    assert before is not None
    for text in (*(whole[:size] for size in range(1, len(whole), 37)), whole.replace("1.0", "2.0"), "# \x00"):
        path.write_text(text)
        found = open_campaign(folder).values().find(MOST)
        assert found is not None
        assert found.parameter == before.parameter
        assert not is_as_written(text)
        assert open_campaign(folder).write_parameters()
        assert path.read_text() == whole
        assert text in {kept.read_text() for kept in folder.glob("parameters.*.toml")}
    assert not open_campaign(folder).write_parameters()


def test_the_numbers_of_an_earlier_version_are_kept_beside_the_file(folder: Path) -> None:
    path = folder / "parameters.toml"
    earlier = "# mine\nformat = 2\n[set.parameters.arm_m]\nvalue = 0.05\n"
    path.write_text(earlier)
    was = open_campaign(folder).write_parameters()

    assert "arm_m" in was  # which no fit gives
    assert [each.read_text() for each in folder.glob("parameters.*.toml")] == [earlier]
    assert is_as_written(path.read_text())


def test_names_and_reasons_with_any_signs_make_a_file_of_valid_toml(tmp_path: Path) -> None:
    new_campaign(tmp_path, ('name = "', 'name = "\\u001b\\u000a[x]\\u007f'))
    evil = "\x1b]0;\r\n[x]\x7f\ud800"
    keep(tmp_path, "thrust", fit(1, {**GOOD, POLY: [0.1, None]}, rejected={MOST: evil}).section)
    open_campaign(tmp_path).write_parameters()

    content = tomllib.loads((tmp_path / "parameters.toml").read_text())
    assert set(content) == {"format", "rig", "thrust"}
    assert content["thrust"][MOST]["rejected"].startswith("\x1b]0;\r\n[x]\x7f")


def test_a_withdrawn_fit_brings_the_next_best_back(folder: Path) -> None:
    better = keep(folder, "thrust", fit(2, {MOST: 0.001, HELD: 0.001}, runs="b").section)
    assert taken(open_campaign(folder).values()) == 2
    withdraw(folder / "fits", better)
    assert taken(open_campaign(folder).values()) == 1


def test_values_of_a_simulated_rig_are_marked_in_the_file_for_people() -> None:
    found = values(fit(1, GOOD, runs="a"), fit(2, {CUBIC: [0.1] * 4}, runs="b", simulated=True))
    text = text_of(found, name="lab", version="0")

    heads = [line for line in text.splitlines() if "cfid fit" in line]
    assert [head.endswith(", SIMULATED") for head in heads] == [False, True]


def test_a_fit_of_another_axis_takes_no_value_of_the_first_away() -> None:
    x, z = "testbody.measured_kg_m2.x", "testbody.measured_kg_m2.z"
    found = values(fit(1, {x: 0.1, z: 0.1}, runs="ab", name="testbody"), fit(2, {z: 0.01}, runs="b", name="testbody"))

    assert (taken(found, x), taken(found, z)) == (1, 1)
    alone = values(fit(1, {x: 0.1}, runs="a", name="testbody"), fit(2, {z: 0.01}, runs="b", name="testbody"))
    assert (taken(alone, x), taken(alone, z)) == (1, 2)
    assert {quantity.key for quantity in alone} == {x, z}


def test_a_forced_fit_hides_no_accepted_value_behind_a_rejected_one() -> None:
    drag, rising = "flight.drag_kg_per_rad", "flight.rising_s"
    forced = fit(2, {drag: 0.01, rising: 0.01}, runs="b", name="flight", rejected={rising: "no step"})
    found = values(fit(1, {drag: 0.1, rising: 0.1}, runs="a", name="flight"), forced)

    assert taken(found, rising) == 1


def test_a_run_whose_run_toml_is_torn_makes_its_fit_outdated(folder: Path) -> None:
    """It may exclude the run."""
    run = folder / "runs" / "torn"
    run.mkdir(parents=True)
    (run / "run.toml").write_text("kind = ")
    section = replace(fit(1, GOOD).section, runs={"torn": "0" * 64})

    assert stale_in(folder, [], thesis_rig())(section)
    (run / "run.toml").unlink()
    assert not stale_in(folder, [], thesis_rig())(section)
