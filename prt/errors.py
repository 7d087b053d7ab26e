"""The one error a user is meant to see."""


class PrtError(Exception):
    """A mistake the user can mend.

    The message is one line: what was wrong (setting and value), what is allowed, what to do next.
    The command line prints it without a traceback and exits with status 2.
    """
