"""The same content in four formats: each is complete, and each is safe whatever a name contains."""

import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from cfid.records.campaign import Campaign, find_campaign
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import new_rig_text
from cfid.report.formats.numbers import with_power
from cfid.report.formats.render import Format, rendered
from tests.report.fits_by_hand import APPENDIX_A, new_campaign, put, put_appendix_a, report_of

HOSTILE = r"""<script>alert("1")</script> | 50 % _of_ {$x} & \end{document} ~^# Förster µ"""


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    campaign = new_campaign(tmp_path)
    put_appendix_a(campaign)
    for path in campaign.fits_folder.glob("*_torque.json"):
        path.unlink()
    put(campaign, "torque", APPENDIX_A["torque"], sources=["once"], rejected="too little.")
    put(campaign, "torque", APPENDIX_A["torque"], sources=["again"], minutes=1, rejected="too little.")
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


def test_a_page_loads_nothing_and_runs_nothing(campaign: Campaign) -> None:
    page = text_of(campaign, "html")
    tags = Tags(page)

    assert tags.open == []
    assert "script" not in tags.seen
    assert "@import" not in page
    assert "url(" not in page
    assert all(address.startswith(("#", "data:")) for address in tags.addresses)


def test_every_link_of_a_page_leads_somewhere(campaign: Campaign) -> None:
    page = text_of(campaign, "html")
    anchors = set(re.findall(r'id="([^"]+)"', page))

    assert {address[1:] for address in Tags(page).addresses if address.startswith("#")} <= anchors


@pytest.mark.parametrize("form", ["html", "md", "tex"])
def test_every_format_has_the_sheet_the_verdicts_and_the_published_values(campaign: Campaign, form: Format) -> None:
    text = text_of(campaign, form)

    for number in ("16.57", "40.77", "rejected", "too little.", "crazyflow", "RotorPy"):
        assert number in text, number


def test_the_sheet_comes_first(campaign: Campaign) -> None:
    page = text_of(campaign, "html")
    order = [page.index(f'id="{name}"') for name in ("sheet", "experiments", "repeats", "published")]

    assert order == sorted(order)


def test_a_rejected_quantity_is_not_counted_as_known(
    campaign: Campaign, tmp_path_factory: pytest.TempPathFactory
) -> None:
    def known(of: Campaign) -> int:
        found = re.search(r"(\d+) of \d+ quantities known", text_of(of, "html"))
        assert found is not None
        return int(found[1])

    accepted = new_campaign(tmp_path_factory.mktemp("accepted"))
    put_appendix_a(accepted)

    assert known(campaign) == known(accepted) - 1
    assert '<span class="chip bad">1 rejected</span>' in text_of(campaign, "html")


def test_json_is_one_object_of_plain_numbers(campaign: Campaign) -> None:
    content = json.loads(text_of(campaign, "json"))

    assert list(content) == [
        "made_by", "format", "about", "summary", "sheet", "experiments", "repeats", "agreements", "comparisons", "runs",
        "unreadable",
    ]  # fmt: skip
    assert content["format"] == 1
    matrix = next(q for group in content["sheet"] for q in group["quantities"] if "inertia.matrix_kg_m2" in q["keys"])
    assert matrix["rows"][0] == {"symbol": "I_xx", "value": 16.571710e-6, "std": 16.571710e-8, "unit": "kg m^2"}
    assert matrix["origin"]["found"] == "2026-11-21T12:00:00+00:00"


def test_an_empty_campaign_has_a_report_too(tmp_path: Path) -> None:
    campaign = new_campaign(tmp_path)
    for form in ("html", "md", "json", "tex"):
        assert "cfid log sine" in text_of(campaign, form)


@pytest.fixture
def hostile(tmp_path: Path) -> Campaign:
    text = new_rig_text().replace('name = "Crazyflie 2.0"', f"name = '''{HOSTILE}'''", 1)
    (tmp_path / RIG_FILE).write_text(text)
    campaign = find_campaign(tmp_path, start=tmp_path)
    assert campaign is not None
    more: dict[str, Any] = {
        "warnings": (HOSTILE,),
        "rejected": HOSTILE,
        "lines": (HOSTILE,),
        "quality": {HOSTILE: HOSTILE},
    }
    put(campaign, "thrust", APPENDIX_A["thrust"], sources=["a"], **more)
    return campaign


def test_names_are_text_in_a_page(hostile: Campaign) -> None:
    page = text_of(hostile, "html")

    assert "script" not in Tags(page).seen
    assert page.count("&lt;script&gt;") >= 5


def test_names_break_no_table_of_markdown(hostile: Campaign) -> None:
    for line in text_of(hostile, "md").splitlines():
        if line.startswith("| "):
            assert line.endswith(" |")
            assert "<script" not in re.sub(r"\\.", "", line)


@pytest.mark.parametrize("kind", ["campaign", "hostile"])
def test_the_tex_sheet_compiles(kind: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    if shutil.which("pdflatex") is None:
        pytest.skip("needs pdflatex to compile the sheet with")
    (tmp_path / "report.tex").write_text(text_of(request.getfixturevalue(kind), "tex"))
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "report.tex"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, check=False)

    assert ended.returncode == 0, ended.stdout.decode(errors="replace")[-2000:]
    assert (tmp_path / "report.pdf").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("unit", "power", "shown"),
    [
        ("kg", -3, "g"),
        ("s", -3, "ms"),
        ("m", -3, "mm"),
        ("N(cmd)", -3, "mN(cmd)"),
        ("kg", 0, "kg"),
        ("kg m^2", -6, "10⁻⁶ kg m²"),
        ("kg m^2", -3, "10⁻³ kg m²"),
    ],
)
def test_thousandths_of_a_unit_have_its_plain_name(unit: str, power: int, shown: str) -> None:
    assert with_power(unit, power) == shown
