"""Stored fits: each is complete, in a separate file, and can be read back."""

import json
import threading
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from cfid.errors import DataError
from cfid.findings import rejection, warning
from cfid.records.fits import Fit, keep_fit, list_fits
from cfid.records.parameters import Parameter, Section, Source

FIT = Fit(
    name="inertia",
    command="fit inertia",
    section=Section(
        method="default",
        found=datetime(2026, 11, 21, 8, 30, 12, tzinfo=UTC),
        cfid_version="0.1.0",
        accepted=True,
        sources=(Source("runs/a/encoder.csv", "0" * 64),),
        parameters={"inertia.matrix_kg_m2": Parameter(value=np.eye(3), std=0.1 * np.eye(3), unit="kg m^2")},
    ),
    quality={"rms": 0.5, "windows": [[1.0, None]]},
    findings=(warning("a-code", "one", "inertia.*"), rejection("b-code", "two")),
    figures=("figures/inertia.svg",),
)


def without_parameters(fit: Fit) -> Fit:
    return replace(fit, section=replace(fit.section, parameters={}))


def test_a_fit_comes_back_as_it_was_kept(tmp_path: Path) -> None:
    keep_fit(tmp_path / "fits", FIT)
    (found,) = list_fits(tmp_path / "fits")

    assert isinstance(found, Fit)
    assert found.section.parameters["inertia.matrix_kg_m2"].value == np.eye(3).tolist()
    assert without_parameters(found) == without_parameters(FIT)


def test_a_finding_comes_back_with_the_same_text_as_one_sentence(tmp_path: Path) -> None:
    path = keep_fit(tmp_path, replace(FIT, findings=(warning("a-code", "one").at("a.csv"),)))
    (found,) = list_fits(tmp_path)

    assert isinstance(found, Fit)
    assert [one.text for one in found.findings] == ["a.csv: one"]
    assert json.loads(path.read_text())["findings"] == [
        {"code": "a-code", "severity": "warning", "quantities": [], "text": "a.csv: one"}
    ]


def test_two_fits_within_a_second_stay_apart_also_from_two_processes(tmp_path: Path) -> None:
    threads = [threading.Thread(target=keep_fit, args=(tmp_path / "fits", FIT)) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    assert len(list_fits(tmp_path / "fits")) == 8


def test_the_oldest_comes_first_and_one_that_is_broken_is_told(tmp_path: Path) -> None:
    later = replace(FIT, section=replace(FIT.section, found=datetime(2026, 11, 22, tzinfo=UTC)))
    keep_fit(tmp_path, later)
    path = keep_fit(tmp_path, FIT)
    keep_fit(tmp_path, FIT).write_text(path.read_text()[:100])
    first, broken, last = list_fits(tmp_path)

    assert isinstance(first, Fit)
    assert isinstance(broken, DataError)
    assert "invalid: " in str(broken)
    assert isinstance(last, Fit)
    assert last.section.found > first.section.found


def test_a_campaign_without_fits_has_none(tmp_path: Path) -> None:
    assert list_fits(tmp_path / "fits") == []


def test_fits_of_the_same_files_are_one_measurement() -> None:
    again = replace(FIT, section=replace(FIT.section, method="thesis"))

    assert again.hashes == FIT.hashes


def test_a_fit_of_a_file_whose_name_is_no_utf_8_stays_readable(tmp_path: Path) -> None:
    odd = replace(FIT, section=replace(FIT.section, sources=(Source("/x/a\udcff.csv", "0" * 64),)))
    keep_fit(tmp_path, odd)
    (found,) = list_fits(tmp_path)

    assert isinstance(found, Fit)
    assert found.section.sources[0].path == "/x/a?.csv"


def test_a_fit_whose_numbers_were_edited_into_no_matrix_is_told(tmp_path: Path) -> None:
    path = keep_fit(tmp_path, replace(FIT, section=replace(FIT.section, parameters={})))
    content = json.loads(path.read_text())
    content["section"]["parameters"] = {"inertia.matrix_kg_m2": {"value": 1.0, "unit": "kg m^2"}}
    path.write_text(json.dumps(content))
    (broken,) = list_fits(tmp_path)

    assert isinstance(broken, DataError)
    assert "inertia.matrix_kg_m2: should be a matrix of 3 times 3 numbers. Delete it" in str(broken)


def test_a_fit_of_the_first_format_keeps_its_sentences_as_findings(tmp_path: Path) -> None:
    path = keep_fit(tmp_path, FIT)
    content = json.loads(path.read_text())
    del content["format"], content["findings"]
    content["section"]["believed"] = not content["section"].pop("accepted")
    path.write_text(json.dumps(content | {"doubts": ["too wobbly."], "warnings": ["a cable."]}))
    (found,) = list_fits(tmp_path)

    assert isinstance(found, Fit)
    assert [(finding.severity, finding.text) for finding in found.findings] == [
        ("rejection", "too wobbly."),
        ("warning", "a cable."),
    ]
    assert set(found.section.rejected) == {"inertia.matrix_kg_m2"}


@pytest.mark.parametrize("found", ["3", 3.0, True, None, 0, -1, [3]])
def test_a_format_that_is_no_whole_number_above_zero_is_refused_by_name(found: object, tmp_path: Path) -> None:
    path = keep_fit(tmp_path, FIT)
    path.write_text(json.dumps(json.loads(path.read_text()) | {"format": found}))
    (broken,) = list_fits(tmp_path)

    assert str(broken) == f"{path}: format: should be a whole number from 1 to 3."


def test_a_fit_of_a_newer_format_is_refused_by_name(tmp_path: Path) -> None:
    path = keep_fit(tmp_path, FIT)
    path.write_text(path.read_text().replace('"format": 3', '"format": 4'))
    (found,) = list_fits(tmp_path)

    assert isinstance(found, DataError)
    assert "has format 4, written by a newer cfid" in str(found)
