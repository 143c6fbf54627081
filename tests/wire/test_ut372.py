"""A UT372's packets in any slicing and with any damage: only whole ones are read; possible misreadings are listed."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfid.wire.ut372 import TachometerReading, Ut372Reader, unpack_report
from tests.wire.pieces import FEW, flipped, sliced, slicings

# The characters of the digits as sigrok's wiki lists them; the eighth segment of a cell is the decimal point after it.
WIKI = {"0": b"7;", "1": b"60", "2": b"5>", "3": b"7<", "4": b"65", "5": b"3=", "6": b"3?", "7": b"70", "8": b"7?"}
WIKI |= {"9": b"7=", " ": b"00"}
POINTED = {"0.": b"?;", "1.": b">0", "2.": b"=>", "3.": b"?<", "4.": b">5", "5.": b";=", "6.": b";?", "7.": b"?0"}
POINTED |= {"8.": b"??", "9.": b"?="}
CELLS = {characters: shown for shown, characters in (WIKI | POINTED).items()}
A_SEGMENT_APART = {"08", "17", "39", "56", "59", "68", "89"}

RPM, COUNT = b"85", b"86"
LIT, HOLD = b"78", b"7<"

# The packet of a real tachometer that the sigrok project shows, https://www.sigrok.org/blog/uni-t-ut372-now-supported
REAL = bytes.fromhex("30 37 30 3f 3c 33 3d 37 3c 36 30 36 35 35 3e 36 30 37 3b 30 30 37 38 38 35 0d 0a")

GOLDEN = [
    (REAL, TachometerReading(1353.7, counted=False, held=False, statistic=False)),
    # 0 | 5 4 3 2 1 | 0 0 0 0 0 | 00 | 01: the number 12345, without a point
    (
        bytes.fromhex("30 333d 3635 373c 353e 3630 373b 373b 373b 373b 373b 3030 3031 0d0a"),
        TachometerReading(12345.0, counted=False, held=False, statistic=False),
    ),
    # 0 | 9 8. 7 6 0 | 9 9 9 9 blank | 04 | 01: 678.9 and HOLD
    (
        bytes.fromhex("30 373d 3f3f 3730 333f 373b 373d 373d 373d 373d 3030 3034 3031 0d0a"),
        TachometerReading(678.9, counted=False, held=True, statistic=False),
    ),
    # 0 | 0 4 blank blank blank | all blank | 78 | 86: 40 turns counted
    (
        bytes.fromhex("30 373b 3635 3030 3030 3030 3030 3030 3030 3030 3030 3738 3836 0d0a"),
        TachometerReading(40.0, counted=True, held=False, statistic=False),
    ),
    # 0 | 0 0. blank blank blank | 1 blank blank blank blank | 00 | 11: 0.0 and MAX
    (
        bytes.fromhex("30 373b 3f3b 3030 3030 3030 3630 3030 3030 3030 3030 3030 3131 0d0a"),
        TachometerReading(0.0, counted=False, held=False, statistic=True),
    ),
    (REAL[:-4] + b"25\r\n", TachometerReading(1353.7, counted=False, held=False, statistic=True)),  # MIN
    (REAL[:-4] + b"45\r\n", TachometerReading(1353.7, counted=False, held=False, statistic=True)),  # AVE
]
PACKETS = [packet for packet, _ in GOLDEN]


def packet(number: str, time: str = "     ", *, state: bytes = LIT, unit: bytes = RPM) -> bytes:
    cells = b"".join(cell for text in (number, time) for cell in reversed(cells_of(text)))
    return b"0" + cells + state + unit + b"\r\n"


def cells_of(text: str) -> list[bytes]:
    return [(WIKI | POINTED)[shown] for shown in re.findall(r"[ \d]\.?", text)]


def shown(cells: bytes) -> list[str]:
    """Return the characters that cells show, the lowest first, read without the table of the tested reader."""
    return [CELLS.get(cells[begin : begin + 2], "?") for begin in range(0, len(cells), 2)]


streams = st.lists(
    st.sampled_from([*PACKETS, b"\r\n", b"\n", b"\r", b"0", REAL[:9], REAL[9:], b"7;" * 30]) | st.binary(max_size=30),
    max_size=10,
).map(b"".join)


@pytest.mark.parametrize(("wire", "reading"), GOLDEN)
def test_a_packet_says_what_the_display_shows(wire: bytes, reading: TachometerReading) -> None:
    reader = Ut372Reader()
    assert reader.feed(wire) == [reading]
    assert reader.rejected == 0


@FEW
@given(stream=streams, sizes=slicings)
def test_any_bytes_are_read_the_same_in_any_slicing_and_each_line_counts(stream: bytes, sizes: list[int]) -> None:
    reader, in_parts = Ut372Reader(), Ut372Reader()
    readings = reader.feed(stream)
    assert [reading for part in sliced(stream, sizes) for reading in in_parts.feed(part)] == readings
    assert reader.rejected == in_parts.rejected == stream.count(b"\n") - len(readings)


@pytest.mark.parametrize(
    "wire",
    [
        REAL[1:],  # a byte was lost
        b"0" + REAL,  # or added
        REAL[:-2] + b"\n",
        packet("1353.7", unit=b"80"),  # neither RPM nor COUNT: the set-up menu
        packet("1353.7", unit=b"83"),  # both
        packet("13.53.7"),
        packet("13 53"),
        packet("1353 "),
        packet("     "),
        packet("13537").replace(b"7<", b"0;"),  # an L
        packet("13537").replace(b"7<", b"80"),  # a point without a digit
        packet("13537", "12345").replace(b"65", b"64"),  # an invalid time
        packet("13537").replace(b"7<", b"7L"),
        REAL.lower().replace(b"?<", b"fc"),
    ],
)
def test_a_packet_in_which_anything_is_wrong_is_rejected(wire: bytes) -> None:
    reader = Ut372Reader()
    assert reader.feed(wire + REAL) == [GOLDEN[0][1]]
    assert reader.rejected == 1


@pytest.mark.parametrize(("wire", "reading"), GOLDEN)
def test_a_flipped_bit_is_found_or_lights_one_segment_of_another_digit_or_a_point(
    wire: bytes, reading: TachometerReading
) -> None:
    misread = 0
    for damaged in flipped(wire):
        for other in Ut372Reader().feed(damaged):
            if other.number != reading.number:
                misread += 1
                pairs = zip(shown(wire[1:11]), shown(damaged[1:11]), strict=True)
                (changed,) = [pair for pair in pairs if pair[0] != pair[1]]
                before, after = (text.rstrip(".") for text in changed)
                assert before == after or "".join(sorted(before + after)) in A_SEGMENT_APART
    assert misread <= 11  # of 216 bits; 7 for the real packet


@pytest.mark.parametrize(
    ("report", "data"),
    [
        ("f0 00 00 00 00 00 00 00", ""),
        ("f1 d1 00 00 00 00 00 00", "d1"),
        ("f2 35 41 00 00 00 00 00", "35 41"),  # the wiki's example
        ("f7 30 37 30 3f 3c 33 3d", "30 37 30 3f 3c 33 3d"),
        ("f1 30 37 30 3f 3c 33 3d", "30"),  # the byte after the stated number of bytes is ignored
        *(
            (wrong, None)
            for wrong in ("", "f1", "f1 30", "f8 30 37 30 3f 3c 33 3d", "01 30 37 30 3f 3c 33 3d", "00" * 9)
        ),
    ],
)
def test_a_report_of_the_bridge_is_as_many_bytes_as_it_says(report: str, data: str | None) -> None:
    assert unpack_report(bytes.fromhex(report)) == (None if data is None else bytes.fromhex(data))
