"""`ros2 gdp status`: this machine's switch, or the one to which it is attached."""

from gdp_ros import ctl
from gdp_ros.verb import VerbExtension


def lines(status):
    """Return the state of a switch, in the words of gdp-ctl status."""
    if 'switch' in status:
        # A switch elsewhere, which tells of this machine's links and names alone.
        links, why = status['links'], status['no_rib']
        found = [('switch', status['switch']), ('release', status['release']), ('data plane', status['data_plane'])]
        found += [('RIB', f'not reached: {why}' if why else 'reached')]
        found += [('own links', len(links)), ('own names', len(status['names']))]
    else:
        control = status['control']
        reached = status['topology']
        found = [('switch', status['name']), ('data plane', status['data_plane'])]
        found += [('RIB', 'reached' if control['ready'] else f"not reached: {control['reason']}")]
        found += [('switches', f"{reached['reached']} of {reached['switches']} reached")]
        found += [('links', len(status['links'])), ('names', status['fib']['names'])]
        dropped = sum(count for name, count in status['counters'].items() if name.startswith('drop_'))
        found += [('frames', f"{status['counters'].get('forwarded', 0)} forwarded, {dropped} dropped")]
        found += [('error', error) for error in status['errors']]
    return [f'{key:<12}{value}' for key, value in found]


class StatusVerb(VerbExtension):
    """Show the state of the switch of this machine, or of that to which it is attached."""

    def add_arguments(self, parser, cli_name):
        """Add the options of the verb."""
        ctl.add_json(parser)

    def main(self, *, args):
        """Run the verb."""
        return ctl.run(['-j', 'status'], lines, args.json)
