"""A report's page runs nothing and loads only the campaign's own figures, whatever others wrote in the campaign."""

import json
import shutil
import subprocess
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from markdown_it import MarkdownIt

from cfid.records.campaign import Campaign, open_campaign
from cfid.records.run import DeviceRecord, Label
from cfid.records.run_writer import create_run
from cfid.report.render import Format, rendered
from tests.lab import new_campaign
from tests.report.fits_by_hand import APPENDIX_A, put, report_of

ATTACKS = (
    "</pre></table></details></title></style><script>alert(1)</script>",
    "[x](javascript:alert(1)) ![x](https://evil.example/pixel.png) <javascript:alert(1)>\n\n[x]: javascript:alert(1)",
    "```\n<img src=x onerror=alert(1)>\n```\n~~~\n\n<svg/onload=alert(1)>\n\n~~~\n`<img src=x onerror=alert(1)>` ```",
    'a {: onclick=alert(1) } {onclick=alert(1)}" onmouseover="alert(1)',
    "| </td><iframe src=javascript:alert(1)> |\r\r\\\\<script>alert(1)</script>\n\n    <script>\n\n# <b onclick=x>",
    "--> <script>alert(1)</script> <!--<?php echo 1 ?><![CDATA[<script>alert(1)</script>]]>",
    "\x1b]0;owned\x07\x9b31m\u202e\u2028<script>{{ mark }} {% include 'report.css' %} {# << mark >> <% raw %> #}",
    r"\end{document}\write18{id}\input{/etc/passwd}^^5cinput{/etc/passwd} 50 % & # $x$ Förster µ",
)
TEXTS_OF_TIME_AND_KIND = {"found", "severity", "quantities", "of"}
TAGS = (
    " a article b body br caption code dd details div dl dt em figure footer h1 h2 h3 h4 head header html i img li "
    "link main meta nav ol p pre section small span strong style sub summary sup table tbody td th thead title tr ul "
)
ATTRIBUTES = " align alt charset class content data-head href http-equiv id lang name rel scope src start style value "


class Page(HTMLParser):
    """The tags, attributes and addresses that a browser would find in a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.attributes: set[str] = set()
        self.addresses: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.tags.add(tag)
        self.attributes |= {name for name, _ in attrs}
        self.addresses += [value or "" for name, value in attrs if name in ("href", "src", "action", "data")]


def harmless(text: str) -> Page:
    """Check that a page contains only text, tables, its own anchors and pictures; return its tags and addresses."""
    page = Page(text)
    assert not [tag for tag in page.tags if f" {tag} " not in TAGS]
    assert not [name for name in page.attributes if f" {name} " not in ATTRIBUTES]
    assert not [address for address in page.addresses if not address.startswith(("#", "data:", "figures/"))]
    return page


def spoilt(content: Any, text: str, key: str = "") -> Any:
    """Return a fit's content with `text` in place of every text, and appended to the keys of its quality."""
    if isinstance(content, dict):
        return {
            (f"{name} {text}" if key == "quality" else name): spoilt(value, text, name)
            for name, value in content.items()
        }
    if key in TEXTS_OF_TIME_AND_KIND:
        return content
    if isinstance(content, list):
        return [spoilt(each, text, key) for each in content]
    return text if isinstance(content, str) else content


