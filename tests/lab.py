"""What tests have on disk and run: the project's folders, a campaign, its runs and kept fits, and commands."""

import contextlib
import io
import os
import subprocess
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from cfid.cli.main import main
from cfid.experiments import EXPERIMENTS
from cfid.findings import Severity
from cfid.records.campaign import Campaign, open_campaign
from cfid.records.files import RIG_FILE
from cfid.records.fits import Fit, keep_fit, list_fits, path_of
from cfid.records.parameters import Section
from cfid.records.rig_file import Rig, new_rig_text, thesis_rig
from cfid.records.run import DeviceRecord, Label, Run, State, read_run, write_header
from cfid.records.run_writer import create_run
from cfid.records.values import Values

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("CFID_DATA", ROOT.parent / "shared" / "data"))
INPUTS = Path(os.environ.get("CFID_INPUTS", ROOT.parent / "shared" / "repro" / "inputs"))

STARTED = datetime(2026, 11, 21, 8, tzinfo=UTC)
STARTED_S = STARTED.timestamp()

Cfid = Callable[..., subprocess.CompletedProcess[str]]


def run_cfid(arguments: Sequence[object], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a command in this process, since a new Python takes longer to start than most commands take."""
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True) for _ in range(2))
    words = [str(argument) for argument in arguments]
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.raises(SystemExit) as ended,
    ):
        main(words)
    printed = [stream.buffer.getvalue().decode() for stream in (out, err)]
    return subprocess.CompletedProcess(["cfid", *words], int(ended.value.code or 0), *printed)


def codes(result: Any, severity: Severity | None = None) -> list[str]:
    """Return the codes of the findings of a result, a recording or a --json, or of those of one severity."""
    findings = result["findings"] if isinstance(result, Mapping) else result.findings
    fields = [one if isinstance(one, Mapping) else vars(one) for one in findings]
    return [one["code"] for one in fields if severity in (None, one["severity"])]


def sentences(content: Mapping[str, Any]) -> list[str]:
    """Return the sentences of the findings in a result's --json."""
    return [finding["text"] for finding in content["findings"]]


def known(count: int | None) -> int:
    """Return a count; fail where it is unknown."""
    assert count is not None, "unknown"
    return count


# Campaigns and runs


def new_campaign(folder: Path, *changes: tuple[str, str]) -> Campaign:
    """Write a rig.toml with changes of its text, each from and to, and open the campaign."""
    text = new_rig_text()
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / RIG_FILE).write_text(text)
    return open_campaign(folder)


def made_run(
    folder: Path,
    kind: str,
    devices: Mapping[str, Mapping[str, Any]],
    *,
    facts_of: Mapping[str, Mapping[str, Any]] = {},
    state: State = "complete",
    lost: Mapping[str, int] = {},
    **more: Any,
) -> Run:
    """Write a run into the campaign's runs; each device has its columns (n,) by their names.

    `facts_of` are what devices state besides, `lost` how many samples they lost, and `more` other arguments of
    `create_run`.
    """
    records = {
        name: DeviceRecord.model_validate({"file": f"{name}.csv", "columns": tuple(columns), **facts_of.get(name, {})})
        for name, columns in devices.items()
    }
    usual: dict[str, Any] = {"label": Label(), "started": STARTED, "cfid_version": "0"}
    with create_run(folder / "runs", kind=kind, devices=records, **(usual | more)) as writer:
        for name, columns in devices.items():
            rows = tuple(columns.values())
            if len(rows[0]):
                writer.append(name, rows)
        return writer.close(state, lost=lost)


def with_axes(run: Run, *axes: str) -> Run:
    """Rewrite the load-cell file of a run with only these axes, in N and N m, as a device that sends lines gives it."""
    record = run.header.devices["loadcell"]
    facts = dict(record.model_extra or {})
    path = run.device_file("loadcell")
    counts = pd.read_csv(path)
    shown = {axis: counts[axis] / facts["counts_per_n" if axis.startswith("F") else "counts_per_nm"] for axis in axes}
    pd.DataFrame({"t": counts["t"], **shown}).to_csv(path, index=False, float_format="%.6f")
    kept = record.model_copy(update={"columns": ("t", *axes), "units": "n,nm", "asked": "lines"})
    devices = {**run.header.devices, "loadcell": kept}
    write_header(run.folder, run.header.model_copy(update={"devices": devices}))
    return read_run(run.folder)


# Kept fits and values


def keep(folder: Path, name: str, section: Section, **more: Any) -> Fit:
    """Keep a section as a campaign's next fit; `more` replaces what a fit states besides."""
    kind = EXPERIMENTS.get(name.partition(" ")[0])
    usual: dict[str, Any] = {"command": f"fit {name}", "quality": {}, "revision": 1 if kind is None else kind.revision}
    return keep_fit(folder / "fits", Fit(name=name, section=section, **(usual | more)))


def keep_instead(folder: Path, name: str, section: Section) -> Fit:
    """Keep a section as the only fit of its name."""
    for fit in list_fits(folder / "fits"):
        if isinstance(fit, Fit) and fit.name == name:
            path_of(folder / "fits", fit).unlink()
    return keep(folder, name, section)


def values_at(folder: Path) -> Values:
    """Return the values of a campaign, or those of the fits in a folder without a rig."""
    if (folder / RIG_FILE).exists():
        return open_campaign(folder).values()
    return Values((fit for fit in list_fits(folder / "fits") if isinstance(fit, Fit)), thesis_rig(), lambda _: ())


def sections_at(folder: Path) -> dict[str, Section]:
    """Return a campaign's values by the fit that they come from."""
    return values_at(folder).sections()


def values_of(sections: Mapping[str, Section], rig: Rig | None = None) -> Values:
    """Return the values of fits of these sections, of which a later one in the mapping was made later."""
    fits = [
        Fit(name=name, command=f"fit {name}", section=section, quality={}, number=number, stem=f"{number:04d}_{name}")
        for number, (name, section) in enumerate(sections.items(), start=1)
    ]
    return Values(fits, rig or thesis_rig(), lambda _: ())
