"""Judges a dropped weight as soon as it is recorded, with the fit that will use it."""

from cfid.errors import FitError
from cfid.friction.result import fit
from cfid.records.result import Dependent
from cfid.records.run import Run


def verdict(run: Run) -> str:
    """Return what a recorded drop gives. Raises DataError or FitError where it gives nothing.

    That one weight alone gives no friction is no fault of the recording.
    """
    result = fit([run])
    if any(finding.code == "friction-drop-left-out" for finding in result.findings):
        raise FitError("the speed never settles: let the weight fall farther, and see that the axis turns evenly.")
    line = result.lines[0]
    return " ".join(str(line.value if isinstance(line, Dependent) else line).split()) + "."