@pytest.fixture(scope="module", params=ATTACKS)
def campaign(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """A campaign whose names and notes are all the same text."""
    text: str = request.param
    folder = tmp_path_factory.mktemp("labs") / text.replace("/", "÷").replace("\0", "")
    new_campaign(folder)
    rig = (folder / "rig.toml").read_text().replace('name = "Crazyflie 2.0"', f"name = {json.dumps(text)}", 1)
    (folder / "rig.toml").write_text(f"{rig}\n[lab_book]\noperator = {json.dumps(text)}\n")
    campaign = open_campaign(folder)
    put(campaign, "torque", APPENDIX_A["torque"], sources=["a"], rejected=text)
    put(campaign, "set", {f"payload {text}": APPENDIX_A["tf"]["tf.delay_s"]})
    put(
        campaign, "thrust", APPENDIX_A["thrust"], sources=["b"], lines=("a", "b"), rejected="r", warnings=("w",),
        quality={"rms": "q", "rows": [{"a": "b"}]}, figures=("figures/fit.png",),
    )  # fmt: skip
    for path in campaign.fits_folder.glob("*_thrust.json"):
        path.write_text(json.dumps(spoilt(json.loads(path.read_text()), text)))
    devices = {"encoder": DeviceRecord(file="encoder.csv", columns=("t", "phi"))}
    with create_run(
        campaign.runs_folder, kind=text, label=Label(axis=text, note=text), devices=devices,
        started=datetime(2026, 11, 21, tzinfo=UTC), cfid_version="0",
    ):  # fmt: skip
        pass
    (campaign.fits_folder / "2026-11-21_120000_broken.json").write_text(json.dumps({text: 1, "section": text}))
    return campaign


def page_of(campaign: Campaign, form: Format) -> str:
    return rendered(report_of(campaign), form, campaign.folder)


def test_a_page_rendered_from_markdown_shows_text_alone(campaign: Campaign) -> None:
    source = page_of(campaign, "md")
    renderer = MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"])

    assert "table" in harmless(renderer.render(source)).tags
    assert all(letter.isprintable() or letter == "\n" for letter in source)
    assert all(line.endswith(" |") for line in source.splitlines() if line.startswith("| "))


def test_a_page_of_html_shows_text_alone(campaign: Campaign) -> None:
    page = page_of(campaign, "html")

    assert "table" in harmless(page).tags
    assert all(letter.isprintable() or letter == "\n" for letter in page)


def test_tex_has_no_command_and_no_escape_of_others(campaign: Campaign, tmp_path: Path) -> None:
    sheet = page_of(campaign, "tex")

    assert all(" " <= letter <= "~" or letter == "\n" for letter in sheet)
    assert sheet.count(r"\end{document}") == 1
    assert not any(command in sheet for command in (r"\write18", r"\input", "^^"))
    if shutil.which("pdflatex"):
        (tmp_path / "report.tex").write_text(sheet)
        command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "report.tex"]
        assert subprocess.run(command, cwd=tmp_path, capture_output=True, check=False).returncode == 0


def test_only_figures_of_the_campaign_are_read(tmp_path: Path) -> None:
    """Links and paths to other files are left out, and a campaign that is reached by a link shows its figures."""
    new_campaign(tmp_path / "lab")
    (tmp_path / "link").symlink_to(tmp_path / "lab")
    campaign = open_campaign(tmp_path / "link")
    secret = tmp_path / "secret.png"
    secret.write_bytes(b"secret")
    (tmp_path / "secret.svg").write_bytes(b"secret")
    figures = campaign.folder / "figures"
    figures.mkdir()
    (figures / "link.png").symlink_to(secret)
    (figures / "own.png").write_bytes(b"own")
    (figures / "own.svg").symlink_to(secret)
    (figures / "loop.png").symlink_to(figures / "loop.png")
    named = (
        str(secret), "../secret.png", "figures/../../secret.png", "figures/link.png", "figures/loop.png", "", ".",
        "figures/\0.png", "figures/own.png", "figures/own.svg", f"{'long' * 200}.png", "/dev/zero", "http://x/a.png",
    )  # fmt: skip
    put(campaign, "thrust", APPENDIX_A["thrust"], sources=["a"], figures=named)

    page = harmless(page_of(campaign, "html"))
    pictures = [address for address in page.addresses if address.startswith("data:image")]
    assert pictures == ["data:image/png;base64,b3du"]
    assert "figures/own.png" in report_of(campaign)["experiments"][0]["figures"]
    text = page_of(campaign, "md")
    assert "(<figures/own.png>)" in text
    assert "secret.png>" not in text
