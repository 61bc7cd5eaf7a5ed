"""`ros2 gdp robots`: the members of the domain, on the machine that has its files."""

from gdp_ros import ctl
from gdp_ros.verb import VerbExtension


def lines(answer):
    """Return the members by label."""
    def words(member, key):
        return ' '.join(member.get(key) or []) or '–'

    rows = [
        (member['label'], member['state'], words(member, 'expose'), words(member, 'import'), words(member, 'read'))
        for member in answer['members']
    ]
    return ctl.table(('label', 'state', 'exposes', 'imports', 'reads'), rows)


class RobotsVerb(VerbExtension):
    """List the members of the domain, and machines that ask to become one."""

    def add_arguments(self, parser, cli_name):
        """Add the options of the verb."""
        ctl.add_json(parser)

    def main(self, *, args):
        """Run the verb."""
        return ctl.run(['-j', 'robots'], lines, args.json)
