"""`cfid fleet fit`: campaigns are refitted from their recordings, wherever these are, into a separate folder."""

import contextlib
import http.server
import importlib.util
import json
import os
import pty
import re
import shutil
import signal
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from cfid.fleet.places import Arriving
from cfid.fleet.places import campaigns as campaigns_of
from cfid.fleet.refit import Refitted, refit
from cfid.fleet.results import results_in
from cfid.records.campaign import open_campaign
from cfid.records.files import RIG_FILE, sha256_of
from cfid.records.parameters import Section, plain
from cfid.records.rig_file import new_rig_text
from tests.campaigns import LONGEST_S, Once
from tests.lab import Cfid, run_cfid, sections_at
from tests.motors.stand_in_a_folder import climbed, write_run
from tests.motors.test_readings_and_resumed_runs import two_parts
from tests.processes import started

FITS = {"c1": ("friction", "testbody", "swing"), "c2": ("inertia", "swing"), "c3": ("swing",)}
OF_C1 = {"friction", "testbody", "swing x"}


@pytest.fixture(scope="session")
def campaigns(once: Once, recordings: list[Any]) -> Path:
    """Three campaigns with the same swings, drops and test body, of which commands fitted a different part in each."""

    def make(folder: Path) -> None:
        from cfid.console.campaign import make_campaign
        from tests.offline.write import write_runs

        first = folder / "c1"
        make_campaign(first)
        write_runs(open_campaign(first), recordings)
        for name in ("c2", "c3"):
            shutil.copytree(first, folder / name)
        swing = next((first / "runs").glob("*swing_x")).name
        for name, fits in FITS.items():
            for fit in fits:
                words = ["fit", fit, *([swing] if fit == "swing" else []), "--no-figures"]
                ended = run_cfid(words, folder / name)
                assert ended.returncode == 0, ended.stderr

    return once("fleet", make)


@pytest.fixture
def three(campaigns: Path, tmp_path: Path) -> Path:
    """A copy of the campaigns, for a test that changes them."""
    return Path(shutil.copytree(campaigns, tmp_path / "three"))


@pytest.fixture
def results(once: Once, campaigns: Path, tmp_path: Path) -> Path:
    """A copy of a folder of results with one campaign, for a test that continues from there."""

    def make(folder: Path) -> None:
        words = ["fleet", "fit", str(campaigns / "c3"), "--out", "results", "--jobs", "1"]
        ended = run_cfid(words, folder)
        assert ended.returncode == 0, ended.stderr

    return Path(shutil.copytree(once("refitted", make) / "results", tmp_path / "results"))


def numbers(sections: dict[str, Section]) -> dict[str, Any]:
    """Return everything that the fits found, to the last bit, without times and places."""
    return {
        name: [
            section.method,
            section.accepted,
            plain(dict(section.common)),
            plain([one.matrix for one in section.covariance]),
        ]
        + [(key, plain(one.value), plain(one.std), one.unit) for key, one in section.parameters.items()]
        for name, section in sections.items()
    }


def found_in(folder: Path) -> dict[str, Any]:
    return {each.name: numbers(sections_at(each)) for each in sorted(folder.iterdir()) if each.is_dir()}


def found_by(refitted: Refitted, folder: Path) -> dict[str, Any]:
    assert not refitted.fault
    (folder / "fits").mkdir(parents=True, exist_ok=True)
    for name, content in refitted.files.items():
        (folder / name).write_bytes(content)
    return numbers(sections_at(folder))


def hashes(folder: Path) -> dict[Path, str]:
    return {path: sha256_of(path) for path in sorted(folder.rglob("*")) if path.is_file()}


def test_refitted_campaigns_have_the_numbers_of_their_commands_and_are_unchanged(
    cfid: Cfid, campaigns: Path, tmp_path: Path
) -> None:
    before = hashes(campaigns)
    ended = cfid("fleet", "fit", campaigns / "c*", "--out", tmp_path / "out", "--jobs", 2)

    assert ended.returncode == 0, ended.stderr
    assert found_in(tmp_path / "out") == found_in(campaigns)
    assert set(sections_at(tmp_path / "out" / "c1")) == OF_C1
    assert hashes(campaigns) == before
    assert "3 of 3 campaigns" in ended.stderr
    table = " ".join(ended.stdout.split())
    assert "inertia 1 0 0 0" in table
    assert "swing x 3 0 0 0" in table


