"""Start-up time: `cfid --help` and the help of a command, against a bare typer program, in turns."""

import statistics
import subprocess
import sys
import time

RUNS = 15

BARE = """
import typer
app = typer.Typer(rich_markup_mode=None)
@app.command()
def one(): 'One.'
@app.command()
def two(): 'Two.'
app()
"""


def seconds(*command: str) -> float:
    begin = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - begin


def compare(words: str, bare_words: str) -> None:
    ours, theirs = [], []
    for _ in range(RUNS):
        ours.append(seconds(sys.executable, "-m", "cfid.cli.main", *words.split()))
        theirs.append(seconds(sys.executable, "-c", BARE, *bare_words.split()))
    ratio = statistics.median(a / b for a, b in zip(ours, theirs, strict=True))
    print(f"cfid {words:20} {1e3 * statistics.median(ours):7.1f} ms (median of {RUNS})")
    print(f"bare typer                {1e3 * statistics.median(theirs):7.1f} ms")
    print(f"ratio                     {ratio:7.2f}  (goal: at most 1.5)")


def main() -> None:
    compare("--help", "--help")
    compare("fit drag --help", "one --help")


if __name__ == "__main__":
    main()
