"""Turn a run of a six-axis load cell into the run of a device that sends lines with only some of the axes."""

import pandas as pd

from cfid.records.run import Run, read_run, write_header


def with_axes(run: Run, *axes: str) -> Run:
    """Rewrite the load-cell file of a run with only these axes, in N and N m; return the run."""
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