def test_refitted_campaigns_are_campaigns_with_the_dates_of_their_recordings(
    cfid: Cfid, campaigns: Path, tmp_path: Path
) -> None:
    out, tables = tmp_path / "out", {}
    cfid("fleet", "fit", campaigns / "c1", "--out", out)
    for name, folder in (("kept", campaigns / "c1"), ("made", out / "c1")):
        ended = cfid("fleet", folder, "--details", "--out", tmp_path / f"{name}.csv")
        assert ended.returncode == 0
        assert "source-" not in ended.stderr
        tables[name] = pd.read_csv(tmp_path / f"{name}.csv", parse_dates=["recorded"]).set_index("number")

    assert len(tables["made"]) > 5
    apart = (tables["made"]["recorded"] - tables["kept"]["recorded"]).abs()
    assert apart.max() < pd.Timedelta(seconds=1)
    assert cfid("parameters", "--campaign", out / "c1").returncode == 0


def test_a_cluster_finds_the_same_to_the_last_bit(cfid: Cfid, campaigns: Path, tmp_path: Path) -> None:
    dask = pytest.importorskip("dask", reason="Dask is not installed: pip install 'cfid[fleet]'")
    distributed = pytest.importorskip("distributed", reason="Dask is not installed: pip install 'cfid[fleet]'")
    patient = dask.config.set({"distributed.comm.timeouts.connect": "120s"})  # a busy machine starts workers slowly
    with patient, distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0") as cluster:
        ended = cfid(
            "fleet", "fit", campaigns / "c[13]", "--out", tmp_path / "out", "--scheduler", cluster.scheduler_address
        )

    assert ended.returncode == 0, ended.stderr
    found = found_in(campaigns)
    assert found_in(tmp_path / "out") == {"c1": found["c1"], "c3": found["c3"]}


def test_a_campaign_in_memory_is_fitted_to_the_same(campaigns: Path, tmp_path: Path) -> None:
    fsspec = pytest.importorskip("fsspec", reason="fsspec is not installed: pip install 'cfid[fleet]'")
    fsspec.filesystem("memory").put(str(campaigns / "c1"), "/lab/c1", recursive=True)
    refitted = refit("memory://lab/c1")

    assert found_by(refitted, tmp_path / "memory") == found_in(campaigns)["c1"]
    sources = sections_at(tmp_path / "memory")["friction"].sources
    assert all(source.path.startswith("memory://lab/c1/runs/") for source in sources)
    assert refit("memory://lab/c9").fault.startswith("memory://lab/c9/: cannot be read:")
    found, unmatched = campaigns_of(["memory://lab/c*", "memory://lab/d*"])
    assert found == ["memory:///lab/c1"]
    assert list(map(str, unmatched)) == ["memory://lab/d*: no folder matches."]


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: Any) -> None:
        """Print nothing."""


@pytest.fixture
def served(campaigns: Path) -> Iterator[str]:
    """The address of an HTTP server of the campaigns."""
    if not (importlib.util.find_spec("fsspec") and importlib.util.find_spec("aiohttp")):
        pytest.skip("fsspec with aiohttp is not installed: pip install 'cfid[fleet]'")
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(campaigns)))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()
    server.server_close()


def test_campaigns_of_a_server_are_fitted_to_the_same(cfid: Cfid, campaigns: Path, served: str, tmp_path: Path) -> None:
    (tmp_path / "list.txt").write_text(f"{served}/c1\n{served}/c3\n{served}/c9\n")
    ended = cfid("fleet", "fit", "--index", tmp_path / "list.txt", "--out", tmp_path / "out", "--jobs", 1)

    assert ended.returncode == 4
    assert f"{served}/c9" in ended.stderr
    found = found_in(campaigns)
    assert found_in(tmp_path / "out") == {"c1": found["c1"], "c3": found["c3"]}
    compared = cfid("fleet", tmp_path / "out" / "c*")
    assert compared.returncode == 0
    assert "source-" not in compared.stderr


def test_campaigns_that_the_folder_holds_beside_those_asked_for_are_not_counted(
    cfid: Cfid, campaigns: Path, results: Path
) -> None:
    for name in ("c1", "c3"):
        ended = cfid("fleet", "fit", campaigns / name, "--out", results, "--jobs", 1)
        assert ended.returncode == 0, ended.stderr
        assert not re.search("[2-9] of 1 campaign", ended.stderr)
    assert "done already, and kept: 1 of 1 campaign." in ended.stderr


