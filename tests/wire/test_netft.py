"""What a Net F/T says of itself over HTTP, the requests that it gets, and its single readings over TCP."""

import re

import pytest

from cfid.wire.netft import (
    READ_FORCES,
    LoadReading,
    Settings,
    active_configuration,
    configuration_query,
    encode_reading,
    rate_query,
    read_reading,
    read_settings,
)

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


OPTIONAL = ["mfgdigver", "cfgnam", "cfgcalsn", "cfgmr", "setbias", "comrdte"]


def page_with(**texts: str) -> str:
    page = PAGE
    for tag, text in texts.items():
        page = re.sub(f"<{tag}>[^<]*</{tag}>", f"<{tag}>{text}</{tag}>", page)
    return page


# Settings


def test_a_page_is_read_tag_by_tag() -> None:
    assert read_settings(PAGE) == READ
    assert (READ.counts_per_n, READ.counts_per_nm, READ.family) == (1e6, 1e6, "netft")
    assert active_configuration(PAGE) == 3


@pytest.mark.parametrize(
    ("tag", "unit", "counts", "per_newton"),
    [
        ("force", "kN", "1e6", 1e3),
        ("force", "lbf", "1e6", 1e6 / 4.448221615),
        ("force", "klbf", "1e6", 1e3 / 4.448221615),
        ("force", "kgf", "1e6", 1e6 / 9.80665),
        *(("torque", unit, counts, 1e6) for unit, counts in (("N-m", "1000000"), ("Nmm", "1000"), ("N-mm", "1000"))),
        ("torque", "kNm", "1e6", 1e3),
        ("torque", "lbf-in", "1e6", 1e6 / 0.112984829),
        ("torque", "lbf-ft", "1e6", 1e6 / 1.355817948),
        ("torque", "kgf-cm", "1e6", 1e6 / 0.0980665),
    ],
)
def test_counts_of_any_unit_become_those_of_newtons_and_metres(
    tag: str, unit: str, counts: str, per_newton: float
) -> None:
    is_force = tag == "force"
    settings = read_settings(page_with(**{f"scfg{tag[0]}u": unit, f"cfgcp{tag[0]}": counts}))
    assert (settings.counts_per_n if is_force else settings.counts_per_nm) == pytest.approx(per_newton, rel=1e-8)


@pytest.mark.parametrize("tag", [*NEEDED, *OPTIONAL])
def test_a_page_without_a_needed_tag_is_refused_by_its_name(tag: str) -> None:
    page = re.sub(f"<{tag}>[^<]*</{tag}>", "", PAGE)
    if tag in OPTIONAL:
        assert read_settings(page).counts_per_n == 1e6
    else:
        with pytest.raises(ValueError, match=f"<{tag}>"):
            read_settings(page)


@pytest.mark.parametrize(
    ("texts", "named"),
    [
        *(
            ({tag: text}, f"<{tag}>")
            for tag in ("cfgcpf", "cfgcpt", "comrdtrate", "comrdtbsiz")
            for text in ("0", "-1", "nan", "inf", "1e400", "", "many", "1,000")
        ),
        *(({tag: "0.5"}, f"<{tag}>") for tag in ("comrdtrate", "comrdtbsiz")),
        ({"cfgcpf": "5e-324", "scfgfu": "lbf"}, "<cfgcpf>"),  # as no load cell has, in any unit
        ({"cfgcpf": "1e308", "scfgfu": "klbf"}, "<cfgcpf>"),
        ({"cfgcpt": "1e308", "scfgtu": "Nmm"}, "<cfgcpt>"),
        ({"scfgfu": "furlong"}, "'furlong'"),
        ({"scfgtu": "N"}, "'N'"),
        ({"scfgfu": ""}, "''"),
    ],
)
def test_what_cannot_be_meant_is_refused_by_its_tag_or_unit(texts: dict[str, str], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        read_settings(page_with(**texts))


def test_requests_are_what_the_boxs_own_pages_send() -> None:
    assert configuration_query(3) == "/netftapi2.xml?index=3"
    assert rate_query(rate_hz=7000, buffer_size=40) == "/comm.cgi?comrdte=1&comrdtrate=7000&comrdtbsiz=40"


# Single readings

ANSWER = bytes.fromhex("1234 8001 0001 FFFF 7FFF 8000 0100 FF00")


def test_a_reading_is_the_upper_half_of_the_status_word_and_six_counts() -> None:
    reading = LoadReading(0x8001, (1, -1, 32767, -32768, 256, -256))
    assert bytes(20) == READ_FORCES
    assert read_reading(ANSWER) == reading
    assert encode_reading(reading) == ANSWER


@pytest.mark.parametrize("data", [b"", ANSWER[:15], ANSWER + b"\x00", b"\x34\x12" + ANSWER[2:], bytes(16)])
def test_anything_else_is_no_reading(data: bytes) -> None:
    with pytest.raises(ValueError):
        read_reading(data)
