"""Events."""


class Shutdown:
    """The end of the launch."""

    def __init__(self, *, reason):
        self.reason = reason
