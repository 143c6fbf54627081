"""parameters.toml: what is stored is read back, and a fit replaces its own section only."""

import json
import math
import tomllib
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfid.errors import ConfigError, DataError
from cfid.records.parameters import Parameter, Section, Source, load_sections, plain, store_section

FOUND = datetime(2026, 11, 21, 8, 30, 12, tzinfo=UTC)


def section(**values: Any) -> Section:
    return Section(
        method="pendulum",
        found=FOUND,
        cfid_version="0.1.0",
        accepted=True,
        sources=(Source("runs/a/encoder.csv", "ab12"), Source("x.csv", "cd34")),
        parameters={name: Parameter(value=value, std=0.5, unit="kg m^2") for name, value in values.items()},
    )


def stored(folder: Path, value: Any, std: Any = None) -> Parameter:
    """Return a parameter after it was written to the disk and read back."""
    file = folder / "parameters.toml"
    one = Section(
        method="m",
        found=FOUND,
        cfid_version="0",
        accepted=False,
        sources=(),
        parameters={"a.b": Parameter(value=value, std=std, unit="N")},
    )
    store_section(file, "fit", one)
    return load_sections(file)["fit"].parameters["a.b"]


def same(one: Any, other: Any) -> bool:
    """Return whether two values are equal, with nan equal to itself."""
    if isinstance(one, float) and isinstance(other, float):
        return one == other or (math.isnan(one) and math.isnan(other))
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    return type(one) is type(other) and bool(one == other)


def test_a_campaign_that_has_found_nothing_has_no_sections(tmp_path: Path) -> None:
    assert load_sections(tmp_path / "parameters.toml") == {}


def test_a_section_is_read_back_as_it_was(tmp_path: Path) -> None:
    file = tmp_path / "parameters.toml"
    whole = section(**{"a.matrix_kg_m2": [[1.0, 2.5], [3e-5, -0.0]], "a.peaks": 12})
    store_section(file, "inertia", whole)
    assert load_sections(file) == {"inertia": whole}
    assert load_sections(file)["inertia"].found.tzinfo is not None


def test_a_later_fit_replaces_its_own_section_only(tmp_path: Path) -> None:
    file = tmp_path / "parameters.toml"
    for name in ("swing", "friction", 'a name. with = [odd] "signs"'):
        store_section(file, name, section(first=1.0))
    before = tomllib.loads(file.read_text())
    store_section(file, "friction", section(second=2.0))
    after = tomllib.loads(file.read_text())
    assert after.keys() == before.keys()
    assert {name: after[name] for name in after if name != "friction"} == {
        name: before[name] for name in before if name != "friction"
    }
    assert list(load_sections(file)["friction"].parameters) == ["second"]


def test_what_another_version_wrote_beside_its_numbers_stays(tmp_path: Path) -> None:
    file = tmp_path / "parameters.toml"
    store_section(file, "swing", section(first=1.0))
    file.write_text(file.read_text().replace('method = "pendulum"', 'method = "pendulum"\nweather = "rain"'))
    store_section(file, "friction", section(second=2.0))
    assert tomllib.loads(file.read_text())["swing"]["weather"] == "rain"


def test_the_same_section_twice_makes_the_same_file(tmp_path: Path) -> None:
    file = tmp_path / "parameters.toml"
    store_section(file, "b", section(x=1.0))
    store_section(file, "a", section(x=np.array([1.0, math.nan])))
    before = file.read_bytes()
    store_section(file, "a", section(x=np.array([1.0, math.nan])))
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    ("value", "read"),
    [
        (None, math.nan),
        (math.nan, math.nan),
        (math.inf, math.inf),
        (-math.inf, -math.inf),
        (np.float64(0.1), 0.1),
        (np.int64(3), 3),
        (np.bool_(True), True),
        (np.array(2.5), 2.5),
        (np.array([[1.0, math.nan], [math.inf, 4.0]]), [[1.0, math.nan], [math.inf, 4.0]]),
        (np.arange(3), [0, 1, 2]),
        (np.empty((0, 3)), []),
        ((1, (2.0, None)), [1, [2.0, math.nan]]),
        ([], []),
        (1e-320, 1e-320),
        (0.1 + 0.2, 0.1 + 0.2),
        (2**70, 2**70),
        (
            [{"cmd": 2000, "thrust_n": np.float64(0.1), "torque_nm": None}],
            [{"cmd": 2000, "thrust_n": 0.1, "torque_nm": math.nan}],
        ),
        (
            [{"name": 'M1 "left"\r\n', "std": [1.0, None]}, {"name": ""}],
            [{"name": 'M1 "left"\r\n', "std": [1.0, math.nan]}, {"name": ""}],
        ),
        ({"x": {"y": (1, 2)}}, {"x": {"y": [1, 2]}}),
    ],
)
def test_a_value_comes_back_from_the_disk(tmp_path: Path, value: Any, read: Any) -> None:
    assert same(stored(tmp_path, value).value, read)
    if not (isinstance(value, float) and value < 0):  # no uncertainty is negative
        assert same(stored(tmp_path, 1.0, std=value).std, None if value is None else read)
    assert stored(tmp_path, value).unit == "N"


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)


