"""The launch tests, launch_test_*.py, each by the program `launch_test` in a process of its own.

The plugin of launch_testing for pytest does the same, but knows only some versions of pytest; so it
is left out (pyproject.toml), and the tests run under all of them.
"""

import subprocess
import sys
from pathlib import Path

import pytest

for package in ("launch", "launch_ros", "launch_testing"):
    pytest.importorskip(package, reason=f"{package} comes with a full ROS 2")

FILES = sorted(Path(__file__).parent.glob("launch_test_*.py"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_launch_test(file):
    command = [sys.executable, "-m", "launch_testing.launch_test", str(file)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-10_000:] + done.stderr[-10_000:]
