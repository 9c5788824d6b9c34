"""The one error a person can cause and mend."""


class InputError(ValueError):
    """Bad input from outside: a file, a field, an argument.

    Commands print it as one line and exit with code 2. The message says what was got, what was wanted,
    where, and how to fix it.
    """