def unknown_as_nan(value: Any) -> Any:
    if isinstance(value, list):
        return [unknown_as_nan(item) for item in value]
    if isinstance(value, dict):
        return {key: unknown_as_nan(item) for key, item in value.items()}
    return math.nan if value is None else value


@given(value=VALUES)
def test_any_value_comes_back_from_the_disk(tmp_path_factory: pytest.TempPathFactory, value: Any) -> None:
    assert same(stored(tmp_path_factory.mktemp("value"), value).value, unknown_as_nan(value))


@given(value=VALUES)
def test_json_has_null_for_what_is_not_finite(value: Any) -> None:
    parameter = Parameter(value=value, std=[value], unit="N").as_json()
    text = json.dumps(parameter, allow_nan=False)
    assert json.loads(text) == plain(parameter)


def test_json_is_the_same_before_and_after_the_disk(tmp_path: Path) -> None:
    value = [{"cmd": 1, "std": None}, {"cmd": np.float64(2), "std": math.inf}]
    assert stored(tmp_path, value).as_json()["value"] == Parameter(value=value).as_json()["value"]


def test_a_time_keeps_its_zone(tmp_path: Path) -> None:
    east = FOUND.astimezone(timezone(timedelta(hours=5, minutes=30)))
    file = tmp_path / "parameters.toml"
    store_section(file, "fit", Section(**(vars(section(x=1.0)) | {"found": east})))
    assert load_sections(file)["fit"].found == FOUND


def test_a_source_whose_name_is_no_utf_8_can_be_stored(tmp_path: Path) -> None:
    file = tmp_path / "parameters.toml"
    store_section(file, "fit", Section(**(vars(section(x=1.0)) | {"sources": (Source("a\udcff.csv", "ab"),)})))
    assert load_sections(file)["fit"].sources == (Source("a?.csv", "ab"),)


GOOD = """
[swing]
method = "pendulum"
found = 2026-11-21T08:30:12Z
cfid_version = "0.1.0"
believed = true
sources = [{ path = "x.csv", sha256 = "ab" }]
[swing.parameters."swing.x"]
value = 1.0
unit = "N"
"""


def test_a_file_written_by_hand_is_read(tmp_path: Path) -> None:
    file = tmp_path / "parameters.toml"
    file.write_bytes(b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode())
    assert load_sections(file)["swing"].parameters == {"swing.x": Parameter(value=1.0, unit="N")}


def test_a_section_that_an_older_version_did_not_believe_is_rejected_whole(tmp_path: Path) -> None:
    file = tmp_path / "parameters.toml"
    file.write_text(GOOD.replace("believed = true", "believed = false"))
    found = load_sections(file)["swing"]

    assert not found.accepted
    assert set(found.rejected) == {"swing.x"}


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("[swing]", "swing", "invalid TOML"),
        ("[swing]", "x = 1\n[swing]", "invalid: x: should be a table, not 1."),
        ('method = "pendulum"\n', "", "swing.method is missing."),
        ('method = "pendulum"', "method = 3", "swing.method: should be a valid string, not 3."),
        ("2026-11-21T08:30:12Z", '"yesterday"', "swing.found: should be a valid datetime"),
        ("true", '"perhaps"', "swing.accepted: should be a valid boolean"),
        ('[{ path = "x.csv", sha256 = "ab" }]', '"x.csv"', "swing.sources: should be a valid list, not 'x.csv'."),
        (', sha256 = "ab"', "", "swing.sources.0.sha256 is missing."),
        ("value = 1.0\n", "", "swing.parameters.swing.x.value is missing."),
        ('unit = "N"', "unit = 7", "swing.parameters.swing.x.unit: should be a valid string, not 7."),
        ('[swing.parameters."swing.x"]', "[swing.parameters]", "swing.parameters.value: should be a table, not 1.0."),
    ],
)
def test_a_damaged_file_is_refused_by_key_and_not_written_over(
    tmp_path: Path, old: str, new: str, expected: str
) -> None:
    file = tmp_path / "parameters.toml"
    assert old in GOOD
    file.write_text(GOOD.replace(old, new, 1))
    before = file.read_bytes()
    for act in (lambda: load_sections(file), lambda: store_section(file, "friction", section(x=1.0))):
        with pytest.raises(DataError) as caught:
            act()
        assert str(caught.value).startswith(f"{file}: ")
        assert expected in str(caught.value)
    assert file.read_bytes() == before


