"""`ros2 gdp expose`: what crosses from this graph, and what would with other patterns."""

import sys

from gdp_ros import configuration, ctl, prepared
from gdp_ros.configuration import ConfigurationError
from gdp_ros.verb import VerbExtension


def lines(report):
    """Return the topics and calls of the graph, with the reason why each crosses or does not."""
    def row(entry):
        crosses = 'yes' if entry['direction'] else 'no'
        return (entry.get('topic') or entry.get('service'), entry['type'] or '–', crosses, entry['because'])

    rows = [row(entry) for entry in report['topics'] + report['calls']]
    return ctl.table(('name', 'type', 'crosses', 'because'), rows) if rows else ['nothing is in this graph']


class ExposeVerb(VerbExtension):
    """Show what crosses from this graph, or what would with these patterns; changes nothing."""

    def add_arguments(self, parser, cli_name):
        """Add the options of the verb."""
        parser.add_argument('patterns', nargs='*', metavar='PATTERN', help='topics to expose instead, /camera/**')
        parser.add_argument('--deny', nargs='*', metavar='PATTERN', help='topics never to expose')
        parser.add_argument('--config', default='', help='configuration of the proxy')
        parser.add_argument('--seconds', type=int, default=3, help='time to look at the graph')
        ctl.add_json(parser)

    def main(self, *, args):
        """Run the verb."""
        found = {'config': args.config, 'expose': args.patterns, 'deny': args.deny or []}
        plan = None
        try:
            plan = prepared.Prepared(configuration.checked({name: value for name, value in found.items() if value}))
            command = [plan.write(), '--dry-run', str(args.seconds), '-j']
            return ctl.run(command, lines, args.json, 'gdp-proxy')
        except ConfigurationError as error:
            print(f'ros2 gdp: {error}', file=sys.stderr)
            return 1
        finally:
            if plan is not None:
                plan.remove()
