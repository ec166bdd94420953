"""The one exception for what a user can put right: a file, a key, a parameter."""


class InputError(ValueError):
    """Bad input. The message is one line: where (file: key), what is wrong, what would be right."""
