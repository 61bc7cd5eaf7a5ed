"""`ros2 gdp`: the Global Data Plane as ROS users see it."""

from ros2cli.command import CommandExtension, add_subparsers_on_demand


class GdpCommand(CommandExtension):
    """Various sub-commands of the Global Data Plane."""

    def add_arguments(self, parser, cli_name):
        """Add the verbs."""
        self._subparser = parser
        add_subparsers_on_demand(parser, cli_name, '_verb', 'gdp_ros.verb', required=False)

    def main(self, *, parser, args):
        """Run the verb, or print the help without one."""
        if not hasattr(args, '_verb'):
            self._subparser.print_help()
            return 0
        return args._verb.main(args=args)
