"""Start of the `gauge` command: Ctrl-C ends it with one line, also while the command is being imported."""

import gc
import os

EXIT_INTERRUPTED = 130

NEW_OBJECTS = 200_000
"""New objects after which Python looks for cycles, in place of 700: imports make many that stay, and each look at them
is in vain."""


def main() -> None:
    """Run the `gauge` command."""
    gc.set_threshold(NEW_OBJECTS)
    try:
        import signal

        if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
            signal.signal(signal.SIGINT, _end)
        from gauge_envs.cli.app import main as run_command
    except KeyboardInterrupt:  # It came before the handler was there.
        _end()
    try:
        run_command()
    finally:
        # Python would look for cycles among all objects before it ends: a fifth of the time of a short command.
        gc.freeze()


def _end(*_: object) -> None:
    """End the process at once. Unlike an exception, this also works while a library in C is being imported."""
    os.write(2, b"interrupted\n")
    os._exit(EXIT_INTERRUPTED)


if __name__ == "__main__":
    main()
