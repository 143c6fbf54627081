"""Open a page in headless Chromium, light or dark: its requests, its console, its figures and its legibility.

This computer serves the page, together with a second page that frames it in the requested widths and examines it, so
that no library is needed to drive the browser.
"""

import html
import json
import re
import shutil
import subprocess
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

_NAMES = ("chromium", "chromium-headless-shell", "chromium-browser", "google-chrome")
BROWSER = next(filter(None, map(shutil.which, _NAMES)), None)

_LONGEST_S = 60.0
_LOOK = (Path(__file__).parent / "look_at_page.js").read_text()


@dataclass(frozen=True)
class Look:
    """The behaviour of a page: `requests` are the paths that it requested, `said` its lines on the console.

    `figures` have their natural width, shown width and place; `overflow_px` is the excess of the page's width over its
    frame; `pictures_px` is the end of the pictures of its first screen, 0 without any; `faint` are texts whose contrast
    with their background is below 4.5; `cut` are elements with wider content than themselves, all details unfolded.
    """

    requests: tuple[str, ...]
    said: tuple[str, ...]
    figures: tuple[dict[str, Any], ...]
    overflow_px: float
    background: str
    faint: tuple[str, ...]
    cut: tuple[str, ...]
    pictures_px: float


def look_at(page: str, folder: Path, *, widths_px: Sequence[int], dark: bool) -> dict[int, Look]:
    """Open a page once in frames of several widths and return a look at each; all share requests and console lines."""
    frames = "".join(f'<iframe src="/page.html" width="{width}" height="900"></iframe>' for width in widths_px)
    around = f'<style>iframe {{ border: 0 }}</style>{frames}<pre id="seen"></pre><script>{_LOOK}</script>'
    with _served({"/": around, "/page.html": page}) as (address, asked):
        command = [
            BROWSER or "", "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder / 'browser'}",
            "--enable-logging=stderr", "--virtual-time-budget=8000", f"--window-size={max(widths_px) + 50},1000",
            f"--blink-settings=preferredColorScheme={0 if dark else 1}", "--dump-dom", address,
        ]  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=_LONGEST_S)
    seen = re.search(r'<pre id="seen">(.*?)</pre>', done.stdout, re.DOTALL)
    assert seen is not None, done.stderr[-2000:]
    said = tuple(line for line in done.stderr.splitlines() if ":CONSOLE" in line)
    return {
        width: Look(
            requests=tuple(asked) + tuple(content["resources"]),
            said=said,
            figures=tuple(content["figures"]),
            overflow_px=content["overflow_px"],
            background=content["background"],
            faint=tuple(content["faint"]),
            cut=tuple(content["cut"]),
            pictures_px=content["pictures_px"],
        )
        for width, content in zip(widths_px, json.loads(html.unescape(seen[1])), strict=True)
    }


@contextmanager
def _served(pages: dict[str, str]) -> Iterator[tuple[str, list[str]]]:
    asked: list[str] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)
            known = self.path in pages
            self.send_response(200 if known else 404)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.end_headers()
            self.wfile.write(pages.get(self.path, "").encode())

        def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the name is the library's
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/", asked
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
