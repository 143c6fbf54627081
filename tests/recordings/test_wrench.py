"""Forces and torques of a run or of a table: in N and N m, or refused with the line and the option to give."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import tomli_w

from cfid.errors import CfidError, DataError
from cfid.recordings.read import read_recording
from cfid.recordings.recording import How
from cfid.recordings.wrench import AXES, WrenchRecord, wrench_of
from cfid.records.run import Label
from tests.lab import made_run

HEAD = "t,Fx,Fy,Fz,Tx,Ty,Tz"
IN_SI = "t_s,Fx (N),Fy (N),Fz (N),Tx (N m),Ty (N m),Tz (N m)"
COUNTED = How(units={"Fz": "counts"})
ROWS = 200
EPOCH_S = 1_763_712_345.0
TIME_S = np.arange(ROWS) / 1000
COUNTS = np.random.default_rng(3).integers(-2_000_000, 2_000_000, (ROWS, 6))
FACTS = {"counts_per_n": 5e5, "counts_per_nm": 4e6, "settings": {"product": "Net F/T"}}
LOAD = np.array([0.047, -0.09, -0.49, 1.1e-4, -2.2e-4, 5e-5])  # N and N m
LBF_N, INCH_M = 4.4482216152605, 0.0254


def text_of(values: npt.NDArray[Any] = COUNTS, head: str = HEAD) -> str:
    rows = (",".join([f"{t:.6f}", *map(str, row)]) for t, row in zip(TIME_S.tolist(), values.tolist(), strict=True))
    return "\n".join([*([head] if head else []), *rows, ""])


def read(folder: Path, text: str, how: How | None = None) -> WrenchRecord:
    (folder / "fts.csv").write_text(text)
    return wrench_of(read_recording(folder / "fts.csv", how), how)


def refusal(folder: Path, text: str, how: How | None = None) -> CfidError:
    with pytest.raises(CfidError) as caught:
        read(folder, text, how)
    return caught.value


def codes(record: WrenchRecord) -> set[str]:
    return {finding.code for finding in record.findings}


def recorded(
    folder: Path, facts: dict[str, Any] = FACTS, *, status: npt.ArrayLike = 0, lost: int = 0, simulated: bool = False
) -> Path:
    """Write a run of a load cell, which fails where samples are lost."""
    words = np.broadcast_to(np.asarray(status, dtype=np.uint32), ROWS)
    columns = {"t": EPOCH_S + TIME_S, **dict(zip(AXES, COUNTS.T, strict=True)), "status": words}
    return made_run(
        folder,
        "loadcell",
        {"loadcell": columns},
        facts_of={"loadcell": facts},
        state="failed" if lost else "complete",
        lost={"loadcell": lost},
        label=Label(note="one motor"),
        simulated=simulated,
    ).folder


def of_run(folder: Path) -> WrenchRecord:
    return wrench_of(read_recording(folder))


# Runs


def test_a_run_is_read_with_the_scales_of_its_box(tmp_path: Path) -> None:
    folder = recorded(tmp_path)
    record = of_run(folder)
    assert record.force_n == pytest.approx(COUNTS[:, :3] / 5e5)
    assert record.torque_nm == pytest.approx(COUNTS[:, 3:] / 4e6)
    assert record.time_s == pytest.approx(TIME_S, abs=1e-6)
    assert record.begin_s == EPOCH_S
    assert record.status is not None
    assert not record.status.any()
    assert (record.name, record.run, record.label.note) == (folder.name, folder.name, "one motor")
    assert (record.lost, record.notes) == (0, ())


@pytest.mark.parametrize(
    ("facts", "expected"),
    [
        ({"counts_per_nm": 1e6}, "devices.loadcell.counts_per_n is missing"),
        (FACTS | {"counts_per_n": 0}, "devices.loadcell.counts_per_n: should be greater than 0, not 0"),
        (FACTS | {"gaps": [{"from_s": 1.0}]}, "devices.loadcell.gaps.0.to_s is missing"),
    ],
)
def test_a_run_without_a_scale_or_with_an_invalid_one_is_refused_by_key(
    tmp_path: Path, facts: dict[str, Any], expected: str
) -> None:
    folder = recorded(tmp_path, facts)
    with pytest.raises(DataError) as caught:
        of_run(folder)
    assert str(caught.value).startswith(f"{folder / 'run.toml'}: {expected}")


def test_losses_and_gaps_of_a_run_are_reported(tmp_path: Path) -> None:
    gaps = [{"from_s": EPOCH_S, "to_s": EPOCH_S + 1.5, "reason": "the stream broke off"}] * 2
    record = of_run(recorded(tmp_path, FACTS | {"gaps": gaps}, lost=40, simulated=True))
    assert record.lost == 40
    texts = " ".join(record.notes)
    for what in ("failed", "40 samples were lost", "simulated rig", "no samples for 3.0 s in 2 gaps"):
        assert what in texts


@pytest.mark.parametrize(("product", "expected"), [("Net F/T", "broken"), ("Axia80", "broken gage")])
def test_status_words_are_counted_and_explained_by_the_family_of_the_box(
    tmp_path: Path, product: str, expected: str
) -> None:
    status = np.where(np.isin(np.arange(ROWS), (70, 71)), 1 << 31 | 1 << 2, 0)
    record = of_run(recorded(tmp_path, FACTS | {"settings": {"product": product}}, status=status))
    assert record.status is not None
    assert record.status.tolist() == status.tolist()
    (finding,) = [one for one in record.findings if one.code == "force-status"]
    assert "2 of 200 samples" in finding.text
    assert "line 72" in finding.text
    assert (expected in finding.text) == (product == "Axia80")


def test_a_run_without_a_load_cell_or_without_an_axis_is_refused(tmp_path: Path) -> None:
    folder = recorded(tmp_path)
    file = folder / "loadcell.csv"
    file.write_text(file.read_text().replace("Ty,Tz", "a,b", 1))
    with pytest.raises(DataError, match="no column 'Ty'"):
        of_run(folder)
    toml = tomllib.loads((folder / "run.toml").read_text())
    toml["devices"]["scales"] = toml["devices"].pop("loadcell")
    (folder / "run.toml").write_bytes(tomli_w.dumps(toml).encode())
    with pytest.raises(DataError, match="holds no loadcell recording; its devices: scales"):
        of_run(folder)


# Tables of other programs


def test_forces_without_a_unit_are_asked_about_and_not_taken_for_counts(tmp_path: Path) -> None:
    """Previously, 5 N were read as 5e-06 N."""
    values = np.full((ROWS, 6), 5)
    asked = refusal(tmp_path, text_of(values))
    assert asked.code == "no-unit"
    assert "`unit` Fx=N or Fx=counts" in str(asked)
    given = read(tmp_path, text_of(values), How(units={"Fz": "N", "Tx": "Nm"}))
    assert set(given.force_n.ravel()) == set(given.torque_nm.ravel()) == {5.0}
    assert codes(given) == set()


def test_counts_are_of_the_usual_scale_with_a_finding_or_of_one_that_is_given(tmp_path: Path) -> None:
    record = read(tmp_path, text_of(), COUNTED)
    assert record.force_n == pytest.approx(COUNTS[:, :3] / 1e6)
    assert record.torque_nm == pytest.approx(COUNTS[:, 3:] / 1e6)
    assert codes(record) == {"force-scale-assumed"}
    assert (record.status, record.lost, record.run, record.name) == (None, None, None, "fts")
    given = read(tmp_path, text_of(), How(units={"Fz": "counts"}, counts_per_n=1e3, counts_per_nm=1e2))
    assert given.force_n == pytest.approx(COUNTS[:, :3] / 1e3)
    assert given.torque_nm == pytest.approx(COUNTS[:, 3:] / 1e2)
    assert codes(given) == set()


@pytest.mark.parametrize(
    ("head", "newtons", "newton_metres"),
    [
        (IN_SI, 1.0, 1.0),
        ("t,fx_mn,fy_mn,fz_mn,tx_nm,ty_nm,tz_nm", 1e-3, 1.0),
        ("t,Fx_lbf,Fy_lbf,Fz_lbf,Tx (lbf-in),Ty (lbf-in),Tz (lbf-in)", LBF_N, LBF_N * INCH_M),
        ("t,Fx (kgf),Fy,Fz,Tx (N·mm),Ty,Tz", 9.80665, 1e-3),
    ],
)
def test_forces_are_read_in_the_units_of_their_header(
    tmp_path: Path, head: str, newtons: float, newton_metres: float
) -> None:
    record = read(tmp_path, text_of(COUNTS / 1e4, head))
    assert record.force_n == pytest.approx(COUNTS[:, :3] / 1e4 * newtons, rel=1e-12)
    assert record.torque_nm == pytest.approx(COUNTS[:, 3:] / 1e4 * newton_metres, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "how", "code"),
    [
        (text_of(head=HEAD.replace("Tx", "Tx_counts").replace("Tz", "Tz_nm")), None, "mixed-units"),
        (text_of(COUNTS / 1e6, IN_SI.replace("Fx (N)", "Fx (dyn)")), None, "other-unit"),
        (text_of(COUNTS, IN_SI), None, "impossible-force"),
        (text_of(COUNTS / 1e6, IN_SI), How(counts_per_n=1e6), "unused"),
        (text_of(head="t,Fx,Fy,Fz,Tx,Ty,Fz_counts"), COUNTED, "no-column"),
        (text_of(head="when,Fx,Fy,Fz,Tx,Ty,Tz"), COUNTED, "no-time"),
        (text_of()[:400], COUNTED, "few-rows"),
        (text_of(np.hstack([COUNTS, np.full((ROWS, 1), -1)]), f"{HEAD},status"), COUNTED, "no-status-word"),
    ],
)
def test_a_table_that_leaves_a_choice_or_cannot_be_is_refused(
    tmp_path: Path, text: str, how: How | None, code: str
) -> None:
    assert refusal(tmp_path, text, how).code == code


def test_a_table_with_some_axes_is_of_these_axes(tmp_path: Path) -> None:
    record = read(tmp_path, text_of(COUNTS / 1e6, "t,a,b,Fz_n,c,d,Tz_nm"))
    assert record.axes == ("Fz", "Tz")
    assert np.isnan(record.force_n[:, :2]).all()
    assert record.values_of("Fz") == pytest.approx(COUNTS[:, 2] / 1e6)
    with pytest.raises(DataError, match="measured Fz, Tz alone, and drag needs Fx, Fy"):
        record.require("Fx", "Fy", "Fz", purpose="drag")


# What ATI's demo program writes


def described(force: str, torque: str, per_force: object, per_torque: object, counts: Any) -> str:
    """Return 500 rows at 500 Hz with a noise of one count, as the manual of the box (9620-05, table 5.1) shows them."""
    rows = np.rint(counts + np.random.default_rng(2).normal(0, 1, (500, 6))).astype(int)
    head = [
        "Start Time: 3/15/21 3:04 PM",
        "RDT Sample Rate: 500",
        '"PLEASE NOTE: The sample rate is read from the Net F/T when the program starts."',
        f"Force Units: {force}",
        f"Counts per Unit Force: {per_force}",
        f"Torque Units: {torque}",
        f"Counts per Unit Torque: {per_torque}",
        "Status (hex), RDT Sequence, F/T Sequence, Fx, Fy, Fz, Tx, Ty, Tz, Time",
    ]
    lines = [
        ",".join(f'"{value}"' for value in ("0", at + 1, 5000000 + at, *row, "Mar 15, 2021 3:04:05 PM"))
        for at, row in enumerate(rows.tolist())
    ]
    return "\r\n".join([*head, *lines, ""])


@pytest.mark.parametrize(
    ("units", "newtons", "newton_metres"),
    [(("N", "Nmm"), 1.0, 1e-3), (("lbf", "lbf-in"), LBF_N, LBF_N * INCH_M)],
)
def test_a_file_of_atis_demo_is_read_by_the_units_the_scale_and_the_rate_that_it_states(
    tmp_path: Path, units: tuple[str, str], newtons: float, newton_metres: float
) -> None:
    unit, per_unit = np.repeat([newtons, newton_metres], 3), np.repeat([1e5, 1e6], 3)
    record = read(tmp_path, described(*units, 100000.0, 1000000.0, LOAD / unit * per_unit))
    load = np.hstack([record.force_n, record.torque_nm]).mean(axis=0)
    np.testing.assert_allclose(load, LOAD, rtol=0, atol=0.2 * float(np.max(unit / per_unit)))
    assert record.time_s[1] == pytest.approx(0.002, rel=1e-9)
    assert "forces-described" in codes(record)


@pytest.mark.parametrize(
    ("stated", "option"),
    [
        (("stone", "Nm", 1000.0, 1000.0), "counts_per_n"),
        (("N", "Nm", "n/a", 1000.0), "counts_per_n"),
        (("N", "Nm", 1000.0, 0), "counts_per_nm"),
    ],
)
def test_a_unit_or_scale_of_atis_demo_that_is_not_known_is_a_question_that_an_option_answers(
    tmp_path: Path, stated: tuple[str, str, object, object], option: str
) -> None:
    text = described(*stated, 1000 * np.arange(1, 7))
    assert f"give `{option}`." in str(refusal(tmp_path, text))
    record = read(tmp_path, text, How(counts_per_n=1000, counts_per_nm=2000, rate_hz=100))
    np.testing.assert_allclose(record.force_n.mean(axis=0), [1, 2, 3], atol=1e-3)
    np.testing.assert_allclose(record.torque_nm.mean(axis=0), [2, 2.5, 3], atol=1e-3)
    assert record.time_s[1] == pytest.approx(0.01)
