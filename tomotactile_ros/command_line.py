"""What all programs with a command line do alike."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from typing import NoReturn


class Parser(argparse.ArgumentParser):
    """Says in one line what is wrong with a command line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message} (try --help)\n")


def end_of_pipe() -> int:
    """Exit status when the reader of standard output (`| head`) has had enough.

    What is still buffered goes nowhere, so that it does not fail once more at the very end.
    """
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 128 + signal.SIGPIPE
