"""`cfid fit testbody`: the test body measured against its drawing."""

import math
from typing import TYPE_CHECKING

from cfid.console.inputs import Workplace, open_workplace
from cfid.console.options import (
    Delivery,
    GravityMps2,
    MassKg,
    Method,
    ReadingOptions,
    RigOptions,
    Swings,
    WindowOptions,
    flat,
)
from cfid.console.outcome import deliver
from cfid.console.selection import chosen, labelled
from cfid.findings import note, rejection, warning
from cfid.findings import rejected as rejected_among
from cfid.records.result import Result
from cfid.swing.data import FIXTURE, check_mounts, read_swings

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.figure import Figure

    from cfid.findings import Finding
    from cfid.inertia.swings import SwingSet
    from cfid.inertia.testbody import Comparison

UNLIKELY_STD = 4.0
ANOTHER_STD = 20.0  # no calliper is that wrong


@flat
def testbody(
    *,
    runs: Swings = None,
    window: WindowOptions,
    rig: RigOptions,
    reading: ReadingOptions,
    delivery: Delivery,
    mass_kg: MassKg = None,
    gravity_mps2: GravityMps2 = None,
    method: Method = "default",
) -> None:
    r"""Compare the test body's measured inertias with those of its drawing (table 2.5).

    AXIS is a mount of \[testbody.mounts]; cuboids and mass are \[testbody] of rig.toml.

    Example: [bold]cfid fit testbody x=tb_x.csv z=tb_z.csv --time-unit us[/bold]
    """
    from cfid.inertia.swings import measure_all
    from cfid.inertia.testbody import compare
    from cfid.swing.axis_inertias import AxisInertias
    from cfid.swing.geometry import described_test_body, surroundings, swung

    workplace = open_workplace(rig, gravity_mps2=gravity_mps2)
    suits = labelled("swing", "testbody", FIXTURE)
    words = chosen(runs, workplace.campaign, suits=suits, wanted="swings of the test body")
    items = read_swings(words, reading.reading(), workplace, body="testbody")
    body = described_test_body(workplace, mass_kg)
    check_mounts((item.name for item in items if item.name != FIXTURE), body.mounts, table="testbody.mounts")
    swings = measure_all(items, window, method)
    axis_inertias = AxisInertias(swings.mounted, swung(body), surroundings(workplace, swings.fixture))
    deliver(_outcome(compare(body, axis_inertias), swings, workplace, method), delivery, workplace.campaign)


def _outcome(comparisons: "list[Comparison]", swings: "SwingSet", workplace: Workplace, method: str) -> Result:
    from cfid.records.parameters import Parameter

    parameters: dict[str, Parameter] = {}
    for c in comparisons:
        calculated = Parameter(value=c.calculated_kg_m2, std=c.calculated_std_kg_m2 or None, unit="kg m^2")
        measured = Parameter(value=c.measured_kg_m2, std=c.measured_std_kg_m2 or None, unit="kg m^2")
        parameters[f"testbody.calculated_kg_m2.{c.axis}"] = calculated
        parameters[f"testbody.measured_kg_m2.{c.axis}"] = measured
        parameters[f"testbody.error.{c.axis}"] = Parameter(value=c.error, std=c.error_std or None, unit="1")

    def drawings() -> "dict[str, Figure]":
        from cfid.inertia.figures import testbody_figure

        return {"testbody": testbody_figure(comparisons)}

    findings = (
        *(note("thesis-geometry", text) for text in workplace.notes),
        *swings.findings(_resting_on),
        *_differences(comparisons),
    )
    rejected = rejected_among(findings, parameters)
    return Result(
        command="fit testbody",
        method=method,
        quantities=parameters,
        quality={"swings": swings.quality, "deviations": {c.axis: c.deviations for c in comparisons}},
        wanted=("testbody.error.*",),
        findings=findings,
        sources=swings.sources,
        lines=(
            *swings.lines,
            *(
                f"{c.axis}: measured {100 * (c.measured_kg_m2 / c.calculated_kg_m2 - 1):+.4f} % off the drawing"
                for c in comparisons
                if f"testbody.error.{c.axis}" not in rejected
            ),
        ),
        drawings=drawings,
        folder=workplace.figures_beside(swings.files),
    )


def _resting_on(mount: str) -> tuple[str, ...]:
    """Return the quantities that rest on the swing about a mount; all measured ones rest on that of the fixture."""
    axis = "*" if mount == FIXTURE else mount
    return f"testbody.measured_kg_m2.{axis}", f"testbody.error.{axis}"


def _differences(comparisons: "list[Comparison]") -> "Iterator[Finding]":
    """Yield what is to be said of swings that differ from the drawing."""
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
