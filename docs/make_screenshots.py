"""Photograph the pages of cfid for the docs: `python -m docs.make_screenshots cfid-demo/report.html`.

The pictures show `cfid watch` during a staircase on the simulated rig, light and dark, wide and narrow, and the top of
a report if one is given. The script needs Chromium. Pictures have 48 colours, which keeps files small and letters
sharp.
"""

import io
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

from tests.flying_in_a_folder import bench_in
from tests.priority import ahead_of_others
from tests.watch.browser import Browser, Page, browser_in

DOCS = Path(__file__).parent
REPORT, REPORT_PX = DOCS / "report.png", (960, 1080)
WATCH_PX = {"wide": (1280, 860), "narrow": (400, 860)}
STAIRCASE = ("--from", 20000, "--to", 40000, "--step", 5000, "--hold", 6, "--rest", 2, "--motor", "1,3")
LARGEST_BYTES = 150_000


def main(report: Path | None) -> None:
    """Write all pictures; the picture of a report only if a report is given."""
    with tempfile.TemporaryDirectory() as folder, browser_in(Path(folder) / "browser") as browser:
        if report is not None:
            width_px, height_px = REPORT_PX
            page = browser.open(report.resolve().as_uri(), width_px=width_px, height_px=height_px)
            page.wait_for("document.readyState === 'complete'")
            save(page, REPORT)
        with ahead_of_others():
            watch(browser, Path(folder))


def watch(browser: Browser, folder: Path) -> None:
    """Record a staircase, open its page after some steps, and photograph it."""
    with bench_in(folder) as bench:
        recorder = bench.start("log", "thrust", *STAIRCASE, "--yes")
        recorder.wait_until_motors_run(16.0)
        watcher = bench.start("watch")
        bench.wait_until(lambda: "http://" in watcher.err, watcher)
        for width, (width_px, height_px) in WATCH_PX.items():
            for scheme in ("light", "dark"):
                page = browser.open(
                    watcher.err.split()[0], width_px=width_px, height_px=height_px, dark=scheme == "dark"
                )
                page.wait_for("window.Bokeh?.documents[0]?.get_model_by_name('time')?.end > 1")
                page.value(
                    "[...Bokeh.documents[0]._all_models.values()].find(m => m.type === 'RadioButtonGroup').active = 1"
                )
                time.sleep(3)
                save(page, DOCS / "how-to" / "figures" / f"watch_{width}_{scheme}.png")


def save(page: Page, path: Path) -> None:
    """Save a picture of a page, and close the page."""
    with Image.open(io.BytesIO(page.picture())) as picture:
        picture.convert("RGB").quantize(48, dither=Image.Dither.NONE).save(path, optimize=True)
    page.close()
    assert path.stat().st_size < LARGEST_BYTES, f"{path} is too large for a page of the docs"


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
