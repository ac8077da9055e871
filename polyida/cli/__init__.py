"""The command line, `polyida`."""

import sys


def main():
    """Run the command line and return the exit code. Ctrl-C also ends it while it imports its modules."""
    try:
        from polyida.cli.commands import main as run

        return run()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
