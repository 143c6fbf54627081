"""Add the app's README outside docs to the site, and what the program says itself; links keep their form on disk."""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
BESIDE = "firmware_patches/README.md"


def on_files(files: Files, /, *, config: MkDocsConfig) -> Files:
    """Add the app's README as a page."""
    files.append(File.generated(config, BESIDE, content=(ROOT / BESIDE).read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, /, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Rewrite links to the app's README, which is outside docs on disk but one folder nearer in the site."""
    return markdown.replace(f"](../../{BESIDE}", f"](../{BESIDE}")
