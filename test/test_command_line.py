"""What all programs with a command line do alike."""

import os
import subprocess
import sys

import pytest

from tomotactile_ros.cli import main

LOST = """
import os, signal, time
from tomotactile_ros.support.command_line import stop_like_ctrl_c

class Last:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)
        for _ in range(1000):
            pass

stop_like_ctrl_c()
try:
    Last()
    while True:
        time.sleep(1)
except KeyboardInterrupt:
    print("ended")
"""


def test_a_signal_that_comes_while_an_object_is_deleted_ends_the_program_all_the_same():
    """Python drops exceptions there."""
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(
        [sys.executable, "-c", LOST],
        check=False,
        capture_output=True,
        text=True,
        env=env,
        timeout=60,
    )
    assert done.stdout == "ended\n" and done.returncode == 0, done


@pytest.mark.parametrize(
    ("words", "meant"),
    [(["simulat"], "simulate"), (["optimize", "--method", "papr"], "paper"), (["xyz"], "")],
)
def test_a_misspelt_name_is_answered_with_the_one_that_was_probably_meant(words, meant, capsys):
    with pytest.raises(SystemExit) as ended:
        main(words)
    said = capsys.readouterr().err
    assert ended.value.code == 2 and said.count("\n") == 1
    assert (f"did you mean {meant}?" in said) if meant else ("did you mean" not in said)
