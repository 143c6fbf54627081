"""The test body measured against its drawing: quantities, findings, lines and figure."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from cfid.findings import Finding, rejection, warning
from cfid.inertia.comparison import BodyComparison, compare
from cfid.inertia.data import Peaks, Swing, measure, records_of
from cfid.recordings.angle import AxisRecord
from cfid.records.parameters import Parameter
from cfid.records.plausibility import implausible_gravity
from cfid.records.result import Dependent, Figures, Result
from cfid.records.rig_file import Rig
from cfid.swing.body import (
    FIXTURE,
    axis_inertias,
    check_mounts,
    drawn_body,
    required_rig,
    rests_on,
    surroundings,
    swung_test_body,
)
from cfid.swing.result import Method
from cfid.swing.window import SMALLEST_PEAK_RAD

Array = npt.NDArray[np.float64]

UNLIKELY_STD = 4.0
ANOTHER_STD = 20.0  # no calliper is that wrong

_MEASURED = "testbody.measured_kg_m2"


def fit_testbody(
    swings: Sequence[Swing],
    *,
    rig: Rig | None = None,
    mass_kg: float | None = None,
    mass_std_kg: float | None = None,
    gravity_mps2: float | None = None,
    gravity_std_mps2: float | None = None,
    peaks: Peaks = None,
    smallest_peak_rad: float = SMALLEST_PEAK_RAD,
    method: Method = "default",
) -> Result:
    """Compare the test body's measured inertias with those of its drawing (table 2.5), one mount per swing.

    Arguments and errors are those of `cfid.inertia.fit`; mounts and drawing are the rig's `testbody`.
    """
    given = records_of(swings)
    rig = required_rig([swing for swing in given if isinstance(swing, AxisRecord)], rig)
    body = drawn_body(rig, mass_kg, mass_std_kg)
    measured = measure(
        given,
        body="testbody",
        mounts=body.mounts,
        gravity_mps2=surroundings(rig, gravity_mps2).gravity_mps2,
        gives=_MEASURED,
        encoder=rig.encoder,
        peaks=peaks,
        smallest_peak_rad=smallest_peak_rad,
        method=method,
    )
    check_mounts((swing.axis for swing in measured.mounted), body.mounts, table="testbody.mounts")
    around = surroundings(rig, gravity_mps2, gravity_std_mps2, measured.fixture)
    comparisons = compare(body, axis_inertias(measured.mounted, swung_test_body(body), around))
    findings = (
        *measured.findings(_resting_on),
        *_differences(comparisons),
        *implausible_gravity(around.gravity_mps2, "testbody.measured_kg_m2.*", "testbody.error.*"),
    )
    quantities = _quantities(comparisons)
    differences = (
        Dependent(
            f"{c.axis}: measured {100 * abs(c.error):.4f} % {'above' if c.error > 0 else 'below'} the drawing",
            f"testbody.error.{c.axis}",
        )
        for c in comparisons
    )

    def drawings() -> Figures:
        from cfid.inertia.figures import testbody_figure

        return {"testbody": testbody_figure(comparisons)}

    return Result(
        command="fit testbody",
        method=method,
        quantities=quantities,
        wanted=("testbody.error.*",),
        merits={"swings": measured.merits, "deviations": {c.axis: c.deviations for c in comparisons}},
        findings=findings,
        sources=measured.sources,
        rests_on=rests_on((), body="testbody"),
        lines=(*measured.lines, *differences),
        drawings=drawings,
    )


def _quantities(comparisons: Sequence[BodyComparison]) -> dict[str, Parameter]:
    found = {}
    for c in comparisons:
        for name, value, std in (
            ("calculated_kg_m2", c.calculated_kg_m2, c.calculated_std_kg_m2),
            ("measured_kg_m2", c.measured_kg_m2, c.measured_std_kg_m2),
            ("error", c.error, c.error_std),
        ):
            found[f"testbody.{name}.{c.axis}"] = Parameter(value=value, std=std or None)
    return found


def _resting_on(mount: str) -> tuple[str, ...]:
    """Return the quantities that rest on the swing about a mount; all measured ones rest on the fixture's swing."""
    axis = "*" if mount == FIXTURE else mount
    return f"testbody.measured_kg_m2.{axis}", f"testbody.error.{axis}"


def _differences(comparisons: Sequence[BodyComparison]) -> Iterator[Finding]:
    """Yield a finding for every swing that differs from the drawing."""
    for c in comparisons:
        text = (
            f"{c.axis}: measured and calculated lie {c.deviations:.1f} standard uncertainties apart (limit "
            f"{UNLIKELY_STD:g}). Check which axis was swung, the mount's distance, the body's lengths, and that "
            "nothing slips."
        )
        if ANOTHER_STD <= c.deviations < math.inf:
            yield rejection("testbody-another-axis", text, *_resting_on(c.axis))
        elif UNLIKELY_STD < c.deviations < ANOTHER_STD:
            yield warning("testbody-apart", text, *_resting_on(c.axis))
