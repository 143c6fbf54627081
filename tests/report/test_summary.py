"""The first screen shows the measured numbers with uncertainties, the main findings, and the next step."""

from dataclasses import asdict, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest

from cfid.findings import Finding, finding, note, rejection, warning
from cfid.guide.certainty import Certainty, percent
from cfid.guide.plan import Task
from cfid.guide.status import Status, TaskStatus
from cfid.quantities.registry import Aim
from cfid.records.covariances import covariance_between
from cfid.records.parameters import Parameter, Section
from cfid.report.build import summary_of
from tests.lab import values_of

NOW = datetime(2026, 1, 1, tzinfo=UTC)
WANDERS = warning("a", "it wanders.")


def experiment(*findings: Finding, title: str = "Thrust", sources: str = "", hour: int = 0, **more: Any) -> Any:
    return {
        "name": "thrust",
        "title": title,
        "found": f"2026-01-01T{hour:02d}:00:00+00:00",
        "accepted": True,
        "findings": [asdict(each) for each in findings],
        "sources": [{"path": source, "sha256": source} for source in sources],
        **more,
    }


def section(**parameters: Parameter) -> Section:
    named = {key.replace("__", "."): value for key, value in parameters.items()}
    return Section(method="default", found=NOW, cfid_version="", accepted=True, sources=(), parameters=named)


def summary(*sections: Section, experiments: tuple[Any, ...] = (), stds: tuple[float, ...] = ()) -> dict[str, Any]:
    found = tuple(
        Certainty(key=f"number {i}", aim=Aim(0.03, "a purpose"), std=std, mostly="gain") for i, std in enumerate(stds)
    )
    task = Task(section="thrust", recordings=(), fit=("fit", "thrust"), aims=())
    status = TaskStatus(task=task, lacking=(), state="not fitted", reason="recorded.", found=found)
    values = values_of({str(i): each for i, each in enumerate(sections)})
    return summary_of(values, experiments, Status(tasks=(status,)))


def numbers(found: Section) -> dict[str, tuple[str, str]]:
    return {number["title"]: (number["value"], number["std"]) for number in summary(found)["numbers"]}


def test_numbers_are_in_plain_units_with_their_relative_uncertainty() -> None:
    inertia = [[16.42e-6, 0, 0], [0, 16.9e-6, 0], [0, 0, 28.9e-6]]
    shown = numbers(
        section(
            motor__max_thrust_n=Parameter(value=0.1683, std=0.0011),
            inertia__matrix_kg_m2=Parameter(value=inertia, std=[[2.4e-8] * 3] * 3),
            arm_m=Parameter(value=0.05, std=0.001),
            motor__torque_poly=Parameter(value=[0.006, 1e-5], std=[0.0001, 1e-6]),
            motor__speed_poly=Parameter(value=[0.04, 400.0], std=[0.0, 2.0]),
            drag__simple_kg_per_rad=Parameter(value=[-8.5e-7, -8e-7, -9e-7], std=[2.6e-8] * 3),
            friction__viscous_nms_per_rad=Parameter(value=1.6e-6, std=5.3e-6),
        )
    )

    assert shown["Mass"] == ("28.000 ± 0.030 g", "0.11 %")
    assert shown["Arm"] == ("50.0 ± 1.0 mm", "2 %")  # the value set by hand, not that of rig.toml
    assert shown["Largest thrust of one motor"] == ("168.3 ± 1.1 mN", "0.65 %")
    assert shown["Inertia about x"][0] == "(16.420 ± 0.024)·10⁻⁶ kg m²"
    assert shown["Torque over thrust, in hover"] == ("6.00 ± 0.10 mN m/N", "1.7 %")
    assert shown["Speed at command 30000"] == ("1600.0 ± 2.0 rad/s", "0.12 %")
    assert shown["Drag along y"] == ("(-0.800 ± 0.026)·10⁻⁶ kg/rad", "3.2 %")
    assert shown["Viscous friction of the axis"][1] == "consistent with zero"
    assert "Round trip to the vehicle" not in shown
    assert (percent(3.2), percent(0.0032), percent(None)) == ("320 %", "0.32 %", "-")


