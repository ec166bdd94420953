"""Installs the library and its command line without ROS; with ROS, CMakeLists.txt is used."""

from pathlib import Path

from setuptools import find_packages, setup

SHARE = Path("share/tomotactile_ros")


def installed_config() -> list[tuple[str, list[str]]]:
    """Return the files under config/, each with the folder that it is installed to."""
    files = sorted(path for path in Path("config").rglob("*") if path.is_file())
    return [(str(SHARE / path.parent), [str(path)]) for path in files]


setup(
    name="tomotactile_ros",
    version="0.1.0",
    description="Large-area tactile sensing by electrical tomography",
    long_description=Path("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    packages=find_packages(include=["tomotactile_ros*"], exclude=["tomotactile_ros.nodes*"]),
    data_files=installed_config(),
    python_requires=">=3.10",
    install_requires=["matplotlib", "numpy", "pyserial", "pyyaml", "scipy", "shapely>=2"],
    entry_points={"console_scripts": ["tomotactile = tomotactile_ros.cli:main"]},
)
