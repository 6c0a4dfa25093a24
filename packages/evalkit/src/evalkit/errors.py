"""The one error that a user is meant to read."""


class InputError(ValueError):
    """Something the user handed us cannot be used.

    The message is one sentence that names the file (or option) and the mend. The commands print it without a
    traceback and exit with code 2; library callers catch it as a ``ValueError``.
    """
