"""A CSV file from any source is read as it was meant, or refused with the faulty line; it is never misread."""

import gzip
import hashlib
import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cfid.errors import ConfigError, DataError
from cfid.records.tables.blocks import open_table

ROWS = [(0.0, 512), (0.001, 1024), (0.002, -7), (0.0035, 4194047)]
HEADLESS = "".join(f"{t},{phi}\n" for t, phi in ROWS)
CSV = f"t,phi\n{HEADLESS}"


def write(folder: Path, content: str | bytes) -> Path:
    path = folder / "swing.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def refusal(folder: Path, content: str | bytes, *, columns: tuple[str, ...] = ("t", "phi"), skip_lines: int = 0) -> str:
    """Return the error message without the path with which it has to start."""
    path = write(folder, content)
    with pytest.raises(DataError) as caught:
        open_table(path, skip_lines=skip_lines).numbers(columns)
    message = str(caught.value)
    assert message.startswith(f"{path}:")
    assert caught.value.__suppress_context__ or caught.value.__context__ is None
    return message.removeprefix(f"{path}:").strip()


SPELLINGS = {
    "commas": CSV,
    "semicolons": CSV.replace(",", ";"),
    "tabs": CSV.replace(",", "\t"),
    "spaces": CSV.replace(",", " "),
    "columns lined up by spaces": "      t      phi\n" + "".join(f"{t:9.4f} {phi:9d}\n" for t, phi in ROWS),
    "spaces around commas": CSV.replace(",", " , "),
    "CRLF": CSV.replace("\n", "\r\n"),
    "CR": CSV.replace("\n", "\r"),
    "CR CR LF": CSV.replace("\n", "\r\r\n"),
    "a byte-order mark": "\ufeff" + CSV,
    "a quoted head": CSV.replace("t,phi", '"t","phi"'),
    "quoted numbers": 't,phi\n"0","512"\n"0.001" ,"1024"\n"0.002","-7"\n0.0035,4194047\n',
    "quotes between spaces": CSV.replace("t,phi", '"t" "phi"').replace(",", " "),
    "blank lines": CSV.replace("\n", "\n\n  \n"),
    "blank lines first": f"\n \n{CSV}",
    "blank lines of tabs": CSV.replace(",", "\t").replace("\n", "\n\t\n"),
    "a separator at the end of rows": CSV.replace("\n", ",\n").replace("t,phi,", "t,phi"),
    "a separator at the end of every line": CSV.replace("\n", ";\n").replace(",", ";"),
    "a separator at the end of the head": CSV.replace("t,phi", "t,phi,"),
    "exponents and signs": "t,phi\n0e0,+512\n1E-3,1.024e3\n.002,-7.\n35e-4,4194047\n",
    "numbers padded by zeros": "t,phi\n0,00000000000000000000000512\n0.001,01024\n0.002,-007\n0.0035,04194047\n",
    "a head in a comment": f"# {CSV}",
    "a head in a comment of MATLAB": f"%{CSV}",
    "zero bytes at the end, as a power failure leaves them": CSV + 4096 * "\0",
    "bars": CSV.replace(",", "|"),
    "decimal commas between semicolons": CSV.replace(",", ";").replace(".", ","),
    "decimal commas between tabs": CSV.replace(",", "\t").replace(".", ","),
    "decimal commas between spaces": CSV.replace(",", " ").replace(".", ","),
    "comments above": f"# rig 7, 21 November\n# Fs = 1000\n{CSV}",
    "comments between the rows": CSV.replace("0.002,", "# the table was touched, here\n% again\n0.002,"),
    "prose above": f"Pendulum 3\n\nrate;1000\n{CSV}",
    "settings of an oscilloscope above": f"Model,T1\nHorizontal Units,S\nHorizontal Scale,1\nInterval,0.001\n\n{CSV}",
    "a head of LabVIEW's with a column of comments": (
        "LabVIEW Measurement\t\nReader_Version\t2\nWriter_Version\t2\n***End_of_Header***\t\n\t\n"
        "Channels\t1\t\t\nSamples\t4\t\t\nX_Dimension\tTime\t\t\nX0\t0.0\t\t\nDelta_X\t0.001\t\t\n***End_of_Header***\t\t\t\n"
        + CSV.replace(",", "\t").replace("phi", "phi\tComment", 1)
    ),
    "a block of other numbers above": f"start,rate,length\n90,1000,5\n{CSV}",
}


