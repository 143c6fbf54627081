"""The page in a real browser while a simulated rig records: curves move, motors stop, other pages control nothing."""

import fcntl
import re
import signal
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass

import pytest

from tests.flying_in_a_folder import Bench, Pilot, bench_in
from tests.report.chromium import BROWSER
from tests.rig_in_a_folder import wait_until
from tests.watch.browser import Browser, Page, browser_in
from tests.watch.test_stop import PLOTS, RECORDED, ask

pytestmark = [
    pytest.mark.usefixtures("in_time"),
    pytest.mark.skipif(BROWSER is None, reason="needs Chromium to look at the page with"),
]

NOTE = "<script>document.title='taken'</script> & more"

# The newest time that is drawn of a column, and the text of the facts.
DRAWN = """(() => { for (const m of window.Bokeh?.documents[0]?._all_models.values() ?? [])
  if (m.type === 'ColumnDataSource' && 'Fx' in m.data) return m.data.t[m.data.t.length - 1] ?? 0; return 0 })()"""
FACTS = "document.getElementById('facts').textContent"
CELLS = "[...document.querySelectorAll('#facts td')].map(cell => cell.textContent).join('\\n')"
RIGHTMOST = """(() => { let most = 0; const look = root => { for (const e of root.querySelectorAll('*')) {
  const box = e.getBoundingClientRect(); if (['CANVAS', 'TD', 'BUTTON'].includes(e.tagName) && box.width)
    most = Math.max(most, box.right); if (e.shadowRoot) look(e.shadowRoot) } };
  look(document); return most })()"""


@dataclass
class Show:
    """A recording with turning motors, `cfid watch` next to it, and a browser."""

    bench: Bench
    recorder: Pilot
    watcher: Pilot
    browser: Browser

    @property
    def address(self) -> str:
        found = re.search(r"http://127\.0\.0\.1:\d+/", self.watcher.err)
        assert found is not None, self.watcher.err
        return found[0]

    @property
    def port(self) -> int:
        return int(self.address.rpartition(":")[2].strip("/"))

    def open(self, **how: object) -> Page:
        page = self.browser.open(self.address, **how)  # type: ignore[arg-type]
        page.wait_for(f"{DRAWN} > 0")
        return page

    def asked(self, method: str, path: str, **headers: str) -> int:
        """Return the status of the answer to a program."""
        return ask(self.port, method, path, **headers)[0]


@pytest.fixture(scope="module")
def one_browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Draw one page at a time, since browsers in parallel keep each other's rigs from the processor."""
    with (tmp_path_factory.getbasetemp().parent / "browser.lock").open("w") as turn:
        fcntl.flock(turn, fcntl.LOCK_EX)
        yield


@pytest.fixture(scope="module")
def opened_show(tmp_path_factory: pytest.TempPathFactory, one_browser: None, in_time: None) -> Iterator[Show]:
    folder = tmp_path_factory.mktemp("show")
    with ExitStack() as opened:
        # Stock firmware keeps its motors running when the program that drives them hangs.
        bench = opened.enter_context(bench_in(folder, crazyflie={"firmware": "stock"}))
        browser = opened.enter_context(browser_in(tmp_path_factory.mktemp("browser")))
        recorder = recording_on(bench)
        watcher = bench.start("watch")
        bench.wait_until(lambda: "http://" in watcher.err or watcher.process.poll() is not None, watcher)
        show = Show(bench, recorder, watcher, browser)
        yield show
        show.recorder.send(signal.SIGCONT, signal.SIGINT)
        show.recorder.end()
        watcher.send(signal.SIGINT)
        assert watcher.end() == 0, watcher.err
        assert "Traceback" not in watcher.err


@pytest.fixture
def show(opened_show: Show) -> Show:
    """Start a new recording if the previous one ended because a busy computer kept a device waiting."""
    if opened_show.recorder.process.poll() is not None:
        opened_show.recorder = recording_on(opened_show.bench)
    return opened_show


def recording_on(bench: Bench) -> Pilot:
    recorder = bench.start(*RECORDED, "--note", NOTE)
    recorder.wait_until_motors_run()
    return recorder


def test_curves_move_for_two_viewers_and_after_a_reload_and_nothing_comes_from_elsewhere(show: Show) -> None:
    page, other = show.open(), show.open(width_px=400, dark=True)
    for viewer in (page, other, page):
        drawn_s = viewer.value(DRAWN)
        viewer.wait_for(f"{DRAWN} > {drawn_s} + 1")
    page.value("window.before = true")
    page.reload()
    page.wait_for(f"!window.before && {DRAWN} > {drawn_s} + 1")

    allowed = (show.address, show.address.replace("http", "ws"), "data:", "blob:")
    for viewer in (page, other):
        assert [address for address in viewer.requests if not address.startswith(allowed)] == []
        assert viewer.said == []
        assert viewer.value("document.title") == "cfid watch"
        assert NOTE in viewer.value(CELLS)
    shown = page.value(CELLS)
    assert re.search(r"recording\n\d:\d\d min, \d:\d\d min left\n\d\.\d\d V\nready|flying", shown), shown
    assert re.search(r"\d+ of 700 Hz, \d+ rows, 0 lost", shown), shown
    assert other.value("getComputedStyle(document.body).backgroundColor") == "rgb(20, 23, 27)"
    for viewer, width_px in ((page, 1280), (other, 400)):
        assert viewer.value("document.documentElement.scrollWidth") <= width_px
        assert 0 < viewer.value(RIGHTMOST) <= width_px
    page.close()
    other.close()


def test_no_other_page_stops_the_motors(show: Show) -> None:
    page = show.open()
    token = page.value("document.getElementById('stop').dataset.token")
    own = show.address.rstrip("/")
    elsewhere = "http://evil.example"
    asked = [
        show.asked("POST", "/stop", Origin=own),
        show.asked("POST", "/stop", Origin=elsewhere, X_Cfid_Token=token),
        show.asked("POST", "/stop", Host=f"evil.example:{show.port}", Origin=own, X_Cfid_Token=token),
        show.asked("GET", "/", Host=f"evil.example:{show.port}"),
        show.asked("GET", PLOTS, Sec_Fetch_Site="cross-site"),
        show.asked("GET", "/plots/ws", Origin=elsewhere, Upgrade="websocket", Connection="Upgrade"),
        show.asked("GET", "/facts"),
    ]
    assert asked == [403] * len(asked)
    assert show.asked("GET", "/stop", X_Cfid_Token=token) == 404
    assert any(show.bench.motors), show.recorder.err
    page.wait_for(f"{FACTS}.includes('{len(asked)} from outside this page')")
    assert page.value("document.getElementById('answered').textContent") == ""
    page.close()


def test_the_button_stops_the_motors_of_a_recorder_that_hangs(show: Show) -> None:
    page = show.open()
    show.recorder.send(signal.SIGSTOP)
    assert any(show.bench.motors), show.recorder.err
    page.click("#stop")
    wait_until(lambda: not any(show.bench.motors), "the motors' stop")
    said = page.wait_for(
        "(said => /confirmed|NOT/.test(said) && said)(document.getElementById('answered').textContent)"
    )
    assert re.search(r"motors stopped, confirmed in \d+ ms", said)
    page.close()
