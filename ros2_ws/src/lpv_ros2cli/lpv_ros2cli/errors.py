"""Errors of the command line."""


class CliError(Exception):
    """What was asked cannot be done; the message is one line for the user.

    Parameters
    ----------
    message : str
        What is wrong, and what would be right.
    code : int, optional
        Exit code of the command.
    """

    def __init__(self, message, code=1):
        super().__init__(message)
        self.code = code
