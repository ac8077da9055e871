"""Where the command begins: what it imports may be interrupted, too."""

import sys


def main():
    """Run the command line; returns the exit code."""
    try:
        from polyida.cli.main import main as run

        return run()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
