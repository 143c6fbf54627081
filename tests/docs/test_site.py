"""The pages build as a site: every link and every anchor leads somewhere, every page is in the navigation."""

import re
import subprocess
import sys
from pathlib import Path

from tests.lab import ROOT


def test_the_site_builds_strictly_and_loads_nothing_from_elsewhere(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet"]
    command += ["--config-file", str(ROOT / "docs/site/mkdocs.yml"), "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)

    assert done.returncode == 0, done.stderr
    pages = list((tmp_path / "site").rglob("*.html"))
    assert len(pages) > 40
    for page in pages:
        assert not re.findall(r"<(?:script|link|img)[^>]*(?:src|href)=.https?:", page.read_text(encoding="utf-8"))
