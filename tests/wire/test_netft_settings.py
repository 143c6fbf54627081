"""The page with which a Net F/T describes itself, and the requests that it gets over HTTP."""

import math
import re

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cfid.wire.netft import Settings, active_configuration, configuration_query, rate_query, read_settings

FEW = settings(max_examples=200, deadline=None, derandomize=True)
MANY = settings(FEW, max_examples=100_000, suppress_health_check=list(HealthCheck))

PAGE = """<?xml version="1.0" encoding="UTF-8"?>
<?xml-stylesheet type="text/xsl" href="netft.xsl"?>
<netft>
  <prodname>Net F/T</prodname>
  <mfgdigver>2.0.18</mfgdigver> <mfgdigsn>N00000</mfgdigsn>
  <setcfgsel>3</setcfgsel>
  <setuserfilter>0</setuserfilter>
  <setbias>12;-7;0;3;-1500;99</setbias>
  <runstat>0x00000000</runstat>
  <cfg>
    <cfgnam>rig &amp; arm</cfgnam>
    <cfgcalsn>FT00000</cfgcalsn>
    <cfgcpf>1000000</cfgcpf><cfgcpt>1000000</cfgcpt>
    <cfgmr>130;130;400;10;10;10</cfgmr>
    <cfgtfx>0;0;0;0;0;0</cfgtfx>
    <empty></empty><empty/>
  </cfg>
  <scfgfu>N</scfgfu>
  <scfgtu>
    Nm
  </scfgtu>
  <comrdte>Enabled</comrdte>
  <comrdtrate>7000</comrdtrate>
  <comrdtbsiz>40</comrdtbsiz>
</netft>
"""
READ = Settings(
    product="Net F/T",
    firmware="2.0.18",
    configuration="rig & arm",
    calibration_serial="FT00000",
    counts_per_force=1e6,
    counts_per_torque=1e6,
    force_unit="N",
    torque_unit="Nm",
    ranges=(130, 130, 400, 10, 10, 10),
    bias=(12, -7, 0, 3, -1500, 99),
    rdt_enabled=True,
    rate_hz=7000,
    buffer_size=40,
)
NEEDED = ["prodname", "cfgcpf", "cfgcpt", "scfgfu", "scfgtu", "comrdtrate", "comrdtbsiz"]
VALUES = [
    "",
    "7",
    "-1",
    "nan",
    "inf",
    "1e400",
    "0.5",
    "N",
    "N-m",
    "1;2;3;4;5;6",
    "1;2;3;4;5;inf",
    "5e-324",
    "&lt;",
    "Ω",
    "<",
    "</netft>",
]


def with_text(page: str, tag: str, text: str) -> str:
    return re.sub(f"<{tag}>[^<]*</{tag}>", f"<{tag}>{text}</{tag}>", page)


def page_with(tag: str, text: str) -> str:
    assert len(re.findall(f"<{tag}>[^<]*</{tag}>", PAGE)) == 1
    return with_text(PAGE, tag, text)


def page_without(tag: str) -> str:
    return re.sub(f"<{tag}>[^<]*</{tag}>", "", PAGE)


def check_that_a_page_is_read_or_refused(tags: list[tuple[str, str]]) -> None:
    page = PAGE
    for tag, text in tags:
        page = with_text(page, tag, text)
    try:
        read = read_settings(page)
    except ValueError as error:
        refusal = str(error)
    else:
        check_that_settings_can_be_meant(read)
        return
    assert any(f"<{tag}>" in refusal for tag in NEEDED) or "the unknown unit" in refusal


def check_that_settings_can_be_meant(read: Settings) -> None:
    assert 1e-3 <= read.counts_per_n <= 1e12
    assert 1e-3 <= read.counts_per_nm <= 1e12
    assert all(map(math.isfinite, read.ranges + read.bias))
    assert read.rate_hz >= 1
    assert read.buffer_size >= 1
    assert {len(read.ranges), len(read.bias)} <= {0, 6}


tags_and_texts = st.lists(
    st.tuples(st.sampled_from([*NEEDED, "cfgmr", "setbias", "comrdte"]), st.sampled_from(VALUES)), max_size=4
)


@FEW
@given(tags=tags_and_texts)
def test_any_page_is_read_or_refused_by_a_tags_name(tags: list[tuple[str, str]]) -> None:
    check_that_a_page_is_read_or_refused(tags)


@pytest.mark.slow
@MANY
@given(tags=tags_and_texts)
def test_very_many_pages_are_read_or_refused_by_a_tags_name(tags: list[tuple[str, str]]) -> None:
    check_that_a_page_is_read_or_refused(tags)


def test_a_page_is_read_tag_by_tag() -> None:
    assert read_settings(PAGE) == READ
    assert active_configuration(PAGE) == 3


def test_counts_are_those_of_newtons_and_newton_metres() -> None:
    assert (READ.counts_per_n, READ.counts_per_nm) == (1e6, 1e6)


@pytest.mark.parametrize(
    ("unit", "counts", "counts_per_nm"),
    [
        ("N-m", "1000000", 1e6),
        ("Nmm", "1000", 1e6),
        ("N-mm", "1000", 1e6),
        ("kNm", "1e6", 1e3),
        ("lbf-in", "1000000", 1e6 / 0.112984829),
        ("lbf-ft", "1000000", 1e6 / 1.355817948),
        ("kgf-cm", "1000000", 1e6 / 0.0980665),
    ],
)
def test_torque_counts_of_any_unit_become_those_of_a_newton_metre(unit: str, counts: str, counts_per_nm: float) -> None:
    page = page_with("scfgtu", unit).replace("<cfgcpt>1000000<", f"<cfgcpt>{counts}<")
    assert read_settings(page).counts_per_nm == pytest.approx(counts_per_nm, rel=1e-8)


