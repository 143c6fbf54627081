"""Shows the operator what is noticed during a recording, while the recording goes on."""

import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from cfid.records.progress import RunProgress
from cfid.rig.keyboard import Keyboard
from cfid.rig.loop import Ending
from cfid.rig.recorder import Say, Sink

Notice = Callable[[str, Sequence[Any]], str]  # takes a device's new columns; returns what is wrong, "" for nothing

_ENDED_BY = "the operator"


class Noticing:
    """A sink that passes rows on to a run and asks the operator about each thing that `notice` returns.

    At a terminal n ends the recording, y or no key goes on; a script gets the sentence alone. Without `asks` the
    keyboard belongs to a procedure, and the operator too gets the sentence alone.
    """

    def __init__(self, run: Sink, notice: Notice, *, ending: Ending, loop: Any, say: Say, asks: bool) -> None:
        """Take the run to write."""
        self._run, self._notice, self._ending, self._loop, self._say = run, notice, ending, loop, say
        self._asks = asks and sys.stdin is not None and sys.stdin.isatty()
        self._keyboard: Keyboard | None = None

    def append(self, device: str, columns: Sequence[Any]) -> None:
        """Write one block, then examine it."""
        self._run.append(device, columns)
        wrong = self._notice(device, columns)
        if wrong:
            self._tell(wrong)

    def count_lost(self, device: str, samples: int | None) -> None:
        """Count samples that are missing."""
        self._run.count_lost(device, samples)

    def describe(self, device: str, facts: Mapping[str, Any]) -> None:
        """Add facts about a device."""
        self._run.describe(device, facts)

    def sync(self, progress: RunProgress) -> None:
        """Sync the rows to the disk, and publish the progress."""
        self._run.sync(progress)

    def close(self) -> None:
        """Give the keyboard back."""
        keyboard, self._keyboard = self._keyboard, None
        if keyboard is not None:
            keyboard.close()

    def _tell(self, wrong: str) -> None:
        if not self._asks:
            self._say(wrong)
            return
        if self._keyboard is None:
            self._keyboard = Keyboard(self._typed, loop=self._loop, keys=True)
            self._keyboard.open()
        self._say(f"{wrong} The recording goes on; n ends it, y goes on without this question.")

    def _typed(self, key: str | None) -> None:
        if key in ("n", "N"):
            self._ending.request(_ENDED_BY)
        if key in ("n", "N", "y", "Y", "\n", "\r", None):
            self.close()