def test_a_line_of_units_below_the_names_belongs_to_them(tmp_path: Path) -> None:
    table = open_table(write(tmp_path, "# rig 7\ntime;angle\ns;[deg]\n0,5;1\n1;2,5\n"))
    assert (table.names, table.decimal, table.preamble) == (("time [s]", "angle [deg]"), ",", 1)
    assert table.numbers(table.names).tolist() == [[0.5, 1], [1, 2.5]]


def test_units_spelt_out_below_the_names_belong_to_them(tmp_path: Path) -> None:
    table = open_table(write(tmp_path, "Log Rate: 500\n\nTime\tAngle\nSecs\tRadians\n0.0\t1.0\n0.1\t2.5\n"))
    assert table.names == ("Time [Secs]", "Angle [Radians]")


def test_decimal_commas_need_no_header(tmp_path: Path) -> None:
    assert open_table(write(tmp_path, "0,001;1,5\n0,002;1,6\n")).numbers(["2"]).tolist() == [[1.5], [1.6]]


def test_what_is_no_number_is_missing_where_a_reader_allows_it(tmp_path: Path) -> None:
    table = open_table(write(tmp_path, "t,phi,state\n0,1,on\n1,,on\n2,nan,off\n3,lost,\n4,inf,1_0\n5,6,true\n"))
    phi, state = table.known_numbers(["phi", "state"]).T
    assert np.array_equal(phi, [1, np.nan, np.nan, np.nan, np.nan, 6], equal_nan=True)
    assert np.isnan(state).all()


def test_rows_that_are_left_out_keep_the_lines_of_the_others(tmp_path: Path) -> None:
    table = open_table(write(tmp_path, "t,phi\n0,1\n\n1,x\n2,3\n")).without([1])
    assert table.numbers(["t", "phi"]).tolist() == [[0, 1], [2, 3]]
    assert table.line_of_row(1) == 5


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_a_file_is_read_the_same_with(tmp_path: Path, spelling: str) -> None:
    table = open_table(write(tmp_path, SPELLINGS[spelling]))
    assert table.has_head
    assert table.numbers(["t", "phi"]).tolist() == [list(map(float, row)) for row in ROWS]
    assert table.numbers(["phi"]).tolist() == [[float(phi)] for _, phi in ROWS]
    assert table.cut == ("zero bytes" in spelling)


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
def test_a_file_without_a_head_has_its_columns_by_number(tmp_path: Path, separator: str) -> None:
    table = open_table(write(tmp_path, HEADLESS.replace(",", separator)))
    assert not table.has_head
    assert table.names == ("1", "2")
    assert table.numbers(["2", "1"]).tolist() == [[float(phi), t] for t, phi in ROWS]


def test_a_separator_at_the_end_of_rows_without_a_head_is_no_column(tmp_path: Path) -> None:
    table = open_table(write(tmp_path, HEADLESS.replace("\n", ",\n")))
    assert table.names == ("1", "2", "")
    assert table.numbers(["1", "2"]).tolist() == [list(map(float, row)) for row in ROWS]


def test_lines_that_are_skipped_may_hold_anything(tmp_path: Path) -> None:
    table = open_table(write(tmp_path, f'rig 7; "Monday\n\n1,2,3\n{CSV}'), skip_lines=3)
    assert table.names == ("t", "phi")
    assert len(table.numbers(["t"])) == len(ROWS)


def test_columns_that_are_not_asked_for_may_hold_anything_but_separators(tmp_path: Path) -> None:
    text = 't,note,phi\n0,"a ""b"", c",1\n1,nan,2\n2,,3\n3,12" rotor,4\n4,\u00b5,5\n5,"""x",6\n6,true,7\n'
    assert open_table(write(tmp_path, text)).numbers(["t", "phi"]).tolist() == [[i, i + 1.0] for i in range(7)]


def test_a_comma_in_a_name_is_no_separator_between_semicolons_or_tabs(tmp_path: Path) -> None:
    for between in ";\t":
        table = open_table(write(tmp_path, f"time, s{between}angle, deg\n0{between}1\n"))
        assert table.names == ("time, s", "angle, deg")
        assert table.numbers(["angle, deg"]).tolist() == [[1.0]]


