"""The first screen says what was measured and how sure, what matters, and what comes next."""

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from cfid.findings import note, rejection, warning
from cfid.guide.plan import Aim, Task
from cfid.guide.status import Certainty, TaskStatus
from cfid.records.parameters import Parameter, Section
from cfid.records.rig_file import thesis_rig
from cfid.report.experiments import Experiment
from cfid.report.known import Known
from cfid.report.summary import FirstScreen, summary_of

NOW = datetime(2026, 1, 1, tzinfo=UTC)
EXPERIMENT = Experiment(
    name="thrust", title="Thrust", command="fit thrust", method="default", found=NOW, cfid_version="", accepted=True,
    findings=(), parameters=(), tables=(), lines=(), figures=(), notes=(), sources=(),
)  # fmt: skip


def section(**parameters: Parameter) -> Section:
    named = {key.replace("__", "."): value for key, value in parameters.items()}
    return Section(method="default", found=NOW, cfid_version="", accepted=True, sources=(), parameters=named)


def summary(*sections: Section, experiments: tuple[Experiment, ...] = (), stds: tuple[float, ...] = ()) -> FirstScreen:
    known = Known(thesis_rig(), {str(i): one for i, one in enumerate(sections)})
    found = tuple(
        Certainty(aim=Aim(key=f"number {i}", std=0.03, purpose="a purpose: 3 %"), std=std) for i, std in enumerate(stds)
    )
    task = Task(section="thrust", recordings=(), fit=("fit", "thrust"), aims=())
    status = TaskStatus(task=task, lacking=(), state="not fitted", reason="recorded.", found=found)
    return summary_of(known, experiments, [status])


def test_numbers_are_in_plain_units_with_their_relative_uncertainty() -> None:
    most = Parameter(value=0.1683, std=0.0011, unit="N")
    inertia = [[16.42e-6, 0, 0], [0, 16.9e-6, 0], [0, 0, 28.9e-6]]
    matrix = Parameter(value=inertia, std=[[2.4e-8] * 3] * 3, unit="kg m^2")
    numbers = {
        one.title: one for one in summary(section(motor__max_thrust_n=most, inertia__matrix_kg_m2=matrix)).numbers
    }

    assert numbers["Mass"].value == "28.000 ± 0.030 g"
    assert (numbers["Largest thrust of one motor"].value, numbers["Largest thrust of one motor"].std) == (
        "168.3 ± 1.1 mN",
        "0.65 %",
    )
    assert numbers["Inertia about x"].value == "(16.420 ± 0.024)·10⁻⁶ kg m²"
    assert "Round trip to the vehicle" not in numbers


def test_a_rejected_number_is_named_and_not_printed() -> None:
    found = section(motor__max_thrust_n=Parameter(value=0.1683, std=0.0011, unit="N"))
    shown = summary(replace(found, rejected={"motor.max_thrust_n": "it scatters"})).numbers

    assert [one.value for one in shown if "thrust" in one.title] == ["rejected"]


@pytest.mark.parametrize(("stds", "told"), [((), ""), ((0.01, 0.02), "enough for"), ((0.01, 0.06), "too little for")])
def test_the_weakest_number_is_that_furthest_from_what_it_is_for(stds: tuple[float, ...], told: str) -> None:
    weakest = summary(stds=stds).weakest

    assert told in weakest
    assert weakest.startswith("number 1" if stds else "")


def test_rejections_come_before_warnings_each_sentence_once_and_notes_stay_below() -> None:
    warned = replace(EXPERIMENT, findings=(warning("a", "it wanders."), note("b", "a detail.")))
    rejected = replace(
        EXPERIMENT, title="Torque", findings=(rejection("c", "it is noise.", "x"), warning("a", "it wanders."))
    )
    simulated = replace(EXPERIMENT, findings=(warning("recording", "a run: recorded on the simulated rig."),))

    assert summary(experiments=(warned, rejected, simulated)).findings == (
        "Torque: it is noise.",
        "Thrust, Torque: it wanders.",
    )


def test_five_findings_are_shown_and_the_others_counted() -> None:
    seven = replace(EXPERIMENT, findings=tuple(warning("a", f"it wanders {i} times.") for i in range(7)))
    shown, none = summary(experiments=(seven,)), summary()

    assert (len(shown.findings), shown.more_findings) == (5, 2)
    assert none.more_findings == 0


def test_what_comes_next_is_the_guides_own_answer(tmp_path: Path) -> None:
    assert summary().next_command == "cfid fit thrust"
