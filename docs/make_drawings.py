"""Draw the rig for the how-to pages: `python docs/make_drawings.py`."""

import tempfile
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
from cfid.drawing.rig import load_cell_figure, mounts_figure
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import load_rig, new_rig_text

mpl.rcParams.update({"svg.hashsalt": "cfid", "svg.fonttype": "none"})  # equal drawings give equal files
FOLDER = Path(__file__).parent / "how-to" / "figures"


def main() -> None:
    """Draw the mounts, the load cell and the wind of a new rig.toml."""
    FOLDER.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / RIG_FILE
        path.write_text(new_rig_text(), encoding="utf-8")
        rig = load_rig(path)
    drawn = {
        "mounts": mounts_figure(rig.mounts, rig.vehicle.body_frame),
        "load_cell": load_cell_figure(rig.loadcell.yaw_deg or 0.0),
        "wind": load_cell_figure(rig.wind.yaw_deg or 0.0, azimuth_deg=rig.wind.azimuth_deg, angles_deg=[48.4]),
    }
    for name, page in drawn.items():
        page.savefig(FOLDER / f"{name}.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
