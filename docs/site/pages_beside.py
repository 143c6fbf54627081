"""Add to the site the app's README outside docs, and what the program says itself; links keep their form on disk."""

import runpy
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
BESIDE = "firmware_patches/README.md"
TEXTS = runpy.run_path(str(ROOT / "docs/make_reference.py"))["TEXTS"]


def on_files(files: Files, /, *, config: MkDocsConfig) -> Files:
    """Add the app's README and the page of commands."""
    files.append(File.generated(config, BESIDE, content=(ROOT / BESIDE).read_text(encoding="utf-8")))
    files.append(File.generated(config, "reference/commands.md", content=TEXTS["commands"]()))
    return files


def on_page_markdown(markdown: str, /, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Fill the generated tables, and rewrite links to the app's README, which is one folder nearer in the site."""
    for name, text in TEXTS.items():
        if f"<!-- {name} -->" in markdown:
            markdown = markdown.replace(f"<!-- {name} -->", text())
    return markdown.replace(f"](../../{BESIDE}", f"](../{BESIDE}")
