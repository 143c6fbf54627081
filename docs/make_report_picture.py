"""Draw docs/report.png, the top of the demo's report: `python docs/make_report_picture.py cfid-demo/report.html`.

Needs chromium. Colours are cut to 48, which keeps the file small and letters sharp.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

PICTURE = Path(__file__).parent / "report.png"
WIDTH_PX, HEIGHT_PX = 960, 1080


def main(report: Path) -> None:
    """Open a report, take its top, and write the picture."""
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
    with tempfile.TemporaryDirectory() as folder:
        taken = Path(folder) / "taken.png"
        command = [
            browser, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={folder}",
            "--blink-settings=preferredColorScheme=1", f"--window-size={WIDTH_PX},{HEIGHT_PX}",
            f"--screenshot={taken}", report.resolve().as_uri(),
        ]  # fmt: skip
        subprocess.run(command, check=True, capture_output=True, timeout=60)
        with Image.open(taken) as picture:
            picture.convert("RGB").quantize(48, dither=Image.Dither.NONE).save(PICTURE, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
