"""Event handlers, which keep their functions."""


class OnProcessExit:
    """At the end of a program."""

    def __init__(self, *, target_action, on_exit):
        self.target_action, self.on_exit = target_action, on_exit


class OnShutdown:
    """At the end of the launch."""

    def __init__(self, *, on_shutdown):
        self.on_shutdown = on_shutdown
