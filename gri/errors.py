"""The error for bad input, which the person who gave the input can correct."""


class InputError(ValueError):
    """Bad input: a file, a field or an argument.

    Commands print it as one line and exit with code 2. The message says what was given, what was expected, where, and
    how to fix it.
    """
