"""Substitutions."""


class LaunchConfiguration:
    """The value of a launch argument."""

    def __init__(self, name):
        self.name = name

    def perform(self, context):
        """Return the value."""
        return context.launch_configurations[self.name]
