"""Photograph the page of `cfid watch` during a staircase on the simulated rig: `python -m docs.make_screenshot`.

The script needs Chromium. The picture has 48 colours, which keeps the file small and letters sharp.
"""

import io
import tempfile
import time
from pathlib import Path

from PIL import Image

from tests.flying_in_a_folder import bench_in
from tests.priority import ahead_of_others
from tests.watch.browser import Browser, browser_in

PICTURE = Path(__file__).parent / "how-to" / "figures" / "watch.png"
WIDTH_PX, HEIGHT_PX = 1280, 860
STAIRCASE = ("--from", 20000, "--to", 40000, "--step", 5000, "--hold", 6, "--rest", 2, "--motor", "1,3")


def photograph(browser: Browser, folder: Path) -> bytes:
    """Record a staircase in a folder, open its page after some steps, and return a picture of it."""
    with bench_in(folder) as bench:
        recorder = bench.start("log", "thrust", *STAIRCASE, "--yes")
        recorder.wait_until_motors_run(16.0)
        watcher = bench.start("watch")
        bench.wait_until(lambda: "http://" in watcher.err, watcher)
        page = browser.open(watcher.err.split()[0], width_px=WIDTH_PX, height_px=HEIGHT_PX)
        page.wait_for("window.Bokeh?.documents[0]?.get_model_by_name('time')?.end > 1")
        page.value("[...Bokeh.documents[0]._all_models.values()].find(m => m.type === 'RadioButtonGroup').active = 1")
        time.sleep(3)
        picture = page.picture()
        page.close()
        return picture


def main() -> None:
    """Write the picture."""
    with (
        tempfile.TemporaryDirectory() as folder,
        browser_in(Path(folder) / "browser") as browser,
        ahead_of_others(),
        Image.open(io.BytesIO(photograph(browser, Path(folder)))) as picture,
    ):
        picture.convert("RGB").quantize(48, dither=Image.Dither.NONE).save(PICTURE, optimize=True)


if __name__ == "__main__":
    main()
