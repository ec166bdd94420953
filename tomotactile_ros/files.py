"""Files: where those of the package are, and how others are written, whole or not at all."""

import os
import sys
import tempfile
from pathlib import Path

from tomotactile_ros.checks import show
from tomotactile_ros.errors import InputError


def check_folder(path: str | os.PathLike) -> None:
    """Refuse a place that takes no file, before long work whose result goes there."""
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: cannot be written: is a folder")
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: cannot be written: is a device")
    if not path.parent.is_dir():
        raise InputError(f"{path}: cannot be written: there is no folder {path.parent}")
    try:
        tempfile.TemporaryFile(dir=path.parent).close()
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


def write_atomic(path: str | os.PathLike, data: bytes) -> None:
    """Write to a temporary file beside ``path`` and move it into place."""
    check_folder(path)
    path = Path(path)
    temporary = None
    try:
        with tempfile.NamedTemporaryFile(
            dir=path.parent, prefix=f".{path.name}.", delete=False
        ) as file:
            temporary = file.name
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError as error:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


def shared_folders() -> list[Path]:
    """Folders that may hold the package's ``config`` and ``msg``: of ROS, the source tree, pip."""
    share = Path("share/tomotactile_ros")
    prefixes = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    source = Path(__file__).resolve().parent.parent
    return [*(Path(prefix) / share for prefix in prefixes), source, Path(sys.prefix) / share]


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
    installed = sorted({file.stem for folder in folders for file in folder.glob("*.yaml")})
    raise InputError(
        f"{show(text)}: no such file, and none of the installed {kind}: "
        f"{', '.join(installed) or '-'}"
    )
