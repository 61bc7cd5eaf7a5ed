"""Actions, which keep their arguments."""


class _Action:
    def __init__(self, *positional, **named):
        self.positional, self.named = positional, named


class DeclareLaunchArgument(_Action):
    """An argument of the launch file."""

    def __init__(self, name, *, default_value, description):
        super().__init__()
        self.name, self.default_value, self.description = name, default_value, description

    def execute(self, context):
        """Set the default."""
        context.launch_configurations.setdefault(self.name, self.default_value)


class OpaqueFunction(_Action):
    """A function that returns actions."""

    def __init__(self, *, function):
        super().__init__()
        self.function = function

    def execute(self, context):
        """Return the actions."""
        return self.function(context)


class ExecuteProcess(_Action):
    """A program."""

    def __init__(self, *, cmd, name, output, additional_env=None, respawn=False, respawn_delay=None):
        super().__init__()
        self.cmd, self.additional_env, self.respawn = cmd, additional_env, respawn


class RegisterEventHandler(_Action):
    """An event handler."""

    def __init__(self, event_handler):
        super().__init__()
        self.event_handler = event_handler


class EmitEvent(_Action):
    """An event."""

    def __init__(self, *, event):
        super().__init__()
        self.event = event


class LogInfo(_Action):
    """A line of the log."""

    def __init__(self, *, msg):
        super().__init__()
        self.msg = msg
