"""Judge a dropped weight as soon as it is recorded, by the fit that will take it."""

from cfid.errors import FitError
from cfid.friction.result import fit
from cfid.records.result import Dependent
from cfid.records.run import Run


def verdict(run: Run) -> str:
    """Say what a recorded drop is good for. Raises DataError or FitError where it is good for nothing.

    One weight alone gives no friction, which is no fault of the recording.
    """
    result = fit([run])
    if any(finding.code == "friction-drop-left-out" for finding in result.findings):
        raise FitError("the speed never settles: let the weight fall farther, and see that the axis turns evenly.")
    line = result.lines[0]
    return " ".join(str(line.value if isinstance(line, Dependent) else line).split()) + "."
