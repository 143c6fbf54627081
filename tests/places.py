"""Where the project stands, and the measurements beside it that tests read in place."""

import os
from pathlib import Path

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("CFID_DATA", ROOT.parent / "shared" / "data"))
