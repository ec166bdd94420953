"""Files: where those of the package are, and how others are written, whole or not at all."""

import errno
import io
import os
import secrets
import stat
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from tomotactile_ros.support.checks import show, size
from tomotactile_ros.support.errors import InputError, meant

YAML = (".yaml", ".yml")  # endings of layouts and other settings
PICTURES = (".png", ".svg", ".pdf", ".jpg", ".webp")  # what a picture can be written as
_WRITTEN = ("out", "picture", "report")  # options that name a file to write, and to read:
_READ = (
    "frames",
    "presses",
    "layout",
    "scene",
    "sensor",
    "tare",
    "calibration",
    "recording",
    "raw",
)
READ_TIME = 10.0  # s for one file
_PIECE = 1 << 20


def open_regular(path: str | os.PathLike, most: int) -> int:
    """Descriptor of a plain file of at most `most` bytes; InputError for anything else.

    A named pipe or a device would keep the reader waiting, or never end.
    """
    try:
        number = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError:
        raise InputError(f"{show(os.fspath(path))}: is no path") from None
    found = os.fstat(number)
    complaint = ""
    if stat.S_ISDIR(found.st_mode):
        complaint = f"cannot be read: {os.strerror(errno.EISDIR)}"
    elif not stat.S_ISREG(found.st_mode):
        complaint = "cannot be read: is not a plain file"
    elif found.st_size > most:
        complaint = f"the file is larger than {size(most)}"
    if complaint:
        os.close(number)
        raise InputError(f"{path}: {complaint}")
    return number


def read_limited(path: str | os.PathLike, most: int) -> bytes:
    """All of a plain file of at most `most` bytes, in at most `READ_TIME`; else InputError."""
    deadline = time.monotonic() + READ_TIME
    pieces, length = [], 0
    with os.fdopen(open_regular(path, most), "rb", buffering=0) as file:
        try:
            while piece := file.read(_PIECE):
                pieces.append(piece)
                length += len(piece)
                if length > most:
                    raise InputError(f"{path}: the file is larger than {size(most)}")
                if time.monotonic() > deadline:
                    raise InputError(f"{path}: cannot be read within {READ_TIME:g} s")
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    return b"".join(pieces)


def check_folder(path: str | os.PathLike) -> None:
    """Refuse a place that takes no file, before long work whose result goes there."""
    target = Path(os.path.realpath(path))
    if target.is_dir():
        raise InputError(f"{path}: cannot be written: is a folder")
    if target.exists() and not target.is_file():
        raise InputError(f"{path}: cannot be written: is a device")
    if not target.parent.is_dir():
        raise InputError(f"{path}: cannot be written: there is no folder {target.parent}")
    try:
        tempfile.TemporaryFile(dir=target.parent).close()
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


def check_out(path: str | os.PathLike, *endings: str) -> None:
    """Refuse a file whose name ends in another format than it gets, and a place that takes none."""
    if Path(path).suffix.lower() not in endings:
        right = " or ".join(endings)
        if not Path(path).name:
            raise InputError(
                f"{show(os.fspath(path))}: is no file to write; it has to end in {right}"
            )
        stem = Path(path).name.removesuffix(Path(path).suffix) or "out"
        raise InputError(
            f"{path}: this file is written as {right}; "
            f"call it {Path(path).with_name(stem + endings[0])}"
        )
    check_folder(path)


def write_atomic(path: str | os.PathLike, data: bytes) -> None:
    """Write to a temporary file beside ``path`` and move it into place, see `atomic_file`."""
    with atomic_file(path) as file:
        file.write(data)


