"""Installs the library and its command line without ROS; with ROS, CMakeLists.txt is used."""

from pathlib import Path

from setuptools import find_packages, setup

SHARE = Path("share/tomotactile_ros")


def shared_files() -> list[tuple[str, list[str]]]:
    """Return the files under config/ and msg/, each with the folder that it is installed to."""
    files = [path for folder in ("config", "msg") for path in sorted(Path(folder).rglob("*.*"))]
    return [(str(SHARE / path.parent), [str(path)]) for path in files]


setup(
    name="tomotactile_ros",
    version="0.1.0",
    description="Large-area tactile sensing by electrical tomography",
    long_description=Path("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    packages=find_packages(include=["tomotactile_ros*"], exclude=["tomotactile_ros.nodes*"]),
    data_files=shared_files(),
    python_requires=">=3.10",
    install_requires=["matplotlib", "numpy", "pyserial", "pyyaml", "scipy", "shapely>=2"],
    extras_require={"bags": ["rosbags"]},
    entry_points={"console_scripts": ["tomotactile = tomotactile_ros.cli:main"]},
)