@given(at=st.integers(0, len(GOOD) - 1), junk=st.binary(max_size=3), length=st.integers(0, 40))
def test_a_file_damaged_anywhere_is_read_or_refused_with_its_name(
    tmp_path_factory: pytest.TempPathFactory, at: int, junk: bytes, length: int
) -> None:
    file = tmp_path_factory.mktemp("damaged") / "parameters.toml"
    content = GOOD.encode()
    file.write_bytes(content[:at] + junk + content[at + length :])
    try:
        sections = load_sections(file)
    except DataError as error:
        message = str(error)
    else:
        message = f"{file}: "
        assert all(isinstance(found.accepted, bool) for found in sections.values())
    assert message.startswith(f"{file}: ")


def test_a_place_that_cannot_be_written_or_read_is_said(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"parameters\.toml: cannot be written: No such file or directory"):
        store_section(tmp_path / "nowhere" / "parameters.toml", "fit", section(x=1.0))
    (tmp_path / "parameters.toml").mkdir()
    with pytest.raises(DataError, match=r"parameters\.toml: cannot be read: Is a directory"):
        load_sections(tmp_path / "parameters.toml")
    with pytest.raises(DataError, match="Is a directory"):
        store_section(tmp_path / "parameters.toml", "fit", section(x=1.0))


def test_no_temporary_file_is_left(tmp_path: Path) -> None:
    store_section(tmp_path / "parameters.toml", "fit", section(x=1.0))
    with pytest.raises(TypeError):
        store_section(tmp_path / "parameters.toml", "fit", section(x=object()))
    assert [path.name for path in tmp_path.iterdir()] == ["parameters.toml"]


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("inertia.matrix_kg_m2", [1e-5, 2e-5, 3e-5], "should be a matrix of 3 times 3 numbers"),
        ("motor.thrust_poly", 1.0, "should be a list of coefficients"),
        ("motor.speed_poly", ["x"], "should be made of numbers"),
        ("motor.max_thrust_n", [0.15], "should be a number"),
        ("motor.torque_poly", [{"cmd": 1.0}], "should be made of numbers"),
        ("motor.table", 1.0, "should be a list of rows"),
        ("motor.table", [{"thrust_n": 0.1}], "should have a number cmd in each row"),
        ("dynamics.rising", [1.0], "should be a list of 2 numbers"),
    ],
)
def test_a_value_that_a_calculation_cannot_take_is_refused_by_its_key(
    tmp_path: Path, key: str, value: Any, expected: str
) -> None:
    file = tmp_path / "parameters.toml"
    one = replace(section(), parameters={key: Parameter(value=value)})
    store_section(file, "fit", one)

    with pytest.raises(DataError) as caught:
        load_sections(file)
    assert f"parameters.toml: invalid: fit.parameters.{key}: {expected}." in str(caught.value)


def test_a_deviation_of_another_shape_is_refused_where_a_calculation_takes_it_and_else_left_out(tmp_path: Path) -> None:
    file = tmp_path / "parameters.toml"
    poly = Parameter(value=[1.0, 2.0], std=[1.0])
    store_section(file, "fit", replace(section(), parameters={"motor.speed_poly": poly}))
    with pytest.raises(DataError, match="its std should have the same shape"):
        load_sections(file)

    named = [(one.name, one.value, one.std) for one in Parameter(value=[1.0, 2.0], std=0.5).numbers("a")]
    assert named == [("a [0]", 1.0, None), ("a [1]", 2.0, None)]


def test_a_time_without_a_zone_is_refused_for_it_has_no_place_among_others(tmp_path: Path) -> None:
    file = tmp_path / "parameters.toml"
    store_section(file, "fit", replace(section(), found=FOUND.replace(tzinfo=None)))

    with pytest.raises(DataError, match=r"fit\.found: should have a time zone\."):
        load_sections(file)


def test_a_value_in_another_unit_than_its_quantity_has_is_refused(tmp_path: Path) -> None:
    """Previously, the quantity's own unit was assumed: 146 g cm^2 went into a prediction as 146 kg m^2."""
    file = tmp_path / "parameters.toml"
    one = {"flight.inertia_kg_m2.roll": Parameter(value=146.06, std=1.0, unit="g cm^2")}
    store_section(file, "flight", replace(section(), parameters=one))
    with pytest.raises(DataError, match=r"its unit is 'g cm\^2', and has to be 'kg m\^2'"):
        load_sections(file)