@contextmanager
def atomic_file(path: str | os.PathLike) -> Iterator[IO[bytes]]:
    """A temporary file beside ``path`` to write to; moved into place when all has gone well.

    A symbolic link stays and its target is written; an existing file keeps its permissions, a new
    one has those that the umask leaves.
    """
    check_folder(path)
    target = Path(os.path.realpath(path))
    temporary = target.with_name(f".{target.name[:200]}.{os.getpid()}-{secrets.token_hex(4)}")
    try:
        number = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        try:
            with os.fdopen(number, "w+b") as file:
                if target.exists():
                    os.fchmod(number, stat.S_IMODE(target.stat().st_mode))
                yield file
                file.flush()
                os.fsync(number)
            os.replace(temporary, target)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


def check_inputs_stay(options: Mapping[str, object], mark: str = "--") -> None:
    """Refuse to write to a file that is read: recorded frames would be lost.

    `options` of a command line, by name, or parameters, with another `mark` before names. A sensor
    file that is gone on from may be replaced.
    """
    read = [
        (name, word.rpartition("=")[0] or word)  # FRAMES=FORCE of calibrate
        for name in _READ
        for word in _texts(options.get(name))
    ]
    for out in _WRITTEN:
        for target in _texts(options.get(out)):
            for name, path in read:
                if (name, out) != ("sensor", "out") and _same_file(path, target):
                    raise InputError(
                        f"{mark}{out}: {target} is the file that {name} names, too; take another name"
                    )


def _texts(value: object) -> list[str]:
    """The texts that an option has been given."""
    return [
        word for word in (value if isinstance(value, list) else [value]) if isinstance(word, str)
    ]


def _same_file(one: str, other: str) -> bool:
    """Whether two paths, of which neither has to exist, are those of one file."""
    try:
        return os.path.realpath(one) == os.path.realpath(other) or os.path.samefile(one, other)
    except (OSError, ValueError):
        return False


def check_picture(path: str | os.PathLike) -> None:
    """Refuse a picture whose name ends in no format that can be drawn."""
    check_out(path, *PICTURES)


def save_figure(figure, path: str | os.PathLike, **how) -> None:
    """Write a matplotlib figure in the format of its name, whole or not at all."""
    check_picture(path)
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=100, format=Path(path).suffix.lower().lstrip("."), **how)
    write_atomic(path, buffer.getvalue())


def shared_folders() -> list[Path]:
    """Folders that may hold the package's ``config`` and ``msg``: of ROS, the source tree, pip."""
    share = Path("share/tomotactile_ros")
    prefixes = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    source = Path(__file__).resolve().parents[2]
    return [*(Path(prefix) / share for prefix in prefixes), source, Path(sys.prefix) / share]


def find_shared(package: str, path: str, key: str) -> Path:
    """A file that a package shares (``package://NAME/PATH`` in robot descriptions).

    `key` says who asks, for the InputError where there is none.
    """
    prefixes = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    for prefix in prefixes:
        file = Path(prefix, "share", package, path)
        if package and ".." not in Path(package, path).parts and file.is_file():
            return file
    raise InputError(
        f"{key}: package://{package}/{path}: no such file; is the workspace of {package} sourced?"
    )


def find_config(kind: str, name: str | os.PathLike) -> Path:
    """The file of a layout or scene.

    Parameters
    ----------
    kind : ``"layouts"`` or ``"scenes"``.
    name : a path, or the name of an installed file with or without ``.yaml``.
    """
    text = os.fspath(name)
    folders = [folder / "config" / kind for folder in shared_folders()]
    named = [path for folder in folders for path in (folder / text, folder / f"{text}.yaml")]
    try:
        for path in (Path(text), *named) if text else ():
            if path.is_file():
                return path
    except OSError as error:
        raise InputError(f"{show(text)}: cannot be read: {error.strerror}") from None
    there = installed(kind)
    hint = meant(Path(text).stem, there)
    raise InputError(
        f"{show(text)}: no such file, and none of the installed {kind}: "
        f"{', '.join(there) or '-'}{hint}"
    )


def installed(kind: str) -> list[str]:
    """Names of all installed ``"layouts"`` or ``"scenes"``."""
    folders = [folder / "config" / kind for folder in shared_folders()]
    return sorted({file.stem for folder in folders for file in folder.glob("*.yaml")})
