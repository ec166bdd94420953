"""The one exception for what a user can put right: a file, a key, a parameter."""

import difflib
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

_ALIKE = 0.65  # of a name that may have been meant, as difflib measures it


class InputError(ValueError):
    """Bad input. The message is one line: where (file: key), what is wrong, what would be right."""

    def __init__(self, message: object = ""):
        super().__init__(printable(str(message)))


class Doubt(UserWarning):
    """Input that is possible and probably not meant. One line like that of an InputError."""


def doubt(message: str) -> None:
    """Say that something was probably not meant, and go on; programs print or log it as a line."""
    warnings.warn(printable(message), Doubt, stacklevel=3)


def printable(text: str) -> str:
    """The text with everything escaped that a terminal or a log would not show as it is.

    Names come from files and messages of others: a few control characters clear a screen, or look
    like a line of the log.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


@contextmanager
def complaints_at(place: str) -> Iterator[None]:
    """Put a place, ``"scene.yaml: adc."``, before the complaint of whatever is refused inside."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{place}{error}") from None


def meant(text: str, names: Iterable[str]) -> str:
    """The end of a complaint: the one of `names` that `text` is nearest to; nothing where none is near."""
    bare = {name.lstrip("-"): name for name in names}  # the dashes of options make all alike
    close = difflib.get_close_matches(text.lstrip("-"), list(bare), n=1, cutoff=_ALIKE)
    return f"; did you mean {bare[close[0]]}?" if close else ""
