"""What every command of the product does alike: exit codes, one-line errors, JSON for scripts.

Whatever goes wrong on purpose ends in one line on the error output and the matching exit code; with `--json`
the last line of the output is one JSON object either way.
"""

import json
import os
import sys
import traceback
from collections.abc import Callable, Sequence
from typing import Annotated, Any

import typer

from companion.exit_codes import ExitCode

Result = dict[str, Any]

AsJson = Annotated[bool, typer.Option("--json", help="End the output with one JSON object on a line.")]


def run(app: typer.Typer, name: str, arguments: Sequence[str] | None) -> int:
    """Run one command line of an application and return the exit status.

    Args:
        app: the application.
        name: of the program, for its help.
        arguments: the command line without the program's name; the process's own by default.
    """
    # Our matrices are small: linear algebra on several threads costs more than it brings, and takes the
    # cores from those that fly. It must be said before NumPy is loaded.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        app(args=arguments, prog_name=name)
    except SystemExit as stop:
        if stop.code != 2:  # the parser's own status, for a wrong command line
            return int(stop.code or 0)
        if "--json" in (sys.argv[1:] if arguments is None else arguments):
            print(json.dumps({"error": "wrong command line", "exit": int(ExitCode.USAGE)}))
        return int(ExitCode.USAGE)
    return int(ExitCode.OK)


def conclude(body: Callable[[], tuple[Result, ExitCode]], as_json: bool) -> None:
    """Run a command's body, print its JSON result if wanted, and leave with the right status."""
    from companion.errors import CompanionError

    try:
        result, code = body()
    except KeyboardInterrupt:
        result, code = {"error": "interrupted"}, ExitCode.INTERRUPTED
        print("interrupted; what was recorded so far is kept", file=sys.stderr)
    except (CompanionError, OSError) as error:
        code = _code_of(error)
        result = {"error": _one_line(error)}
        print(result["error"], file=sys.stderr)
    except Exception as error:
        traceback.print_exc()
        code = ExitCode.INTERNAL
        result = {"error": f"internal error: {type(error).__name__}: {_one_line(error)}"}
    if as_json:
        print(json.dumps({**result, "exit": int(code)}), flush=True)
    raise typer.Exit(int(code))


def _code_of(error: Exception) -> ExitCode:
    """Return the exit status of an expected error."""
    from companion import errors
    from companion.control_socket import NotRunningError
    from companion.directories import BusyError
    from companion.yaml_tree import MissingProfileError

    codes: tuple[tuple[type[Exception], ExitCode], ...] = (
        (MissingProfileError, ExitCode.NO_INPUT),
        (errors.ProfileError, ExitCode.CONFIG),
        (errors.ModelError, ExitCode.CONFIG),
        (BusyError, ExitCode.TEMPORARY),
        (NotRunningError, ExitCode.UNAVAILABLE),
        (errors.StartError, ExitCode.UNAVAILABLE),
        (errors.ProtocolError, ExitCode.UNAVAILABLE),
        (errors.LogError, ExitCode.DATA),
        (FileNotFoundError, ExitCode.NO_INPUT),
        (PermissionError, ExitCode.CANNOT_CREATE),
        (OSError, ExitCode.IO),
    )
    return next((code for kind, code in codes if isinstance(error, kind)), ExitCode.INTERNAL)


def _one_line(error: BaseException) -> str:
    text = str(error)
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        text = f"{error.filename}: {error.strerror.lower()}"
    return " ".join(text.split())