@pytest.mark.parametrize(
    ("unit", "counts_per_n"),
    [("kN", 1e3), ("lbf", 1e6 / 4.448221615), ("klbf", 1e3 / 4.448221615), ("kgf", 1e6 / 9.80665)],
)
def test_force_counts_of_any_unit_become_those_of_a_newton(unit: str, counts_per_n: float) -> None:
    assert read_settings(page_with("scfgfu", unit)).counts_per_n == pytest.approx(counts_per_n, rel=1e-8)


@pytest.mark.parametrize("tag", NEEDED)
def test_a_page_without_a_needed_tag_is_refused_by_its_name(tag: str) -> None:
    with pytest.raises(ValueError, match=f"<{tag}> is missing"):
        read_settings(page_without(tag))


@pytest.mark.parametrize("tag", ["mfgdigver", "cfgnam", "cfgcalsn", "cfgmr", "setbias", "comrdte"])
def test_a_page_without_what_is_only_told_is_read(tag: str) -> None:
    assert read_settings(page_without(tag)).counts_per_n == 1e6


@pytest.mark.parametrize("tag", ["cfgcpf", "cfgcpt", "comrdtrate", "comrdtbsiz"])
@pytest.mark.parametrize("text", ["0", "-1", "nan", "NaN", "inf", "-inf", "1e400", "", "many", "1,000"])
def test_a_number_that_cannot_be_meant_is_refused_by_its_tags_name(tag: str, text: str) -> None:
    with pytest.raises(ValueError, match=f"<{tag}> is "):
        read_settings(page_with(tag, text))


@pytest.mark.parametrize("tag", ["comrdtrate", "comrdtbsiz"])
def test_a_rate_or_a_size_that_is_no_whole_number_is_refused(tag: str) -> None:
    with pytest.raises(ValueError, match=rf"<{tag}> is 0\.5, not a whole number"):
        read_settings(page_with(tag, "0.5"))


@pytest.mark.parametrize(("tag", "text"), [("scfgfu", "furlong"), ("scfgtu", "N"), ("scfgfu", "")])
def test_an_unknown_unit_is_refused_by_its_name(tag: str, text: str) -> None:
    with pytest.raises(ValueError, match=f"in the unknown unit '{text}'"):
        read_settings(page_with(tag, text))


@pytest.mark.parametrize("text", ["nan", "inf", "1.5", "-1", "", "second"])
def test_a_page_that_does_not_say_the_active_configuration_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="<setcfgsel> is "):
        active_configuration(page_with("setcfgsel", text))
    with pytest.raises(ValueError, match="<setcfgsel> is missing"):
        active_configuration("<html><body>404</body></html>")


@pytest.mark.parametrize("text", ["1,2,3,4,5,6", "1 2 3 4 5 6", "1; 2; 3; 4; 5; 6"])
def test_six_numbers_are_read_with_any_separator(text: str) -> None:
    assert read_settings(page_with("cfgmr", text)).ranges == (1, 2, 3, 4, 5, 6)


@pytest.mark.parametrize("text", ["", "1;2;3", "1;2;3;4;5;x", "1;2;3;4;5;6;7", "1;1;1;1;1;nan", "0;0;0;0;0;1e400"])
@pytest.mark.parametrize("tag", ["setbias", "cfgmr"])
def test_other_than_six_finite_numbers_are_none(tag: str, text: str) -> None:
    read = read_settings(page_with(tag, text))
    assert (read.bias if tag == "setbias" else read.ranges) == ()


@pytest.mark.parametrize(
    ("tag", "text", "unit"),
    [
        ("cfgcpf", "1e-320", "N"),
        ("cfgcpf", "5e-324", "lbf"),
        ("cfgcpf", "1e308", "klbf"),
        ("cfgcpt", "1e308", "Nmm"),
        ("cfgcpt", "5e-324", "lbf-ft"),
    ],
)
def test_counts_per_newton_that_no_load_cell_has_are_refused_in_every_unit(tag: str, text: str, unit: str) -> None:
    page = with_text(page_with(tag, text), "scfgfu" if tag == "cfgcpf" else "scfgtu", unit)
    with pytest.raises(ValueError, match=f"<{tag}> is '{text}', .* as no load cell has"):
        read_settings(page)


@pytest.mark.parametrize(("text", "enabled"), [("Enabled", True), ("1", True), ("Disabled", False), ("0", False)])
def test_a_page_tells_whether_rdt_is_on(text: str, enabled: bool) -> None:
    assert read_settings(page_with("comrdte", text)).rdt_enabled is enabled


@pytest.mark.parametrize(("name", "family"), [("Net F/T", "netft"), ("Ethernet Axia", "axia"), ("AXIA80-M20", "axia")])
def test_the_product_tells_the_family(name: str, family: str) -> None:
    assert read_settings(page_with("prodname", name)).family == family


def test_requests_are_what_the_boxs_own_pages_send() -> None:
    assert configuration_query(3) == "/netftapi2.xml?index=3"
    assert rate_query(rate_hz=7000, buffer_size=40) == "/comm.cgi?comrdte=1&comrdtrate=7000&comrdtbsiz=40"