def test_a_latin_1_head_is_read(tmp_path: Path) -> None:
    assert open_table(write(tmp_path, "t [µs];phi [°]\n0;1\n".encode("latin-1"))).names == ("t [µs]", "phi [°]")


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
def test_no_break_spaces_about_numbers_are_spaces(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes("t [µs];à\n1\u00a0;\u00a02,5\n2;3,5\u00a0\n".encode(encoding))
    assert open_table(path).numbers(["t [µs]", "à"]).tolist() == [[1.0, 2.5], [2.0, 3.5]]


def test_an_open_quote_does_not_swallow_the_rows_up_to_the_next_one(tmp_path: Path) -> None:
    text = 't,phi,note\n0,1,"lost\n1,2,b\n2,3,c"\n3,4,d\n'
    assert open_table(write(tmp_path, text)).numbers(["t", "phi"]).tolist() == [[0, 1], [1, 2], [2, 3], [3, 4]]


def test_columns_of_one_name_are_told_apart_by_number(tmp_path: Path) -> None:
    text = "t,phi,x,x,phi\n0,1,2,3,4\n"
    assert "columns 2, 5 are all named 'phi'" in refusal(tmp_path, text)
    assert open_table(write(tmp_path, text)).numbers(["t", "5", "2"]).tolist() == [[0, 4, 1]]


def test_a_name_wins_over_a_number_of_the_same_spelling(tmp_path: Path) -> None:
    assert open_table(write(tmp_path, "a,b 1,c\n1,2,3\n")).numbers(["3", "b 1"]).tolist() == [[3, 2]]


def test_the_hash_is_that_of_the_file_as_it_is(tmp_path: Path) -> None:
    content = b"\xef\xbb\xbft,phi\r\n0,1\r\n0,"
    assert open_table(write(tmp_path, content)).sha256 == hashlib.sha256(content).hexdigest()


def test_a_million_rows_are_all_read(tmp_path: Path) -> None:
    rows = 1_000_000
    time_us = np.arange(rows) * 1000 + 1_763_712_345_123_456
    phi = np.arange(rows) * 7919 % 4194304
    text = "t,phi\n" + "".join([f"{t},{p}\n" for t, p in zip(time_us.tolist(), phi.tolist(), strict=True)])
    values = open_table(write(tmp_path, text)).numbers(["t", "phi"])
    assert np.array_equal(values[:, 0], time_us)
    assert np.array_equal(values[:, 1], phi)


FAULTS: dict[str, tuple[str | bytes, str]] = {
    "an empty file": ("", "empty"),
    "blank lines": ("\n  \r\n\t\n", "empty"),
    "a byte-order mark alone": (b"\xef\xbb\xbf", "empty"),
    "zero bytes alone": (bytes(100), "empty"),
    "a head alone": ("t,phi\n", "a header and no rows"),
    "a head and blank lines": ("t,phi\n\n  \n", "a header and no rows"),
    "a head and a cut row": ("t,phi\n0.1,51", "a header and no rows"),
    "a cut head": ("t,ph", "has no end"),
    "one number": ("512", "has no end"),
    "a missing column": ("t,psi\n0,1\n", "no column 'phi'; it has t, psi."),
    "an empty field": ("t,phi\n0,1\n0.1,\n0.2,3\n", "3: column 'phi' is empty"),
    "a row of separators": ("t,phi\n0,1\n,\n0.2,3\n", "3: column 't' is empty"),
    "nan": ("t,phi\n0,1\n0.1,nan\n", "3: 'nan' in column 'phi' is not a number"),
    "NA": ("t,phi\n0,1\n0.1,NA\n", "3: 'NA' in column 'phi' is not a number"),
    "nan in the first row": ("t,phi\nnan,nan\n0,1\n", "2: 'nan' in column 't' is not a number"),
    "inf": ("t,phi\n0,1\n-inf,2\n", "3: '-inf' in column 't' is not a number"),
    "a number too large for any": ("t,phi\n0,1\n0.1,1e400\n", "3: '1e400' in column 'phi' is not a number"),
    "text": ("t,phi\n0,1\n0.1,lost\n", "3: 'lost' in column 'phi' is not a number"),
    "a date": ("t,phi\n2024-05-01T12:00:00.0,1\n2024-05-01T12:00:00.1,2\n", "Dates and times of day are not read"),
    "true": ("t,phi\n0,true\n0.1,true\n", "2: 'true' in column 'phi' is not a number"),
    "a hexadecimal": ("t,phi\n0,1\n0.1,0x1F\n", "3: '0x1F' in column 'phi' is not a number"),
    "underscores": ("t,phi\n0,1\n0.1,1_000\n", "3: '1_000' in column 'phi' is not a number"),
    "digits of another script": ("t,phi\n0,1\n0.1,٣\n", "3: '٣' in column 'phi' is not a number"),
    "text after blank lines": ("\n\nt,phi\n\n0,1\n\n \n0.1,x\n", "8: 'x' in column 'phi'"),
    "text after CRLF": ("t,phi\r\n0,1\r\n\r\n0.1,x\r\n", "4: 'x' in column 'phi'"),
    "text after CR": ("t,phi\r0,1\r\r0.1,x\r", "4: 'x' in column 'phi'"),
    "text after quotes": ('"t","phi"\n"0","1"\n"0.1","x"\n', "3: 'x' in column 'phi'"),
    "text in tabs": ("t\tphi\n0\t1\n0.1\tx\n", "3: 'x' in column 'phi'"),
    "text in spaces": ("t phi\n 0  1\n\n 0.1  x\n", "4: 'x' in column 'phi'"),
    "too many fields": ("t,phi\n0,1\n0.1,2,3\n", "3: 3 fields where the file has 2 columns"),
    "too many fields everywhere": ("t,phi\n0,001,1\n0,002,2\n", "2: 3 fields where the file has 2 columns"),
    "too few fields": ("t,phi\n0,1\n0.1\n0.2,3\n", "3: 1 field where the file has 2 columns"),
    "too few fields in a column that nobody reads": ("t,phi,x\n0,1,2\n0.1,4\n", "3: 2 fields"),
    "too many fields between spaces": ("t phi\n0 1\n0.1 2 3\n", "3: 3 fields where the file has 2 columns"),
    "a torn row with another after it": ("t,phi\n0.001,4000.002,17\n", "2: 3 fields"),
    "zero bytes inside": (b"t,phi\n" + 2000 * b"0,1\n" + b"0,1\0002\n0,1\n", "2002: zero bytes"),
    "zero bytes in a column that nobody reads": (
        b"t,phi,x\n" + 2000 * b"0,1,2\n" + b"0,1,\0\n0,1,2\n",
        "2002: zero bytes",
    ),
    "a decimal comma between commas": ("t,phi\n0,001,1,5\n", "2: 4 fields where the file has 2 columns. Numbers need"),
    "decimal commas between spaces without a head": ("0,001 1,5\n0,002 1,6\n", "1: '0,001 1,5' is neither"),
    "decimal commas and points": (
        "t;phi\n0,5;1\n1.5;2\n",
        "2: '0,5' in column 't' is not a number. Numbers need",
    ),
    "commas that may be of thousands": ("t;phi\n0;1,234\n1;2,345\n", "2: '1,234' in column 'phi' is not a number"),
    "one row below prose": ("Dear Sir,\nyours:\n1,2\n", "not a CSV file of numbers: line 2 reads 'yours:'"),
    "thousands commas": ("t;phi\n0;1,234,567\n", "2: '1,234,567' in column 'phi' is not a number. Write thousands"),
    "thousands points": ("t;phi\n0;1.234.567\n", "2: '1.234.567' in column 'phi' is not a number"),
    "thousands apostrophes": ("t;phi\n0;1'234\n", "2: '1'234' in column 'phi' is not a number"),
    "thousands spaces": ("t;phi\n0;1 234\n", "2: '1 234' in column 'phi' is not a number"),
    "a spoilt first row": ("0.0x,5\n0.1,6\n", "1: '0.0x,5' is neither a header nor a row"),
    "prose": ("Dear Sir or Madam,\nthe rig is broken.\n", "not a CSV file of numbers: line 2"),
    "a photograph": (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "not a CSV file: it holds binary data"),
    "a spreadsheet": (
        b"PK\x03\x04\x14\0\0\0",
        "a spreadsheet (.xlsx) or packed files (.zip, .npz): save the table as CSV",
    ),
    "an old spreadsheet": (b"\xd0\xcf\x11\xe0\xa1\xb1", "a spreadsheet (.xls): save the table as CSV"),
    "a packed table": (gzip.compress(CSV.encode()), "a packed file (.gz): unpack it"),
    "UTF-16": (CSV.encode("utf-16"), "not a CSV file in UTF-8, but text in UTF-16"),
    "UTF-16 of the other order": (b"\xfe\xff" + CSV.encode("utf-16-be"), "not a CSV file in UTF-8, but text in UTF-16"),
    "UTF-16 without a mark": (CSV.encode("utf-16-le"), "or text in UTF-16"),
    "UTF-32": (CSV.encode("utf-32"), "not a CSV file in UTF-8, but text in UTF-16 or UTF-32"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_refused_with_a_sentence_is(tmp_path: Path, fault: str) -> None:
    content, sentence = FAULTS[fault]
    assert sentence in refusal(tmp_path, content)


def test_the_line_at_fault_counts_the_lines_that_were_skipped(tmp_path: Path) -> None:
    message = refusal(tmp_path, "a\n\nb\n\nt,phi\n0,1\n\n0.1,x\n", skip_lines=3)
    assert message.startswith("8: 'x' in column 'phi'")


def test_more_lines_skipped_than_there_are_is_said(tmp_path: Path) -> None:
    assert "nothing in its 5 lines beyond the 9 that `skip_lines` leaves out" in refusal(tmp_path, CSV, skip_lines=9)
    assert "beyond the 5" in refusal(tmp_path, CSV, skip_lines=5)


def test_a_negative_number_of_lines_to_skip_is_a_usage_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="`skip_lines` -1"):
        open_table(write(tmp_path, CSV), skip_lines=-1)


def test_no_sentence_repeats_a_whole_file(tmp_path: Path) -> None:
    assert len(refusal(tmp_path, f"t,{5000 * 'phi '}\n0,1\n")) < 300
    assert len(refusal(tmp_path, f"t,phi\n0,1\n0,{5000 * 'x'}\n")) < 300
    assert len(refusal(tmp_path, f"{'abc ' * 9999}\n{'def ' * 9999}\n")) < 300


@pytest.mark.parametrize(
    ("name", "sentence"), [("nowhere.csv", "no such file"), (".", "directory"), ("x" * 300, "name too long")]
)
def test_what_cannot_be_read_is_said(tmp_path: Path, name: str, sentence: str) -> None:
    with pytest.raises(DataError, match=f"(?i){sentence}"):
        open_table(tmp_path / name)


def test_a_file_that_links_to_itself_is_said(tmp_path: Path) -> None:
    (tmp_path / "loop.csv").symlink_to("loop.csv")
    with pytest.raises(DataError, match="cannot be read"):
        open_table(tmp_path / "loop.csv")


FINITE = st.floats(allow_nan=False, allow_infinity=False)
TABLES = st.lists(st.tuples(FINITE, st.integers(-(2**53), 2**53), FINITE), min_size=1, max_size=6)


@given(
    rows=TABLES,
    separator=st.sampled_from([",", ";", "\t", " "]),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    head=st.booleans(),
    blank=st.integers(0, 2),
    quoted=st.booleans(),
)
def test_any_finite_numbers_come_back_exactly(
    tmp_path_factory: pytest.TempPathFactory,
    rows: list[tuple[float, int, float]],
    separator: str,
    end: str,
    head: bool,
    blank: int,
    quoted: bool,
) -> None:
    quote = '"' if quoted else ""
    lines = [separator.join(f"{quote}{value!r}{quote}" for value in row) for row in rows]
    lines = [separator.join(["a", "b", "c"])] * head + lines
    path = write(tmp_path_factory.mktemp("any"), "".join(line + end * (1 + blank) for line in lines))
    table = open_table(path)
    values = table.numbers(table.names)
    assert values.tolist() == [list(map(float, row)) for row in rows]
    assert [table.line_of_row(row) for row in range(len(rows))] == [
        1 + (head + row) * (1 + blank) for row in range(len(rows))
    ]


FIELDS = st.text(st.characters(exclude_characters=',\n\r"', exclude_categories=["Cs"]), max_size=6)


@given(junk=st.one_of(FIELDS, st.text("0123456789.eE+-_ nainf", max_size=6)), row=st.integers(1, 20))
@example(junk="\0", row=3)
@example(junk="\x0b", row=3)
@example(junk="1\x0b", row=3)
@example(junk="\xa01", row=3)
@example(junk="#1", row=2)
@example(junk="1e999", row=1)
def test_a_field_is_read_as_the_number_it_spells_or_refused_with_its_line(
    tmp_path_factory: pytest.TempPathFactory, junk: str, row: int
) -> None:
    rows = [f"{i},{i},z" for i in range(22)]
    rows[row] = f"{row},{junk},z"
    path = write(tmp_path_factory.mktemp("junk"), "t,phi,x\n" + "".join(f"{line}\n" for line in rows))
    plain = junk.replace("\xa0", " ")
    number = re.fullmatch(r"\s*[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?\s*", plain, re.ASCII | re.IGNORECASE)
    if number and math.isfinite(float(junk)):
        assert open_table(path).numbers(["t", "phi"])[row].tolist() == [row, float(junk)]
    elif re.search("[\0-\x08\x0e-\x1f]", junk):
        with pytest.raises(DataError, match="binary data"):
            open_table(path)
    else:
        with pytest.raises(DataError, match=f":{row + 2}: "):
            open_table(path).numbers(["t", "phi"])


def test_a_table_of_many_blocks_is_read_as_one(tmp_path: Path) -> None:
    text = "t,phi\n" + "".join(f"{at},{2 * at}\n" for at in range(200_000)) + "200000,4"
    table = open_table(write(tmp_path, text))
    values = table.numbers(["phi", "t"])
    assert len(text) > 2 << 20
    assert table.cut
    assert values.shape == (200_000, 2)
    assert np.array_equal(values[:, 1], np.arange(200_000))
    assert table.line_of_row(199_999) == 200_001


def test_a_table_of_many_blocks_is_read_through_once(tmp_path: Path) -> None:
    path = write(tmp_path, "t,phi\n" + "".join(f"{at},{2 * at}\n" for at in range(200_000)))
    table = open_table(path)
    table.numbers(["phi", "t"])
    path.unlink()
    assert table.line_of_row(199_999) == 200_001
    assert table.all_prose() == []


@pytest.mark.parametrize("line", ["", "end of the recording"])
def test_a_line_without_a_row_in_a_late_block_is_counted(tmp_path: Path, line: str) -> None:
    lines = [f"{at},{2 * at}" for at in range(200_000)]
    table = open_table(write(tmp_path, "\n".join(["t,phi", *lines[:190_000], line, *lines[190_000:], ""])))
    assert len(table.numbers(["phi", "t"])) == 200_000
    assert [table.line_of_row(row) for row in (189_999, 190_000, 199_999)] == [190_001, 190_003, 200_002]
    assert [(one.number, one.text) for one in table.all_prose()] == ([(190_002, line)] if line else [])


def test_rows_are_left_out_of_a_table_of_many_blocks(tmp_path: Path) -> None:
    table = open_table(write(tmp_path, "t,phi\n" + "".join(f"{at},{2 * at}\n" for at in range(200_000))))
    left = table.without([0, 150_000]).without([149_998])  # numbered among the remaining rows
    assert np.array_equal(left.numbers(["t"])[:, 0], np.delete(np.arange(200_000), [0, 149_999, 150_000]))
    assert left.line_of_row(149_998) == 150_003


def test_lines_that_no_table_has_are_named_as_that(tmp_path: Path) -> None:
    path = tmp_path / "wide.csv"
    columns = 200_000
    rows = [",".join(f"c{at}" for at in range(columns)), *[",".join(["0"] * columns)] * 20]
    path.write_text("\n".join([*rows, ""]))
    with pytest.raises(DataError, match=r"lines of \d+ kB or more: not a table"):
        open_table(path)


def test_a_fault_late_in_a_large_file_is_named_with_its_line(tmp_path: Path) -> None:
    rows = [f"{at},{2 * at}" for at in range(200_000)]
    rows[170_000] = "none,1"
    table = open_table(write(tmp_path, "\n".join(["t,phi", *rows, ""])))
    with pytest.raises(DataError, match=r":170002: 'none' in column 't' is not a number"):
        table.numbers(["t"])


def test_many_lines_with_other_fields_are_refused_by_the_first_of_them(tmp_path: Path) -> None:
    rows = [f"{at},{2 * at}" for at in range(2000)]
    rows[1000:1010] = [f"{row},1" for row in rows[1000:1010]]
    table = open_table(write(tmp_path, "\n".join(["t,phi", *rows, ""])))
    with pytest.raises(DataError, match=r":1002: 3 fields where the file has 2 columns"):
        table.numbers(["t"])
