"""The project's folder, and the folder of the measurements outside it that tests read."""

import os
from pathlib import Path

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("CFID_DATA", ROOT.parent / "shared" / "data"))
INPUTS = Path(os.environ.get("CFID_INPUTS", ROOT.parent / "shared" / "repro" / "inputs"))
