"""Errors of the command line."""


class CliError(Exception):
    """What was asked cannot be done; the message is one line for the user."""

    def __init__(self, message: str, code: int = 1) -> None:
        super().__init__(message)
        self.code = code
