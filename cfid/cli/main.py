"""The program `cfid` with the commands of the table; the only place where errors become exit codes."""

import os
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from cfid.cli.groups import LazyGroup
from cfid.console.messages import drop_unwritable, echo, fault, note
from cfid.console.program import CAMPAIGN, Program, options_first, running, set_program
from cfid.errors import CfidError

# Codes of errors that ask for an option which describes a foreign file; fits, which take runs, have none of them.
_ASK_FOR_OPTIONS = frozenset(
    {"no-counts-per-turn", "no-kind", "no-rows", "no-time", "no-unit", "several-columns", "time-goes-back"}
)
_TAKE_RUNS = frozenset(("fit", "tf", "show", "validate", "convert"))

app = typer.Typer(
    cls=LazyGroup,
    name="",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)


def _print_version(wanted: bool) -> None:
    from cfid.version import __version__

    if wanted:
        echo(f"cfid {__version__}")
        raise typer.Exit


@app.callback()
def cfid(
    *,
    campaign: Annotated[
        Path | None,
        typer.Option(
            *CAMPAIGN,
            metavar="DIR",
            help="Campaign folder; default: the current one or a parent.",
        ),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", help="Print all warnings and notes, not two warnings.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Ring no bell at questions and at the end.")] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="Confirm, unasked, that the vehicle is fastened; start the next step.")
    ] = False,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Measure a Crazyflie: record, identify its physical parameters, state their uncertainties.

    Start with cfid demo. These options may stand anywhere in the line.
    """
    set_program(Program(campaign=campaign, json=json, verbose=verbose, quiet=quiet, yes=yes))


def _as_sentence(message: Warning | str, category: type[Warning], *_place: object, **_more: object) -> None:
    """Print a library's warning without its source location; drop a warning that only its developers can act on."""
    if not issubclass(category, DeprecationWarning | PendingDeprecationWarning | FutureWarning | ResourceWarning):
        text = str(message).strip().partition("\n")[0].rstrip(".")
        note(f"a library that cfid uses warns: {text}.")


def main(words: Sequence[str] | None = None) -> None:
    """Run the program with its arguments, or with `words`.

    Expected errors print a sentence and set the exit code; warnings of libraries print a sentence.
    """
    # With these small matrices, threads of the linear algebra would wait for each other longer than they compute.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    given = sys.argv[1:] if words is None else words
    with warnings.catch_warnings(), running(Program()):
        warnings.showwarning = _as_sentence
        try:
            app(options_first(given), prog_name="cfid")
        except CfidError as error:
            with suppress(OSError):
                for text in getattr(error, "__notes__", ()):
                    note(text)
                asks = error.code in _ASK_FOR_OPTIONS and not _TAKE_RUNS.isdisjoint(given)
                first = " These are options of `cfid import FILE`: it makes a run, and every fit takes runs."
                fault(f"{error}{first if asks else ''}")
            sys.exit(error.exit_code)
        except OSError as error:  # an error without a file name is of stdout or stderr
            what = "the output cannot be written" if error.filename is None else str(error.filename)
            with suppress(OSError):
                fault(f"{what}: {error.strerror or error}.")
            drop_unwritable()
            sys.exit(1)
        finally:
            # If Ctrl-C interrupted code that was compiled at run time, Python ends by the signal instead of with exit
            # code 130, even if the interrupt was handled. Other such code that completes clears this state.
            exec("")


if __name__ == "__main__":
    main()
