"""Command line: parse, call, print. Heavy imports are inside the commands."""

from __future__ import annotations

import errno
import io
import os
import signal
import sys
import warnings
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Annotated, Any

import typer
from typer import Option

from mckibben.cli.calibrate import calibrate
from mckibben.cli.check import check
from mckibben.cli.command import plain_command
from mckibben.cli.export import export
from mckibben.cli.help import Command, Commands
from mckibben.cli.identify import catalog, identify, validate
from mckibben.cli.joint import envelope, margins, simulate, size, stiffness
from mckibben.cli.new import new
from mckibben.cli.options import INTERRUPTED, echo, job_progress, on_command_line, text_width
from mckibben.cli.points import plan, points
from mckibben.cli.rig import rig
from mckibben.cli.robot import robot
from mckibben.cli.studies import compare, sweep, tune
from mckibben.errors import McKibbenError, McKibbenWarning, ParameterError, printable
from mckibben.storage.files import make_folder
from mckibben.version import __version__

_LONGEST_REASON = 1000  # characters of a foreign exception

app = typer.Typer(
    cls=Commands,
    name="mckibben",
    help="Pneumatic artificial muscles, from the test rig to a controlled joint.",
    epilog="Exit codes: 0 done, 1 failed, 2 bad input.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)


@plain_command
def reproduce(out: Path = Path("mckibben-report"), quick: bool = False) -> None:
    """Reproduce the paper: test, identification, knee and control, with a report and figures.

    Parameters
    ----------
    out : DIR
        Folder of the report.
    quick
        Fewer repeats, seeds and tuning steps.
    """
    make_folder(out)  # fails before the computation

    with job_progress() as report:
        assert report is not None
        from mckibben.paper import reproduce as run

        done = run(quick=quick, progress=lambda what, fraction: report(what, 0.8 * fraction))
        report("writing results", 0.8)
        done.save(out, force=True)  # before the figures
        from mckibben.paper.page import write_report

        report("figures and report", 0.85)
        page = write_report(done, out)
        report("done", 1.0)
    echo(done.to_text(width=text_width()))
    echo(f"{done.seconds:.0f} s; evidence and figures in {page}, all numbers in {out / 'results.json'}")


@plain_command
def web(
    port: Annotated[int, Option(min=1, max=65535, help="Port of the address.")] = 8080, no_browser: bool = False
) -> None:
    """Serve a page on this machine: identify a muscle, design a joint, run it.

    Parameters
    ----------
    no_browser
        Do not open a browser.
    """
    try:
        import nicegui  # noqa: F401
    except ImportError as error:
        raise ParameterError("NiceGUI is not installed", remedy="install it: pip install 'mckibben[web]'") from error
    from mckibben.web.app import start

    start(port, show=not no_browser, ready=lambda address: echo(f"{address} (Ctrl-C ends it)"))


_PANELS = {
    "The paper": (reproduce,),
    "A file to start from": (new,),
    "Muscles, data and test rig": (points, identify, validate, plan, catalog, rig),
    "Joint, robot and control": (size, simulate, envelope, stiffness, margins, calibrate, robot),
    "Studies": (tune, compare, sweep),
    "Other programs": (web, export, check),
}
for _panel, _commands in _PANELS.items():
    for _command in _commands:
        if isinstance(_command, typer.Typer):
            app.add_typer(_command, rich_help_panel=_panel)
        else:
            app.command(cls=Command, rich_help_panel=_panel)(_command)


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, Option("--version", help="Print the version.")] = False,
    extension: Annotated[
        list[str] | None,
        Option(metavar="FILE.py|MODULE", help="File or module with user-defined classes, which is run; repeatable."),
    ] = None,
) -> None:
    if version:
        echo(f"mckibben {__version__}")
        raise typer.Exit
    for name in extension or ():
        from mckibben.component.extensions import load_extension

        load_extension(name)


def main() -> None:
    """Run the command line: exit code 2 with a message for bad input, 1 for other failures, 130 after Ctrl-C."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # for names outside the terminal's encoding
    warnings.showwarning = _show_warning
    if signal.getsignal(signal.SIGINT) in (signal.SIG_DFL, signal.default_int_handler):
        signal.signal(signal.SIGINT, _interrupt)
    sys.exit(_run())


def _run() -> int:
    """Exit code of the command."""
    stdout = sys.stdout
    try:
        try:
            app(prog_name="mckibben")
        except SystemExit as end:
            if sys.stdout is not stdout:  # as typer does after EPIPE
                raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE)) from None
            stdout.flush()
            return end.code if isinstance(end.code, int) else 0
    except KeyboardInterrupt:
        return INTERRUPTED
    except McKibbenError as error:
        return _failed(f"error: {on_command_line(str(error))}", 2)
    except OSError as error:
        if error.filename is None and error.errno in (errno.EPIPE, errno.ENOSPC, errno.EIO):
            reader_has_gone = error.errno == errno.EPIPE
            sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115, PTH123 (the rest is not retried)
            return 0 if reader_has_gone else _failed(f"failed: the output is incomplete: {error.strerror}", 1)
        return _failed(f"error: {error}", 1 if error.errno in (errno.ENOSPC, errno.EIO) else 2)
    except Exception as error:
        if os.environ.get("MCKIBBEN_DEBUG"):
            raise
        advice = "Please report it, with the output of the same command under MCKIBBEN_DEBUG=1."
        reason = printable(str(error), _LONGEST_REASON)
        return _failed(f"failed: {type(error).__name__}: {reason}\nThis is a fault of mckibben. {advice}", 1)
    return 0


def _failed(text: str, code: int) -> int:
    with suppress(OSError):
        echo(text, err=True)
    return code


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Raise `KeyboardInterrupt`; during an import, end the process: compiled modules crash if theirs is interrupted."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            os._exit(INTERRUPTED)
        frame = frame.f_back
    raise KeyboardInterrupt


def _show_warning(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    if issubclass(category, McKibbenWarning):
        echo(f"warning: {on_command_line(str(message))}", err=True)