def test_the_uncertainty_of_a_speed_considers_that_coefficients_move_together() -> None:
    values = {"motor.speed_poly": [0.04, 400.0]}
    together = covariance_between(values, np.outer([1e-4, -3.0], [1e-4, -3.0]))  # the line turns about command 30000
    line = section(motor__speed_poly=Parameter(value=[0.04, 400.0], std=[1e-4, 3.0]))

    assert numbers(replace(line, covariance=together))["Speed at command 30000"] == ("1600 rad/s", "")


@pytest.mark.parametrize(
    ("stds", "weakest"),
    [
        ((), ""),
        ((0.01, 0.02), "number 1 is known to 2 % (mostly by the gain), enough for a purpose (3 %)."),
        ((0.06, 0.01), "number 0 is known to 6 % (mostly by the gain), not enough for a purpose (3 %)."),
    ],
)
def test_the_weakest_number_is_that_furthest_from_its_aim(stds: tuple[float, ...], weakest: str) -> None:
    assert summary(stds=stds)["weakest"] == weakest


def test_rejections_come_first_then_warnings_on_results_each_sentence_once() -> None:
    lost = [
        finding("samples-not-taken", samples=f"{n} samples were", achieved="99 %").at(f"run {n}") for n in range(2, 8)
    ]
    thrust = experiment(
        *lost, warning("recording", "it was cut."), WANDERS, note("b", "a detail."), finding("recording-simulated")
    )
    torque = experiment(rejection("c", "it is noise.", "x"), WANDERS, title="Torque", name="torque")

    assert summary(experiments=(thrust, torque))["findings"] == [
        "Torque: it is noise.",
        "Thrust, Torque: it wanders.",
        "Thrust: it was cut.",
        "Thrust: 6 recordings lost samples or missed some; the fits are accepted nevertheless.",
    ]
    refused = {**thrust, "accepted": False}
    assert len(summary(experiments=(refused,))["findings"]) == 5  # losses of a rejected fit are not summed up


def test_findings_of_a_fit_are_left_out_if_a_later_one_used_its_recordings_too() -> None:
    earlier = experiment(WANDERS, title="Thrust, earlier", sources="a")
    other = experiment(WANDERS, title="Thrust, another", sources="c")
    later = experiment(warning("b", "it is noisy."), sources="ab", hour=1)

    findings = summary(experiments=(later, earlier, other))["findings"]
    assert findings == ["Thrust: it is noisy.", "Thrust, another: it wanders."]


def test_to_fit_again_is_not_advised_where_a_later_fit_was_accepted() -> None:
    earlier = experiment(rejection("stale", "Fit again."), title="Thrust, earlier", sources="a")
    later = experiment(sources="b", hour=1)

    assert summary(experiments=(later, earlier))["findings"] == []
    for different in ({"accepted": False}, {"name": "torque"}):
        assert summary(experiments=({**later, **different}, earlier))["findings"] == ["Thrust, earlier: Fit again."]


def test_five_findings_are_shown_and_the_others_counted() -> None:
    seven = experiment(*(warning("a", f"it wanders {i} times.") for i in range(7)))

    content = summary(experiments=(seven,))
    assert (len(content["findings"]), content["more_findings"]) == (5, 2)
    assert summary()["more_findings"] == 0


def test_the_next_step_is_that_of_the_guide_and_after_the_report_the_export() -> None:
    assert summary()["next_command"] == "cfid fit thrust"
    assert summary_of(values_of({}), (), Status(tasks=()))["next_command"] == "cfid export"


def test_a_rejected_number_is_named_and_not_printed() -> None:
    found = section(motor__max_thrust_n=Parameter(value=0.1683, std=0.0011))
    rejected = numbers(replace(found, rejected={"motor.max_thrust_n": "it scatters"}))

    assert rejected["Largest thrust of one motor"] == ("rejected", "")
