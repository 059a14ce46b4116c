"""The command line as a program: `pretouch`, or `python -m pretouch`."""

from pretouch.interrupts import end_at_once_when_interrupted


def main() -> None:
    """Runs the command line; an interrupt while it loads ends it like any other."""
    end_at_once_when_interrupted()
    from pretouch.cli import main as run

    run()


if __name__ == "__main__":
    main()
