"""Findings: equal findings of several files become one that names the files, and --json gives it in four keys."""

import pytest

from cfid.findings import merged, note, texts, warning
from cfid.records.result import Result

LOST = warning("recording", "40 samples were lost while recording.", "swing.*")


@pytest.mark.parametrize(
    ("files", "start"),
    [
        ("", ""),
        ("a", "a: "),
        ("ab", "a, b: "),
        ("abc", "a and 2 more: "),
        ("abab", "a, b: "),
    ],
)
def test_the_same_finding_of_several_files_is_one_that_names_them(files: str, start: str) -> None:
    findings = [LOST.at(name) for name in files] or [LOST, LOST]

    (found,) = merged(findings)
    assert found.text == f"{start}{LOST.sentence}"
    assert found.where == tuple(dict.fromkeys(files))


def test_findings_that_differ_stay_apart_in_their_order() -> None:
    others = [note(LOST.code, LOST.sentence, "swing.*"), warning(LOST.code, LOST.sentence, "drag.*")]
    findings = [LOST.at("a"), others[0].at("a"), LOST.at("b"), others[1].at("a")]

    assert [one.where for one in merged(findings)] == [("a", "b"), ("a",), ("a",)]
    assert texts(findings, "warning") == (f"a, b: {LOST.sentence}", f"a: {LOST.sentence}")
    assert texts(findings, "note") == (f"a: {LOST.sentence}",)


def test_a_sentence_with_a_colon_is_not_taken_for_the_name_of_a_file() -> None:
    findings = [warning("recording", f"command {command}: no lag fits.") for command in (5000, 9000)]

    assert merged(findings) == tuple(findings)


def test_a_result_has_each_finding_once_also_in_json() -> None:
    result = Result(command="", method="", quantities={}, findings=(LOST.at("a"), LOST.at("b")))

    assert [one.as_json() for one in result.findings] == [
        {"code": "recording", "severity": "warning", "quantities": ("swing.*",), "text": f"a, b: {LOST.sentence}"}
    ]
