"""When each command changed between two rows, as later speeds show: the times are fitted with the lag, and eliminated.

A row shows a command that changed up to one row earlier. The mean of that time is part of the delay, but its scatter,
which few samples of each change show, would shift time constants.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import numpy.typing as npt
from scipy.sparse import csc_array, eye_array
from scipy.sparse.linalg import SuperLU, splu

from cfid.estimate.linear import gain_of
from cfid.large import empty, parts
from cfid.motors.lag.model import InputLag, LogSegment, Signal, Supply, speed_shown
from cfid.motors.lag.plausibility import noise_of
from cfid.motors.lag.search import Search
from cfid.motors.lag.uncertainty import beside, correlation_of, drifts_of, whitened

Array = npt.NDArray[np.float64]

_ROUNDS = 3  # in which changes are moved to where they are found
_NARROWEST = 0.01  # least factor on the usual time by which changes are late, in a round
_FORGOTTEN = 12.0  # time constants
_TOGETHER = 1000  # changes whose rows are calculated at once
_QUIETEST = 1e-6  # of the range of the measured values: the least noise


@dataclass(frozen=True, eq=False)
class Scatter:
    """The effect on speeds (n,) of k changes of commands that come a usual time later, (n, k), and how late they are.

    The changes have been moved by `late` (k,) usual times already; `noise` is that of the speeds.
    """

    columns: csc_array
    late: Array
    noise: float

    def whitened(self, lengths: Sequence[int], correlation: float) -> "Scatter":
        """Return the scatter for residuals that are whitened in the same way."""
        kept = np.full(sum(lengths), 1.0)
        kept[np.cumsum([0, *lengths[:-1]])] = math.sqrt(1 - correlation**2)
        before = np.where(kept < 1, 0.0, -correlation) if correlation else np.zeros(len(kept))
        rows, value = self.columns.indices, self.columns.data  # those of a column follow each other
        follows = np.full(len(rows) + 1, True)
        follows[self.columns.indptr] = False
        found = empty(len(rows))
        for part in parts(len(rows)):
            found[part] = kept[rows[part]] * value[part]
            last = slice(max(part.start, 1), part.stop)
            found[last] += follows[last] * before[rows[last]] * value[last.start - 1 : last.stop - 1]
        return replace(self, columns=csc_array((found, rows, self.columns.indptr), shape=self.columns.shape))

    def found(self, residual: Array) -> Array:
        """Return how much later still the changes (k,) are, in usual times, as residuals (n,) show."""
        return np.asarray(-self._square.solve(self.columns.T @ residual + self.noise**2 * self.late))

    def without(self, residual: Array, *, late: bool = True) -> Array:
        """Return residuals (n,) without what the changes' times explain, and how unusual these (k,) are, as one array.

        The latter are inserted in order, each before the first residual that its change affects. For a column of
        slopes, which is no residual, `late` is false: how late the changes are does not enter.
        """
        moved = self.late if late else np.zeros(len(self.late))
        more = -self._square.solve(self.columns.T @ residual + self.noise**2 * moved)
        first = self.columns.indices[np.minimum(self.columns.indptr[:-1], len(self.columns.indices) - 1)]
        return np.insert(residual + self.columns @ more, first, self.noise * (moved + more))

    def spread(self, late: Array) -> float:
        """Return the variance of how late changes (k,) are, in usual times, less that of their noise.

        It is almost 0 where commands change at their rows.
        """
        seen = self._seen / self.noise**2
        shown = seen > 1
        if not shown.any():
            return 1.0
        return float(np.mean((late[shown] * (1 + 1 / seen[shown])) ** 2 - 1 / seen[shown]))

    @property
    def freedom(self) -> float:
        """The degrees of freedom that the changes' times take at most: as many as are known better than usual."""
        return float(np.sum(self._seen / (self._seen + self.noise**2)))

    @cached_property
    def _square(self) -> SuperLU:
        """The factors that solve for changes; they are sparse, since few changes show in the same samples."""
        return splu(csc_array(self._products + self.noise**2 * eye_array(self._products.shape[0])))

    @cached_property
    def _products(self) -> csc_array:
        return csc_array(self.columns.T @ self.columns)

    @property
    def _seen(self) -> Array:
        """How much of each change (k,) the speeds show, squared."""
        return np.asarray(self._products.diagonal())


