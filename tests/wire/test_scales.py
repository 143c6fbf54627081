"""Lines of scales in any slicing and with any damage: only a whole line of a known form is a weight."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfid.wire.scales import ScalesReader, Weight, read_weight
from tests.wire.pieces import FEW, flipped, sliced, slicings

LINES = [
    # as manuals show them: A&D, Kern, Tiger, Salter Brecknell; MT-SICS reference manual
    (b"ST,GS,+0001.23 kg", Weight(1230.0, True)),
    (b"US,NT,-  12.3 g", Weight(-12.3, False)),
    (b"ST,+00012.34  g", Weight(12.34, True)),
    (b"ST,NT,  0.876,kg", Weight(876.0, True)),
    (b"US,GS,+01234.56  lb", Weight(1234.56 * 453.59237, False)),
    (b"S S     100.00 g", Weight(100.0, True)),
    (b"S D      -0.05 g", Weight(-0.05, False)),
    (b"S S          3 mg", Weight(0.003, True)),
    (b"  12.34 g  ", Weight(12.34, None)),
    (b"+1.5kg", Weight(1500.0, None)),
    (b"- .5 oz", Weight(-14.174761562, None)),
    (b"12. G", Weight(12.0, None)),
]
NO_WEIGHTS = [
    *(b"", b" ", b"g", b"12.34", b"12,34 g", b"1.2.3 g", b"--1 g", b"1 2 g", b"1e3 g", b"nan g", b"12 gg", b"12 ozt"),
    *(b"12 PC", b"12 N", b"12 %", b"OL,GS,+", b"OL,+999999.9 g", b"QT,+00012345 PC", b"ST,TR,+0001.23 kg"),
    *(b"ST,GS,+0001.23", b"XX,GS,+0001.23 kg", b"T,GS,+0001.23 kg", b"S I", b"S +", b"S -", b"S X 1 g", b"SS 1 g"),
    *(b"S  S 1 g", b"ES", b"H 1 g", "１２ g".encode(), b"12\xff g", b"1234567890 g"),
]

HEADED = [line for line, weight in LINES if weight.stable is not None]
ENDS = (b"\r", b"\n", b"\r\n")

pieces = st.sampled_from([line for line, _ in LINES] + NO_WEIGHTS + [*ENDS, b"7" * 70, b" " * 70])
streams = st.lists(pieces | st.binary(max_size=3), max_size=12).map(b"".join)


@pytest.mark.parametrize(("line", "weight"), LINES)
def test_a_line_says_grams_and_whether_they_are_stable(line: bytes, weight: Weight) -> None:
    found = read_weight(line)
    assert found is not None
    assert found.grams == pytest.approx(weight.grams, rel=1e-9)
    assert found.stable is weight.stable


@pytest.mark.parametrize("line", NO_WEIGHTS)
def test_a_line_of_no_known_form_is_no_weight(line: bytes) -> None:
    assert read_weight(line) is None


@FEW
@given(stream=streams, sizes=slicings)
def test_any_bytes_are_read_the_same_in_any_slicing(stream: bytes, sizes: list[int]) -> None:
    at_once, in_parts = ScalesReader(), ScalesReader()
    weights = at_once.feed(stream)
    assert [weight for part in sliced(stream, sizes) for weight in in_parts.feed(part)] == weights
    assert in_parts.rejected == at_once.rejected
    lines = [line for line in stream.replace(b"\r", b"\n").split(b"\n")[:-1] if line]
    assert len(weights) + at_once.rejected == len(lines)
    assert set(weights) <= {read_weight(line) for line in lines}


@pytest.mark.parametrize(("line", "weight"), LINES)
@pytest.mark.parametrize("end", ENDS)
def test_a_first_line_whose_beginning_was_missed_is_never_another_weight(
    line: bytes, weight: Weight, end: bytes
) -> None:
    for missed in range(1, len(line) + len(end)):
        reader = ScalesReader()
        weights = reader.feed((line + end)[missed:] + (line + end) * 2)
        assert weights == [read_weight(line)] * 2
        assert reader.rejected == (missed < len(line))


@pytest.mark.parametrize("line", HEADED)
def test_a_flipped_bit_behind_a_head_is_found_or_makes_one_digit_another_or_a_0_of_a_space(line: bytes) -> None:
    sent, weight = line + b"\r\n", read_weight(line)
    for damaged in flipped(sent):
        reader = ScalesReader()
        reader.feed(sent)
        for other in reader.feed(damaged):
            if other != weight:
                ((before, after),) = ((chr(a), chr(b)) for a, b in zip(sent, damaged, strict=True) if a != b)
                assert (before + after).isdigit() or {before, after} == {"0", " "}
