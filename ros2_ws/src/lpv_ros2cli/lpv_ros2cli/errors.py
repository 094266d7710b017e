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

    def __init__(self, message: str, code: int = 1) -> None:
        super().__init__(message)
        self.code = code
