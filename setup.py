"""Installs the library and its command line without ROS; with ROS, CMakeLists.txt is used.

What they are called and what they need says pyproject.toml; here is what that cannot say.
"""

from pathlib import Path

from setuptools import setup

SHARE = Path("share/tomotactile_ros")


def shared_files() -> list[tuple[str, list[str]]]:
    """Return the files under config/ and msg/, each with the folder that it is installed to."""
    files = [path for folder in ("config", "msg") for path in sorted(Path(folder).rglob("*.*"))]
    return [(str(SHARE / path.parent), [str(path)]) for path in files]


setup(data_files=shared_files())