@pytest.mark.parametrize(
    "path", ["c3/x/%2e%2e", *(pytest.param(path, marks=pytest.mark.slow) for path in ("c3/x/..", "c3/.", "c3//"))]
)
def test_a_campaign_of_a_server_is_made_in_its_temporary_folder_whatever_its_name(
    cfid: Cfid, served: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, path: str
) -> None:
    (temporary := tmp_path / "temporary").mkdir()
    (victim := tmp_path / "victim").write_text("ORIGINAL")
    (temporary / "rig.toml").symlink_to(victim)
    monkeypatch.setenv("TMPDIR", str(temporary))
    ended = cfid("fleet", "fit", f"{served}/{path}", "--out", tmp_path / "out", "--jobs", 1)

    assert ended.returncode == 0, ended.stderr
    assert victim.read_text() == "ORIGINAL"
    assert [one.name for one in temporary.iterdir()] == ["rig.toml"]


class _Endless(http.server.BaseHTTPRequestHandler):
    """A server that lists a rig.toml that never ends."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        if self.path.endswith("/"):
            self.wfile.write(b'<a href="rig.toml">rig.toml</a>')
            return
        with contextlib.suppress(OSError):  # the client ended the transfer
            while True:
                self.wfile.write(b"#" * (1 << 20))

    def log_message(self, *_: object) -> None:
        """Print nothing."""


def fault_of_campaign_at(server_of: type[http.server.BaseHTTPRequestHandler]) -> str:
    """Return why a campaign on a server cannot be refitted."""
    pytest.importorskip("aiohttp", reason="fsspec's HTTP is not installed: pip install 'cfid[fleet]'")
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), server_of) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        found = refit(f"http://127.0.0.1:{server.server_port}/c1")
        server.shutdown()
        thread.join()
    return found.fault


def test_a_file_of_a_server_that_never_ends_is_refused() -> None:
    fault = fault_of_campaign_at(_Endless)
    assert fault.endswith("/c1/rig.toml: cannot be read: it sends more than 64 MB, where a smaller file is expected.")


class _EndlessList(_Endless):
    """A server whose list of files never ends."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        with contextlib.suppress(OSError):  # the client ended the transfer
            while True:
                self.wfile.write(b'<a href="a.json">a</a>' * 50_000)


def test_a_list_of_a_server_that_never_ends_is_refused() -> None:
    fault = fault_of_campaign_at(_EndlessList)
    assert "cannot be read: it sends a list of more than 16 MB" in fault


