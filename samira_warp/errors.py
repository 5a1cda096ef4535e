"""The one exception that stands for a user's mistake."""


class UserError(ValueError):
    """Input that cannot be used: the message names the file or argument, what was expected and what was found.

    The command line prints the message on one line of standard error and exits with status 2; from Python it is an ordinary ValueError.
    """

    def __init__(self, subject: object, *, expected: object, found: object) -> None:
        """Compose ``subject: expected ..., found ...``, folded to one line."""
        super().__init__(" ".join(f"{subject}: expected {expected}, found {found}".split()))
