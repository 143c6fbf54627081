"""The same content in four formats: each is complete, and numbers are printed to two digits of their uncertainty."""

import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from cfid.quantities.rounding import value_and_std
from cfid.records.campaign import Campaign
from cfid.report.render import Format, rendered
from cfid.report.texts import with_power
from tests.lab import new_campaign
from tests.report.fits_by_hand import APPENDIX_A, put, put_appendix_a, report_of


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """A campaign with everything, but rejected torques from two recordings."""
    campaign = new_campaign(tmp_path_factory.mktemp("campaign"))
    put_appendix_a(campaign)
    for path in campaign.fits_folder.glob("*_torque.json"):
        path.unlink()
    for minutes, source in enumerate(("once", "again")):
        put(campaign, "torque", APPENDIX_A["torque"], sources=[source], minutes=minutes, rejected="too little.")
    return campaign


def text_of(campaign: Campaign, form: Format) -> str:
    return rendered(report_of(campaign), form, campaign.folder)


class Tags(HTMLParser):
    """The tags and addresses of a page, and whether they nest."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.seen: list[str] = []
        self.addresses: list[str] = []
        self.open: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.seen.append(tag)
        self.addresses += [value for name, value in attrs if name in ("href", "src")]
        if tag not in ("meta", "link", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_a_page_loads_nothing_runs_nothing_and_its_links_lead_somewhere(campaign: Campaign) -> None:
    page = text_of(campaign, "html")
    tags, anchors = Tags(page), set(re.findall(r'id="([^"]+)"', page))

    assert tags.open == []
    assert "script" not in tags.seen
    assert "@import" not in page
    assert "url(" not in page
    assert all(address[1:] in anchors or address == "data:," for address in tags.addresses)
    places = [page.index(f'id="{name}"') for name in ("sheet", "experiments", "repeats", "published")]
    assert places == sorted(places)


@pytest.mark.parametrize("form", ["html", "md", "tex"])
def test_every_format_has_the_sheet_the_verdicts_and_the_published_values(campaign: Campaign, form: Format) -> None:
    text = text_of(campaign, form)

    for number in ("16.57", "40.77", "rejected", "too little.", "crazyflow", "RotorPy", "5.965"):
        assert number in text, number
    if form == "html":  # a rejected quantity does not count as known
        entries = [entry for group in report_of(campaign)["sheet"] for entry in group["quantities"]]
        assert f"{len(entries) - 1} of {len(entries)} quantities of the sheet known" in text


def test_json_is_one_object_of_plain_numbers(campaign: Campaign) -> None:
    content = json.loads(text_of(campaign, "json"))

    assert list(content) == [
        "made_by", "format", "about", "summary", "sheet", "experiments", "repeats", "agreements", "published", "runs",
        "unreadable",
    ]  # fmt: skip
    assert content["format"] == 2
    matrix = next(q for group in content["sheet"] for q in group["quantities"] if "inertia.matrix_kg_m2" in q["keys"])
    assert matrix["rows"][0] == {"symbol": "I_xx", "value": 16.571710e-6, "std": 16.571710e-8, "unit": "kg m^2"}
    assert matrix["origin"]["found"] == "2026-11-21T12:00:00+00:00"


def test_an_empty_campaign_has_a_report_too(tmp_path: Path) -> None:
    for form in ("html", "md", "json", "tex"):
        assert "cfid log sine" in text_of(new_campaign(tmp_path), form)


def test_the_tex_sheet_compiles(campaign: Campaign, tmp_path: Path) -> None:
    if shutil.which("pdflatex") is None:
        pytest.skip("needs pdflatex to compile the sheet with")
    (tmp_path / "report.tex").write_text(text_of(campaign, "tex"))
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "report.tex"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, check=False)

    assert ended.returncode == 0, ended.stdout.decode(errors="replace")[-2000:]
    assert (tmp_path / "report.pdf").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("value", "std", "shown"),
    [
        (1.2345, 0.0996, ("1.23", "0.10")),
        (381.75, 9.96, ("382", "10")),
        (1234.5, 123.0, ("1230", "120")),
        (-0.0012, 0.12, ("0.00", "0.12")),
        (1.657e-5, 4.8e-8, ("1.6570e-05", "4.8e-08")),
        (1795287566.25, 0.0012, ("1795287566.2500", "0.0012")),
        (3e8, 2e6, ("3.000e+08", "2.0e+06")),
        (0.02, None, ("0.02", "-")),
        (-0.0, None, ("0", "-")),
        (-1e-9, 36.0, ("0", "36")),
        (None, 1.0, ("-", "-")),
        (float("nan"), 1.0, ("nan", "-")),
    ],
)
def test_values_are_rounded_to_two_digits_of_their_uncertainty(value: Any, std: Any, shown: tuple[str, str]) -> None:
    assert value_and_std(value, std) == shown


@pytest.mark.parametrize(
    ("unit", "power", "shown"),
    [("kg", -3, "g"), ("N(cmd)", -3, "mN(cmd)"), ("kg", 0, "kg"), ("kg m^2", -3, "10⁻³ kg m²"), ("1", -6, "10⁻⁶")],
)
def test_thousandths_of_a_unit_have_its_plain_name(unit: str, power: int, shown: str) -> None:
    assert with_power(unit, power) == shown
