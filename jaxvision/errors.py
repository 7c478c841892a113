"""The one exception a user of the tools sees for bad input."""


class InputError(ValueError):
    """Input that cannot be used. The message is one sentence: what, where, and what to do."""
