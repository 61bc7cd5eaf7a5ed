"""Records a launch description, with the interface of the module `launch` of ROS 2."""


class LaunchContext:
    """The values of launch arguments."""

    def __init__(self):
        self.launch_configurations = {}


class LaunchDescription:
    """A list of actions."""

    def __init__(self, initial_entities=()):
        self.entities = list(initial_entities)
