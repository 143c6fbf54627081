"""Draw docs/how-to/watch.png: `cfid watch` beside a staircase on the simulated rig. `python -m docs.make_screenshots`.

Needs Chromium. Colours are cut to 48, which keeps the file small and letters sharp.
"""

import io
import tempfile
import time
from pathlib import Path

from PIL import Image

from tests.flying_in_a_folder import bench_in
from tests.priority import ahead_of_others
from tests.watch.browser import browser_in

PICTURE = Path(__file__).parent / "how-to" / "watch.png"
WIDTH_PX, HEIGHT_PX = 1280, 800
STAIRCASE = ("--from", 20000, "--to", 40000, "--step", 5000, "--hold", 6, "--rest", 2, "--motor", "1,3")


def main() -> None:
    """Record a staircase, open its page after some steps, and write the picture."""
    with (
        tempfile.TemporaryDirectory() as folder,
        ahead_of_others(),
        bench_in(Path(folder)) as bench,
        browser_in(Path(folder) / "browser") as browser,
    ):
        recorder = bench.start("log", "thrust", *STAIRCASE, "--yes")
        recorder.wait_until_motors_run(16.0)
        watcher = bench.start("watch")
        bench.wait_until(lambda: "http://" in watcher.err, watcher)
        page = browser.open(watcher.err.split()[0], width_px=WIDTH_PX, height_px=HEIGHT_PX)
        page.wait_for("window.Bokeh?.documents[0]?.get_model_by_name('time')?.tags.length")
        page.value("[...Bokeh.documents[0]._all_models.values()].find(m => m.type === 'RadioButtonGroup').active = 1")
        time.sleep(3)
        with Image.open(io.BytesIO(page.picture())) as picture:
            picture.convert("RGB").quantize(48, dither=Image.Dither.NONE).save(PICTURE, optimize=True)


if __name__ == "__main__":
    main()
