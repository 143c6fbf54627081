"""A check of the peak of anonymous memory of a command on a large file."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

LIMIT_MB, SIZE_MB = 500, 400
WATCHED = """
import re, sys, threading, time
from cfid.cli.main import main
peak = 0
def watch():
    global peak
    while True:
        peak = max(peak, int(re.search(r"RssAnon:\\s+(\\d+)", open("/proc/self/status").read())[1]))
        time.sleep(0.02)
threading.Thread(target=watch, daemon=True).start()
try:
    main(sys.argv[1:])
finally:
    print("peak", peak / 1024, file=sys.stderr)
"""


def check_peak(log: Path, tmp_path: Path, words: str, *, limit_mb: float = LIMIT_MB) -> None:
    """Check and print the peak of anonymous memory of a command; {log} in `words` stands for the file."""
    subprocess.run([sys.executable, "-c", WATCHED, "new", tmp_path / "campaign"], check=True, capture_output=True)
    places = {"log": log, "out": tmp_path / "out", "campaign": tmp_path / "campaign"}
    given = [word.format(**places) for word in words.split()]
    ended = subprocess.run(
        [sys.executable, "-c", WATCHED, *given], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    shutil.rmtree(tmp_path)  # it may hold up to 1.3 GB
    peak = re.search(r"^peak (\S+)$", ended.stderr, re.MULTILINE)
    assert ended.returncode == 0, ended.stderr
    assert peak is not None
    print(f"{words.partition('{')[0]}{words.partition('}')[2]}: {float(peak[1]):.0f} MB of anonymous memory")
    assert float(peak[1]) < limit_mb
