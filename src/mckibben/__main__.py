"""Entry point of the command line, also as `python -m mckibben`."""

import gc
import signal


def run() -> None:
    """Run the command line."""
    gc.set_threshold(1_000_000, 10, 10)  # most commands create fewer objects, nearly all of them permanent
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # during imports Ctrl-C ends the process, without a traceback
    from mckibben.cli import main

    try:
        main()
    finally:
        gc.freeze()


if __name__ == "__main__":
    run()
