"""The verbs of `ros2 gdp`. Each asks gdp-ctl, whose JSON is stable."""

from ros2cli.plugin_system import PLUGIN_SYSTEM_VERSION, satisfies_version


class VerbExtension:
    """
    The extension point for verbs of `ros2 gdp`.

    A verb has `main`, and may have `add_arguments`. `NAME` becomes the name of its entry point.
    """

    NAME = None
    EXTENSION_POINT_VERSION = '0.1'

    def __init__(self):
        super().__init__()
        satisfies_version(PLUGIN_SYSTEM_VERSION, '^0.1')

    def add_arguments(self, parser, cli_name):
        """Add the options of the verb."""

    def main(self, *, args):
        """Run the verb, and return its exit status."""
        raise NotImplementedError()
