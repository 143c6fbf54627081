"""Streams of bytes as ports deliver them: in pieces of any size."""

from itertools import pairwise

from hypothesis import settings
from hypothesis import strategies as st

FEW = settings(max_examples=200, deadline=None, derandomize=True)

slicings = st.lists(st.integers(1, 40), min_size=1, max_size=4)


def sliced(stream: bytes, sizes: list[int]) -> list[bytes]:
    """Return the pieces of a stream; their sizes are taken in turn."""
    ends = [0]
    while ends[-1] < len(stream):
        ends.append(ends[-1] + sizes[len(ends) % len(sizes)])
    return [stream[begin:end] for begin, end in pairwise(ends)]


def flipped(sent: bytes) -> list[bytes]:
    """Return the bytes with each of their bits flipped in turn."""
    number, size = int.from_bytes(sent, "big"), len(sent)
    return [(number ^ 1 << bit).to_bytes(size, "big") for bit in range(8 * size)]
