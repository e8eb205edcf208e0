"""`python -m humoslope.campaign.child PARENT VERB ...`: a verb that is stopped with the campaign that started it."""

from __future__ import annotations

import signal
import sys

from humoslope.cli import main
from humoslope.interrupts import stop_with_parent


def run(arguments: list[str]) -> int:
    """Runs a verb; its first argument is the process id of the parent."""
    stop_with_parent(int(arguments[0]), signal.SIGTERM)
    return main(arguments[1:])


if __name__ == "__main__":
    sys.exit(run(sys.argv[1:]))
