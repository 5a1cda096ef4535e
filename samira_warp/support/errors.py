"""The one exception that stands for a user's mistake."""


class UserError(ValueError):
    """Input that cannot be used: the message says where, what was expected and what was found.

    Where is the file's or the argument's name. The command line prints the message on one line of standard
    error and exits with status 2; from Python it is an ordinary ValueError.

    Attributes:
        subject: The file or argument.
        expected: What was expected, folded to one line.
        found: What was found, folded to one line.
    """

    def __init__(self, subject: object, *, expected: object, found: object) -> None:
        """Compose ``subject: expected ..., found ...``, folded to one line."""
        self.subject, self.expected, self.found = (
            " ".join(str(part).split()) for part in (subject, expected, found)
        )
        super().__init__(f"{self.subject}: expected {self.expected}, found {self.found}")
