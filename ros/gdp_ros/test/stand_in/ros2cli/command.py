"""The base class of commands, and the function that adds their verbs."""

import importlib
import re
from pathlib import Path


class CommandExtension:
    """The extension point for commands."""

    NAME = None

    def add_arguments(self, parser, cli_name, *, argv=None):
        """Add arguments."""

    def main(self, *, parser, args):
        """Run."""
        raise NotImplementedError()


def entry_points(group):
    """Return the entry points in setup.py, by name."""
    setup = (Path(__file__).resolve().parents[3] / 'setup.py').read_text()
    listed = re.search(rf"'{re.escape(group)}': \[(.*?)\]", setup, re.DOTALL).group(1)
    return dict(re.findall(r"'([^' ]+) = ([^']+)'", listed))


def load(reference):
    """Return what an entry point means."""
    module, name = reference.split(':')
    return getattr(importlib.import_module(module), name)


def add_subparsers_on_demand(parser, cli_name, dest, group_name, hide_extensions=None, required=True, argv=None):
    """Add a parser for each verb."""
    verbs = parser.add_subparsers(dest=' verb', required=required)
    for name, reference in entry_points(group_name).items():
        extension = load(reference)()
        extension.NAME = name
        verb = verbs.add_parser(name, description=extension.__doc__)
        verb.set_defaults(**{dest: extension})
        extension.add_arguments(verb, f'{cli_name} {name}')
    return verbs
