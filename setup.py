"""Installs the library and its command line without ROS; with ROS, CMakeLists.txt is used.

What they are called and what they need says pyproject.toml; here is what that cannot say.
"""

import platform
import sys
import sysconfig
from pathlib import Path

from pybind11.setup_helpers import ParallelCompile, Pybind11Extension
from setuptools import setup
from setuptools.command.build_ext import build_ext
from setuptools.errors import BaseError

SHARE = Path("share/tomotactile_ros")


def shared_files() -> list[tuple[str, list[str]]]:
    """Return the files under config/ and msg/, each with the folder that it is installed to."""
    files = [path for folder in ("config", "msg") for path in sorted(Path(folder).rglob("*.*"))]
    return [(str(SHARE / path.parent), [str(path)]) for path in files]


def eigen() -> str:
    """Return where the headers of Eigen are: those of the system, or of the wheel cmeel-eigen."""
    places = [Path("/usr/include/eigen3"), Path(sys.prefix, "include/eigen3")]
    wheel = Path("cmeel.prefix/include/eigen3")
    places += [Path(path) / wheel for path in (sysconfig.get_path("purelib"), *sys.path)]
    for place in places:
        if (place / "Eigen/Core").exists():
            return str(place)
    sys.exit("Eigen is missing: install libeigen3-dev (Debian, Ubuntu) or pip install cmeel-eigen")


def compiled(name: str, *options: str) -> Pybind11Extension:
    """The core as the module `name`, optimized as in core/CMakeLists.txt; `options` of the compiler."""
    sources = [*sorted(map(str, Path("core/src").glob("*.cpp"))), "core/python/core.cpp"]
    return Pybind11Extension(
        f"tomotactile_ros.{name}",
        sources,
        include_dirs=["core/include", eigen()],
        define_macros=[("TOMOTACTILE_MODULE", name), ("EIGEN_DONT_PARALLELIZE", None)],
        extra_compile_args=["-O2", "-DNDEBUG", *options],
        cxx_std=17,
    )


class Build(build_ext):
    """Says in one line what is missing where there is no compiler."""

    def run(self) -> None:
        try:
            super().run()
        except BaseError as error:
            sys.exit(
                f"the compiled core could not be built: {str(error).splitlines()[0]}\n"
                "a C++17 compiler is needed (Debian, Ubuntu: apt install build-essential python3-dev)"
            )


ParallelCompile(default=0).install()
modules = [compiled("_core")]
if platform.machine() in ("x86_64", "AMD64"):  # the same again for processors with AVX2
    modules.append(compiled("_core_v3", "-march=x86-64-v3", "-Dtomotactile=tomotactile_v3"))
setup(data_files=shared_files(), ext_modules=modules, cmdclass={"build_ext": Build})
