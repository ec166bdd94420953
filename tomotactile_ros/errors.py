"""The one exception for what a user can put right: a file, a key, a parameter."""

from collections.abc import Iterator
from contextlib import contextmanager


class InputError(ValueError):
    """Bad input. The message is one line: where (file: key), what is wrong, what would be right."""


@contextmanager
def complaints_at(place: str) -> Iterator[None]:
    """Put a place, ``"scene.yaml: adc."``, before the complaint of whatever is refused inside."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{place}{error}") from None