class _FullList(_Endless):
    """A server that lists 20000 empty files in each folder."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        if self.path.endswith("/"):
            self.wfile.write(b"".join(b'<a href="%d.json">a</a>' % at for at in range(20_000)))


def test_a_folder_of_a_server_with_more_files_than_a_campaign_has_is_refused_before_they_are_fetched() -> None:
    fault = fault_of_campaign_at(_FullList)
    assert fault.endswith("20000 files in one folder (limit 2000): no campaign's is so full.")


class _Dripping(http.server.BaseHTTPRequestHandler):
    """A server that sends one byte per second, whatever the request.

    Below /head/ it lists a folder at once, and the bytes belong to the HTTP header of a file.
    """

    def do_GET(self) -> None:
        if "/head/" in self.path and self.path.endswith("/"):
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(b'<a href="rig.toml">rig.toml</a>')
            return
        with contextlib.suppress(OSError):  # the client ended the transfer
            self.wfile.write(b"HTTP/1.1 200 OK\r\nX-Long: " if "/head/" in self.path else b"HTTP/1.1 200 OK\r\n\r\n")
            while True:
                self.wfile.write(b" ")
                time.sleep(1)

    def log_message(self, *_: object) -> None:
        """Print nothing."""


@pytest.mark.slow  # it waits for two timeouts
@pytest.mark.parametrize("words", [["{}/c1"], ["{}/*"], ["--index", "{}/index.txt"], ["{}/head/c1"]])
def test_a_server_that_drips_lists_indices_or_heads_is_left(cfid: Cfid, tmp_path: Path, words: list[str]) -> None:
    pytest.importorskip("aiohttp", reason="fsspec's HTTP is not installed: pip install 'cfid[fleet]'")
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), _Dripping) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        began_s = time.monotonic()
        given = [word.format(f"http://127.0.0.1:{server.server_port}") for word in words]
        ended = cfid("fleet", "fit", *given, "--out", tmp_path / "out", "--jobs", 1)
        took_s = time.monotonic() - began_s
        server.shutdown()
        thread.join()
    assert took_s < 100
    assert ended.returncode == 4
    assert "it did not answer within 30 s" in ended.stderr or "(limit 1000 a second)" in ended.stderr


def test_a_file_that_drips_is_refused_and_a_slow_one_is_not() -> None:
    now_s = 0.0
    slow, dripping = (Arriving(1 << 26, clock=lambda: now_s) for _ in range(2))
    for _ in range(20):
        now_s += 1
        slow.relative_update(2000)
        dripping.relative_update(1)
    now_s += 1
    slow.relative_update(2000)
    with pytest.raises(ValueError, match=r"21 bytes in 21 s \(limit 1000 a second\)"):
        dripping.relative_update(1)


def test_a_fleet_goes_on_where_it_was_interrupted(campaigns: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["fleet", "fit", campaigns / "c*", "--out", out, "--jobs", 1]

    (temporary := tmp_path / "temporary").mkdir()

    def run(*, interrupt: bool) -> tuple[int, str]:
        environment = os.environ | {"TMPDIR": str(temporary)}
        with (tmp_path / "said").open("w+") as said:
            process = started(words, anew=True, cwd=tmp_path, env=environment, stdout=said, stderr=said)
            end_s = time.monotonic() + LONGEST_S
            while interrupt and time.monotonic() < end_s and not (out / "c1").exists():
                time.sleep(0.02)
            if interrupt:
                process.send_signal(signal.SIGINT)
            code = process.wait(LONGEST_S)
            return code, (tmp_path / "said").read_text()

    code, said = run(interrupt=True)
    assert code == 130, said
    assert not list(temporary.iterdir())
    assert "of 3 campaigns done; the same command goes on" in said
    kept = (out / "c1" / "parameters.toml").stat().st_mtime_ns
    code, said = run(interrupt=False)
    assert code == 0, said
    assert "done already" in said
    assert found_in(out) == found_in(campaigns)
    assert (out / "c1" / "parameters.toml").stat().st_mtime_ns == kept


def test_campaigns_of_one_name_have_folders_in_their_order_whichever_ends_first(tmp_path: Path) -> None:
    """Previously, with two processes, the folders of two vehicles were exchanged."""
    labs = [str(tmp_path / lab / "vehicle") for lab in ("a", "b", "c")]
    with results_in(tmp_path / "out", changes={}) as kept:
        kept.name(labs[:2])
        rows = [kept.keep(one, Refitted(files={}, fits=(), processor_s=0.0)) for one in reversed(labs[:2])]
    with results_in(tmp_path / "out", changes={}) as kept:
        kept.name(labs)
        rows.append(kept.keep(labs[2], Refitted(files={}, fits=(), processor_s=0.0)))

    assert [(row["campaign"], row["folder"]) for row in rows] == [
        (labs[1], "vehicle-2"), (labs[0], "vehicle"), (labs[2], "vehicle-3"),
    ]  # fmt: skip


@pytest.mark.parametrize("file", ["rig.toml", "run.toml", "fit"])
def test_a_campaign_that_changed_since_it_was_refitted_is_named(cfid: Cfid, three: Path, file: str) -> None:
    assert cfid("fleet", "fit", three / "c3", "--out", "out", "--jobs", 1).returncode == 0
    again = cfid("fleet", "fit", three / "c3", "--out", "out")
    of = {"rig.toml": "rig.toml", "run.toml": "runs/*/run.toml", "fit": "fits/*"}[file]
    path = next((three / "c3").glob(of))
    path.write_bytes(path.read_bytes() + b"\n")
    after = cfid("fleet", "fit", three / "c3", "--out", "out")

    assert "changed since" not in again.stderr
    assert after.returncode == 0
    assert "1 campaign changed since: " in after.stderr
    assert "A new folder refits them" in after.stderr


def test_a_manifest_that_a_crash_cut_is_gone_on_with(cfid: Cfid, campaigns: Path, results: Path) -> None:
    with (results / "manifest.jsonl").open("ab") as file:
        file.write(b'{"campaign": "half a ro')
    (results / ".half-cut").mkdir()
    (results / ".half-cut" / "rig.toml").write_text("cut")
    ended = cfid("fleet", "fit", campaigns / "c3", campaigns / "c1", "--out", results)

    assert ended.returncode == 0, ended.stderr
    rows = [json.loads(line) for line in (results / "manifest.jsonl").read_text().splitlines()]
    assert [row.get("folder") for row in rows] == [None, "c3", "c1"]
    assert not (results / ".half-cut").exists()
    assert found_in(results)["c1"] == found_in(campaigns)["c1"]


def test_results_of_other_settings_and_other_folders_are_not_touched(
    cfid: Cfid, campaigns: Path, results: Path, tmp_path: Path
) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    full = cfid("fleet", "fit", campaigns / "c3", "--out", tmp_path / "mine")
    other = cfid("fleet", "fit", campaigns / "c3", "--out", results, "--method", "thesis")

    assert (full.returncode, other.returncode) == (2, 2)
    assert "is not empty" in full.stderr
    assert "method as kept, now" in other.stderr


def test_another_method_takes_the_place_of_that_of_the_fits(cfid: Cfid, campaigns: Path, tmp_path: Path) -> None:
    ended = cfid("fleet", "fit", campaigns / "c3", "--out", tmp_path / "out", "--method", "thesis", "--json")

    assert sections_at(tmp_path / "out" / "c3")["swing x"].method == "thesis"
    (row,) = json.loads(ended.stdout)["campaigns"]
    assert row["fits"][0]["moved_in_std"] > 1


def test_an_option_takes_the_place_of_that_of_the_fits_that_have_it(
    cfid: Cfid, campaigns: Path, tmp_path: Path
) -> None:
    ended = cfid("fleet", "fit", campaigns / "c3", "--out", tmp_path / "out", "--set", "peaks=5", "--set", "order=3")
    (file,) = (tmp_path / "out" / "c3" / "fits").glob("*swing*.json")
    other = cfid("fleet", "fit", campaigns / "c3", "--out", tmp_path / "out", "--set", "peaks=6")
    unknown = cfid("fleet", "fit", campaigns / "c3", "--out", tmp_path / "new", "--set", "peak=5")
    nothing = cfid("fleet", "fit", campaigns / "c3", "--out", tmp_path / "new", "--set", "peaks")

    assert ended.returncode == 0
    assert json.loads(file.read_text())["options"] == {"peaks": "5"}
    assert other.returncode == unknown.returncode == nothing.returncode == 2
    assert "set peaks 5, now" in " ".join(other.stderr.split())
    assert "no fit has an option peak." in unknown.stderr
    assert "expected NAME=VALUE" in nothing.stderr


OPTIONS = {
    "swing": {"from_s": 0.75, "to_s": 14.2, "mass_kg": "0.0301:0.0001", "min_angle_deg": 3.0},
    "friction": {"radius_mm": "2.05:0.01", "gravity_mps2": "9.8123:0.0001"},
}


@pytest.fixture
def fitted_with_options(once: Once, campaigns: Path, tmp_path: Path) -> Path:
    """A campaign whose last fits of a swing and of friction were made with options."""

    def make(folder: Path) -> None:
        campaign = Path(shutil.copytree(campaigns / "c1", folder / "c1"))
        swing = next((campaign / "runs").glob("*swing_x")).name
        for words in (
            f"swing {swing} --from 0.75 --to 14.2 --mass-kg 0.0301:0.0001 --min-angle-deg 3",
            "friction --radius-mm 2.05:0.01 --gravity-mps2 9.8123:0.0001",
        ):
            ended = run_cfid(["fit", *words.split(), "--no-figures"], campaign)
            assert ended.returncode == 0, ended.stderr

    return Path(shutil.copytree(once("fitted with options", make) / "c1", tmp_path / "options" / "c1"))


def last_fit(folder: Path, name: str) -> Path:
    return max((folder / "fits").glob(f"*{name}*.json"), key=lambda path: path.stat().st_mtime_ns)


def test_a_fit_with_options_is_repeated_with_them_to_the_last_bit(
    cfid: Cfid, fitted_with_options: Path, tmp_path: Path
) -> None:
    ended = cfid("fleet", "fit", fitted_with_options, "--out", tmp_path / "out", "--jobs", 1)

    assert ended.returncode == 0, ended.stderr
    kept, made = (numbers(sections_at(one)) for one in (fitted_with_options, tmp_path / "out/c1"))
    assert made == kept
    for folder in (fitted_with_options, tmp_path / "out" / "c1"):
        assert {name: json.loads(last_fit(folder, name).read_text())["options"] for name in OPTIONS} == OPTIONS


def test_labels_that_were_typed_are_repeated_and_those_of_other_runs_refused(three: Path, tmp_path: Path) -> None:
    campaign = three / "c1"
    drops = sorted(path.name for path in (campaign / "runs").glob("*drop*"))
    words = [f"{drop.rpartition('_')[2].removesuffix('g')}:0.2={drop}" for drop in drops]
    ended = run_cfid(["fit", "friction", *words, "--no-figures"], campaign)
    assert ended.returncode == 0, ended.stderr
    kept = numbers(sections_at(campaign))
    file = last_fit(campaign, "friction")
    content = json.loads(file.read_text())

    assert content["options"] == {"labels": words}
    assert found_by(refit(str(campaign)), tmp_path / "made")["friction"] == kept["friction"]

    file.write_text(json.dumps(content | {"options": {"labels": ["20:0.2=another"]}}))
    (fault,) = [fit.fault for fit in refit(str(campaign)).fits if fit.name == "friction"]
    assert fault == "20:0.2=another was typed, which is none of its runs: fit it by hand."


def test_a_fit_that_states_no_options_is_named(fitted_with_options: Path) -> None:
    file = last_fit(fitted_with_options, "friction")
    file.write_text(json.dumps(json.loads(file.read_text()) | {"options": None}))
    (fault,) = [fit.fault for fit in refit(str(fitted_with_options)).fits if fit.name == "friction"]
    assert "was made in Python" in fault


def test_a_map_is_verified_again_by_all_parts_of_its_scales(tmp_path: Path) -> None:
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    steps = tuple(range(0, 64001, 8000))
    write_run(tmp_path, climbed(steps), steps=steps, motors=(1, 3), hold_s=2.0, rest_s=1.0)
    _, second = two_parts(tmp_path)
    words = ["fit", "thrust", "--verify", second.folder.name, "--no-figures"]
    ended = run_cfid(words, tmp_path)
    assert ended.returncode == 0, ended.stderr
    file = last_fit(tmp_path, "thrust")
    content = json.loads(file.read_text())

    assert content["options"] == {"verify": [second.folder.name]}
    (made,) = [path for path in refit(str(tmp_path)).files.items() if path[0].startswith("fits/")]
    assert "verification: 5 readings" in made[1].decode()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("from_s", "soon"),
        ("out", "/tmp"),
        *(pytest.param(*one, marks=pytest.mark.slow) for one in (("run", "x"), ("colour", 1))),
    ],
)
def test_an_option_that_its_command_does_not_take_is_named(name: str, value: object, fitted_with_options: Path) -> None:
    file = last_fit(fitted_with_options, "swing")
    content = json.loads(file.read_text())
    file.write_text(json.dumps(content | {"options": {name: value}}))
    (fault,) = [fit.fault for fit in refit(str(fitted_with_options)).fits if fit.name == "swing x"]

    assert fault == f"its option {name} = {value!r} is none that this command takes: fit it by hand."


def test_campaigns_that_cannot_be_read_do_not_stop_the_others(cfid: Cfid, three: Path, tmp_path: Path) -> None:
    shutil.rmtree(three / "c1" / "fits")
    (three / "c2" / "rig.toml").write_text("no [rig")
    ended = cfid("fleet", "fit", three / "c*", "--out", tmp_path / "out", "--jobs", 1)

    assert ended.returncode == 4
    assert "2 of 3 campaigns not refitted" in ended.stderr
    assert "holds no fit that could be repeated" in ended.stderr
    assert "were not made" not in ended.stderr
    assert list(found_in(tmp_path / "out")) == ["c3"]


def test_every_campaign_that_was_not_refitted_is_named_however_many(
    cfid: Cfid, campaigns: Path, tmp_path: Path
) -> None:
    for number in range(15):
        shutil.copytree(campaigns / "c3", tmp_path / f"n{number}", ignore=shutil.ignore_patterns("fits", "runs"))
    ended = cfid("fleet", "fit", "n*", campaigns / "c3", "--out", tmp_path / "out", "--jobs", 1)

    assert ended.returncode == 4
    assert all(f"{tmp_path / f'n{number}'}/fits: holds no fit" in ended.stderr for number in range(15))
    assert "more, which the manifest names" not in ended.stderr


@pytest.mark.parametrize(
    "where",
    [
        "a full disk",
        *(
            pytest.param(where, marks=pytest.mark.slow)
            for where in ("a terminal that hung up", "a pipe without a reader")
        ),
    ],
)
def test_a_fleet_goes_on_without_its_progress_where_stderr_takes_nothing(
    campaigns: Path, tmp_path: Path, where: str
) -> None:
    if where == "a full disk":
        stderr = os.open("/dev/full", os.O_WRONLY)
    else:
        far, stderr = pty.openpty() if where == "a terminal that hung up" else os.pipe()
        os.close(far)
    words = ["fleet", "fit", campaigns / "c*", "--out", "out", "--jobs", 1]
    with (tmp_path / "said").open("w") as said:
        code = started(words, anew=True, cwd=tmp_path, stdout=said, stderr=stderr).wait(LONGEST_S)
    os.close(stderr)

    assert code == 0
    assert found_in(tmp_path / "out") == found_in(campaigns)
    assert "inertia 1 0 0 0" in " ".join((tmp_path / "said").read_text().split())


def test_a_fit_that_cannot_be_repeated_is_named(cfid: Cfid, three: Path, tmp_path: Path) -> None:
    kept = next((three / "c1" / "fits").glob("*friction*"))
    content = json.loads(kept.read_text())
    content["section"]["sources"][0]["path"] = "/elsewhere/drop.csv"
    kept.write_text(json.dumps(content))
    fault = "1 fit of out was not made:\n  c1: friction: was made from /elsewhere/drop.csv, which is no run of the"
    (tmp_path / "unread").mkdir()
    beside = cfid("fleet", "fit", three / "c1", "unread", "--out", "out", "--jobs", 1)
    ended = cfid("fleet", "fit", three / "c1", "--out", "out")

    assert beside.returncode == 4
    assert "1 of 2 campaigns not refitted" in beside.stderr
    assert fault in " ".join(beside.stderr.split(" "))
    assert ended.returncode == 5
    assert fault in ended.stderr
    assert set(sections_at(tmp_path / "out" / "c1")) == OF_C1 - {"friction"}


def test_runs_that_were_excluded_since_are_left_out(cfid: Cfid, three: Path, tmp_path: Path) -> None:
    drops = open_campaign(three / "c1").runs(kind="drop")
    cfid("runs", "exclude", drops[0].folder.name, "--campaign", three / "c1")
    ended = cfid("fleet", "fit", three / "c1", "--out", tmp_path / "out", "--json")

    (row,) = json.loads(ended.stdout)["campaigns"]
    (fit,) = [fit for fit in row["fits"] if fit["name"] == "friction"]
    assert fit["text"] == f"left out, since excluded: {drops[0].folder.name}."
    sources = sections_at(tmp_path / "out" / "c1")["friction"].sources
    assert len(sources) == len(drops) - 1


def test_a_folder_that_is_named_fit_is_a_campaign_with_its_path(cfid: Cfid, three: Path) -> None:
    (three / "c3").rename(three / "fit")

    assert cfid("fleet", "./fit", folder=three).returncode == 0
    assert "Missing option '--out'" in cfid("fleet", "fit", folder=three).stderr


def test_a_link_planted_where_a_campaign_is_made_is_not_followed(
    cfid: Cfid, campaigns: Path, results: Path, tmp_path: Path
) -> None:
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / "rig.toml").write_text("ORIGINAL")
    for name in (".c1.half", ".half-c1"):
        (results / name).symlink_to(victim)
    ended = cfid("fleet", "fit", campaigns / "c1", "--out", results)

    assert ended.returncode == 0, ended.stderr
    assert (victim / "rig.toml").read_text() == "ORIGINAL"
    assert sorted(victim.iterdir()) == [victim / "rig.toml"]
    assert (results / "c1").is_dir()
    assert not (results / "c1").is_symlink()


def test_a_row_that_is_none_of_a_manifest_is_refused_with_its_line(cfid: Cfid, campaigns: Path, results: Path) -> None:
    manifest = results / "manifest.jsonl"
    rows = manifest.read_text()
    usual = {"campaign": "c", "folder": "c", "processor_s": 1, "fits": []}
    for wrong in (
        {"campaign": "c"},
        usual | {"campaign": 1.5},
        usual | {"folder": "../c"},
        usual | {"fits": None},
        usual | {"fits": [{"name": "swing"}]},
        usual | {"fits": [7]},
    ):
        manifest.write_text(rows + json.dumps(wrong) + "\n")
        ended = cfid("fleet", "fit", campaigns / "c3", "--out", manifest.parent)
        assert ended.returncode == 4
        assert "manifest.jsonl:3: is no row of a manifest" in ended.stderr


def test_a_manifest_of_other_spacing_is_gone_on_with(cfid: Cfid, campaigns: Path, results: Path) -> None:
    manifest = results / "manifest.jsonl"
    rows = [json.loads(line) for line in manifest.read_text().splitlines()]
    manifest.write_text("".join(json.dumps(row, separators=(",", ":")) + "\n" for row in rows))
    for _ in range(2):
        ended = cfid("fleet", "fit", campaigns / "c3", "--out", results)
        assert ended.returncode == 0, ended.stderr
        assert b"\0" not in manifest.read_bytes()


@pytest.mark.parametrize("word", ["a\0b", f"{'x' * 300}*", "x" * 300])
def test_a_name_that_no_folder_has_ends_in_a_sentence(cfid: Cfid, tmp_path: Path, word: str) -> None:
    (tmp_path / "index.txt").write_text(f"{word}\n")
    for command in (("fleet",), ("fleet", "fit", "--out", tmp_path / "out")):
        ended = cfid(*command, "--index", tmp_path / "index.txt")
        assert ended.returncode in (2, 4), ended.stderr
        assert "Traceback" not in ended.stderr


def test_a_folder_of_results_that_a_glob_matches_too_is_no_campaign(cfid: Cfid, three: Path) -> None:
    for name in ("c1", "c2"):
        shutil.rmtree(three / name)
    for _ in range(2):
        ended = cfid("fleet", "fit", "*", "--out", "refitted", folder=three)
        assert ended.returncode == 0, ended.stderr


def test_a_fit_whose_name_was_edited_is_repeated_by_its_command(three: Path) -> None:
    path = next((three / "c3" / "fits").glob("*.json"))
    path.write_text(path.read_text().replace('"name": "swing x"', '"name": "renamed"'))
    found = refit(str(three / "c3"))
    assert [(one.name, one.fault) for one in found.fits] == [("renamed", "")]


@pytest.mark.parametrize(("value", "std"), [(0.0, 1e-320), pytest.param(1e308, 1e-3, marks=pytest.mark.slow)])
def test_a_number_that_moved_beyond_comparison_is_noted_and_stops_nothing(
    cfid: Cfid, three: Path, tmp_path: Path, value: float, std: float
) -> None:
    path = next((three / "c3" / "fits").glob("*swing*.json"))
    content = json.loads(path.read_text())
    kept = content["section"]["parameters"]["swing.natural_frequency_squared_s2"]
    kept["value"], kept["std"] = value, std
    path.write_text(json.dumps(content))
    ended = cfid("fleet", "fit", three / "c3", three / "c1", "--out", tmp_path / "out", "--jobs", 1, "--json")

    assert ended.returncode == 0, ended.stderr
    first, other = json.loads(ended.stdout)["campaigns"]
    (fit,) = first["fits"]
    assert (fit["moved_in_std"], fit["done"], other["folder"]) == (1e9, True, "c1")
    assert fit["text"] == "moved by 1e+09 of the kept std or more: swing.natural_frequency_squared_s2."


def test_a_campaign_whose_name_is_too_long_for_a_folder_is_kept_under_its_beginning(tmp_path: Path) -> None:
    made = Refitted(files={"rig.toml": b""}, fits=(), processor_s=0.0)
    with results_in(tmp_path / "out", changes={}) as results:
        places = [f"https://lab.example/{'x' * 300}{i}" for i in range(2)]
        results.name(places)
        rows = [results.keep(place, made) for place in places]

    assert [row["folder"] for row in rows] == ["x" * 200, f"{'x' * 200}-2"]
    assert all((tmp_path / "out" / row["folder"] / "rig.toml").exists() for row in rows)
