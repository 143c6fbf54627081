"""The test body measured against its drawing: quantities, findings, lines and figure."""

import math
from collections.abc import Iterator, Sequence

from uncertainties import nominal_value

from cfid.findings import Finding, rejection, warning
from cfid.inertia.comparison import BodyComparison, compare
from cfid.inertia.data import Peaks, Swing, measure
from cfid.records.parameters import Parameter
from cfid.records.plausibility import implausible_gravity
from cfid.records.result import Dependent, Figures, Result
from cfid.records.rig_file import Rig
from cfid.swing.body import FIXTURE, drawn_body, rests_on
from cfid.swing.result import Method, parameter
from cfid.swing.window import SMALLEST_PEAK_RAD

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
    measured = measure(
        swings,
        body="testbody",
        gives=_MEASURED,
        rig=rig,
        mass=(mass_kg, mass_std_kg),
        gravity=(gravity_mps2, gravity_std_mps2),
        peaks=peaks,
        smallest_peak_rad=smallest_peak_rad,
        method=method,
    )
    comparisons = compare(drawn_body(measured.rig, mass_kg, mass_std_kg), measured.axes)
    findings = (
        *measured.findings(_resting_on),
        *_differences(comparisons),
        *implausible_gravity(measured.around.gravity_mps2, "testbody.measured_kg_m2.*", "testbody.error.*"),
    )
    quantities, differences = dict[str, Parameter](), list[Dependent]()
    for c in comparisons:
        for name in ("calculated_kg_m2", "measured_kg_m2", "error"):
            quantities[f"testbody.{name}.{c.axis}"] = parameter(getattr(c, name))
        error = nominal_value(c.error)
        away = f"{100 * abs(error):.4f} % {'above' if error > 0 else 'below'}"
        differences.append(Dependent(f"{c.axis}: measured {away} the drawing", f"testbody.error.{c.axis}"))

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