def scattered(search: Search, begin: Array, *, row_s: float) -> tuple[Search, Scatter] | None:
    """Return a record of speeds with its commands' changes moved to where the speeds show them, and their scatter.

    The search begins at parameters (8,). Returns None where no command changes. Rows of the command are `row_s` apart;
    a change may lie anywhere between two of them.
    """
    most_s, p, lengths = row_s / math.sqrt(12), begin, [len(piece.measured.value) for piece in search.pieces]
    std_s, late = most_s, np.zeros(sum(np.count_nonzero(_changes(piece)) for piece in search.pieces))
    if not len(late):
        return None
    for _ in range(_ROUNDS):
        now = _moved(search, late * std_s)
        drifts = drifts_of(now.pieces, now.shown(p))
        left = beside(now.shown(p) - now.measured, drifts)
        white = partial(whitened, lengths=lengths, correlation=correlation_of(left, lengths))
        noise = max(noise_of(white(left)), _QUIETEST * float(np.ptp(now.measured)))
        scatter = Scatter(_columns(now.pieces, p, std_s), late, noise)
        own = scatter.whitened(lengths, correlation_of(left, lengths))
        columns = np.column_stack([own.without(white(column), late=False) for column in drifts.T])
        p = now.fitted(p, partial(_rest, white=white, own=own, columns=columns)).x
        missing = now.shown(p) - now.measured
        drift = drifts @ (gain_of(columns) @ own.without(white(missing)))
        late = np.clip(late + own.found(white(missing - drift)), -math.sqrt(3), math.sqrt(3))
        share = math.sqrt(min(max(own.spread(late), _NARROWEST**2), (most_s / std_s) ** 2))
        late, std_s = np.clip(late / share, -math.sqrt(3), math.sqrt(3)), share * std_s
    now = _moved(search, late * std_s)._replace(start=p)
    return now, replace(scatter, columns=_columns(now.pieces, p, std_s), late=late)


def _rest(residual: Array, *, white: Callable[[Array], Array], own: Scatter, columns: Array) -> Array:
    """Return the part of residuals (n,) that neither changes nor drifts (n, m) explain."""
    return beside(own.without(white(residual)), columns)


def _changes(piece: LogSegment) -> npt.NDArray[np.bool_]:
    """Return which values (n,) of a segment's drive differ from the value before."""
    return np.append(False, np.diff(piece.drive.value) != 0)


def _moved(search: Search, late_s: Array) -> Search:
    """Return a record whose drives change later by `late_s` (k,), each change at most half-way to the next value."""
    pieces, begin = [], 0
    for piece in search.pieces:
        (time_s, value), changes = piece.drive, _changes(piece)
        end = begin + int(np.count_nonzero(changes))
        moves = np.zeros(len(time_s))
        moves[changes] = late_s[begin:end]
        room_s = np.diff(time_s, prepend=-np.inf, append=np.inf) / 2
        pieces.append(piece._replace(drive=Signal(time_s + np.clip(moves, -room_s[:-1], room_s[1:]), value)))
        begin = end
    return search._replace(pieces=pieces, shown=speed_shown(pieces))


def _columns(pieces: Sequence[LogSegment], p: Array, std_s: float) -> csc_array:
    """Return by how much, in rad/s, all segments' speeds (n,) move when each change of a drive comes later: (n, k)."""
    each = [_seen_changes(piece, p) for piece in pieces]
    spans = [np.searchsorted(seen, [passed, passed + _FORGOTTEN]) for seen, passed, _ in each]
    ends = np.append(0, np.cumsum(np.concatenate([last - first for first, last in spans])))
    values, rows = empty(int(ends[-1])), np.empty(ends[-1], np.int32)
    begin = column = 0
    for (seen, passed, jump), (first, last) in zip(each, spans, strict=True):
        for group in (slice(at, at + _TOGETHER) for at in range(0, len(jump), _TOGETHER)):
            count = (last - first)[group]
            own = np.arange(count.sum()) + np.repeat(first[group] - (np.cumsum(count) - count), count)
            here = slice(ends[column], ends[column] + len(own))
            rows[here] = begin + own
            values[here] = np.repeat(std_s * jump[group], count) * np.exp(np.repeat(passed[group], count) - seen[own])
            column += len(count)
        begin += len(seen)
    return csc_array((values, rows, ends), shape=(begin, len(ends) - 1))


def _seen_changes(piece: LogSegment, p: Array) -> tuple[Array, Array, Array]:
    """Return how many time constants have passed at the speeds (n,) of a segment, and at the changes (k,) of its drive.

    The third array (k,) is by how much the speed's rate jumps at each change, in rad/s^2.
    """
    lag, supply = InputLag(*p[3:6].tolist()), Supply(*p[6:].tolist())
    target, changes = piece.target(p[:3], lag, supply), _changes(piece)
    at_s = target.time_s + lag.delay_s
    speed = lag.follow(target, at_s)
    rate = 1 / np.where(target.value > speed, lag.rising_s, lag.falling_s)
    earlier = np.append(speed[0], target.value[:-1]) - speed
    old = earlier / np.where(earlier > 0, lag.rising_s, lag.falling_s)
    jump = old - (target.value - speed) * rate
    passed = np.append(0.0, np.cumsum(np.diff(at_s) * rate[:-1]))
    place = np.maximum(np.searchsorted(at_s, piece.measured.time_s, side="right") - 1, 0)
    return passed[place] + (piece.measured.time_s - at_s[place]) * rate[place], passed[changes], jump[changes]
