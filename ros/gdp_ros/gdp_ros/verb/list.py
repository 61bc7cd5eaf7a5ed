"""`ros2 gdp list`: what this machine may publish and read."""

from gdp_ros import ctl
from gdp_ros.verb import VerbExtension

KINDS = ('topic', 'service', 'action')


def lines(answer):
    """Return the entries of a list, with how many publish or serve and read or call each."""
    for key in ('topics', 'services', 'actions'):
        if key in answer:
            rows = [(entry['topic'], entry['type'], *counts(entry)) for entry in answer[key]]
            writers, readers = ('publishers', 'subscribers') if key == 'topics' else ('servers', 'clients')
            return ctl.table((key[:-1], 'type', writers, readers), rows) if rows else [f'no {key}']
    return []


def counts(entry):
    """Return the numbers of both sides, or dashes where the RIB was not asked."""
    sides = [('publishers', 'servers'), ('subscribers', 'clients')]
    return [next((len(entry[key]) for key in keys if key in entry), '–') for keys in sides]


class ListVerb(VerbExtension):
    """List the topics, services or actions that this machine shares or may use."""

    def add_arguments(self, parser, cli_name):
        """Add the options of the verb."""
        parser.add_argument('kind', nargs='?', choices=KINDS, default='topic', help='what to list')
        ctl.add_json(parser)

    def main(self, *, args):
        """Run the verb."""
        return ctl.run(['-j', args.kind, 'list'], lines, args.json)
