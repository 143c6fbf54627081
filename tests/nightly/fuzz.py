"""Damaged files and packets for every reader: each is read or refused with a sentence, within time and memory limits.

    python -m tests.nightly.fuzz --cases 1000
    python -m tests.nightly.fuzz --cases 1000 --reader "run.toml" --seed 7

Hypothesis edits valid content, and prefers edits after which more of it is still accepted. It minimises and prints
what it finds: a traceback, more than 5 s, more than 1 GB, or numbers that the file does not contain.
"""

import argparse
import contextlib
import resource
import signal
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType

from hypothesis import HealthCheck, Phase, given, settings, target
from hypothesis import seed as seeded
from hypothesis import strategies as st

from tests.nightly.readers import READERS, Reader

LONGEST_S = 5.0
MOST_KB = 1 << 20  # of used memory
MOST_ADDRESSES = 3 << 30  # bytes of address space: Arrow reserves a gigabyte at once, but uses little of it
TOKENS = (
    b"nan", b"inf", b"-inf", b"1e999", b"-1e-320", b"-0", b"9" * 400, b"1_000", b"0x1f", b"1,5", b"1.2.3", b"", b" ",
    b",", b";", b"\t", b'"', b"'", b"#", b"\0", b"\r", b"\n", b"\r\n", b"\x0b", b"\x0c", b"\x1b[2J", b"\x85",
    b"\xef\xbb\xbf", b"\xff\xfe", b"\xe2\x80\xae", b"\xc2\xb5", b"\xff" * 8, b"\x00" * 8, b"\xff\xff\xff\x7f",
    b"[", b"]", b"[[", b"{", b"}", b"[" * 3000, b"true", b"null", b"-1", b"1e9", b"4294967296", b"=", b".", b"..",
    b"/dev/zero", b"9999-12-31T23:59:59Z", b"\\u0000",
)  # fmt: skip

_place = st.integers(0, 1 << 30)
_edit = st.tuples(
    st.sampled_from(["insert", "replace", "delete", "repeat", "swap", "cut"]),
    _place,
    st.integers(0, 40),
    st.one_of(st.sampled_from(TOKENS), st.binary(max_size=8)),
)
edits = st.lists(_edit, min_size=1, max_size=5)


def damaged(content: bytes, how: list[tuple[str, int, int, bytes]]) -> bytes:
    """Return content after edits, each of a kind, at a place, over a length, with a token."""
    for kind, place, length, token in how:
        at = place % (len(content) + 1)
        part = content[at : at + length]
        if kind == "insert":
            content = content[:at] + token + content[at:]
        elif kind == "replace":
            content = content[:at] + token + content[at + max(len(token), 1) :]
        elif kind == "delete":
            content = content[:at] + content[at + length :]
        elif kind == "repeat":
            content = content[:at] + part * 20 + content[at:]
        elif kind == "swap":
            other = (place // 7) % (len(content) + 1)
            content = content[:other] + part + content[other + length :]
        else:
            content = content[:at]
    return content


class TooLongError(BaseException):
    """A reader took too long; no reader catches this error."""


@contextlib.contextmanager
def limited() -> Iterator[None]:
    """Raise TooLongError after 5 s of processor time, and MemoryError if the process grows by more than 1 GB.

    An allocation that would make it grow much more gets no address space, and raises MemoryError at once.
    """

    def ended(number: int, frame: FrameType | None) -> None:
        raise TooLongError(f"more than {LONGEST_S:g} s of processor time")

    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    peak_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MOST_ADDRESSES, before[1]))
    handler = signal.signal(signal.SIGPROF, ended)
    signal.setitimer(signal.ITIMER_PROF, LONGEST_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, handler)
        resource.setrlimit(resource.RLIMIT_AS, before)
    grown_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak_kb
    if grown_kb > MOST_KB:
        raise MemoryError(f"{grown_kb / 1e6:.1f} GB")


def read(reader: Reader, content: bytes, folder: Path) -> bool:
    """Return whether a reader accepts content. Raises errors that the reader must not raise, and AssertionError."""
    path = folder / reader.file
    path.write_bytes(content)
    with limited(), warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", ResourceWarning)  # raised by libraries
        try:
            found = reader.read(path)
        except reader.raises as error:
            refusal = str(error)
        else:
            wrong = reader.fault(content, found)
            assert not wrong, wrong
            return True
    assert refusal, "refused without a sentence"
    return False


def attack(reader: Reader, *, cases: int, seed: int) -> str:
    """Damage a reader's contents `cases` times; return a description of the fault found, or ""."""
    with TemporaryDirectory(prefix="cfid-fuzz-") as name:
        folder = Path(name)
        for content in reader.contents:
            assert read(reader, content, folder), f"{reader.name} refuses its own content"

        @seeded(seed)
        @settings(
            max_examples=cases, database=None, deadline=None, suppress_health_check=list(HealthCheck),
            phases=[Phase.generate, Phase.target, Phase.shrink], report_multiple_bugs=False,
        )  # fmt: skip
        @given(st.sampled_from(reader.contents), edits)
        def survives(content: bytes, how: list[tuple[str, int, int, bytes]]) -> None:
            changed = reader.repaired(damaged(content, how))
            target(float(len(how)) if read(reader, changed, folder) else 0.0, label="edits accepted")

        try:
            survives()
        except (Exception, TooLongError) as error:
            notes = "\n".join(getattr(error, "__notes__", ()))
            return f"{type(error).__name__}: {str(error)[:300]}\n{notes[-3000:]}"
    return ""


def main() -> None:
    """Attack the readers, print a line for each, and exit with 1 if a fault was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=1000, help="for each reader")
    parser.add_argument(
        "--reader", default="", choices=["", *(reader.name for reader in READERS)], help="only this one"
    )
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    found = 0
    for reader in READERS:
        if arguments.reader in ("", reader.name):
            fault = attack(reader, cases=arguments.cases, seed=arguments.seed)
            found += bool(fault)
            print(f"{reader.name}: {fault or f'{arguments.cases} cases, nothing found'}", flush=True)
    sys.exit(min(found, 1))


if __name__ == "__main__":
    main()
