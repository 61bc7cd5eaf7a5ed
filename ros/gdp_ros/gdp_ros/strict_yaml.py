"""Reads and writes YAML 1.2 as gdp-proxy reads it.

PyYAML follows YAML 1.1, where `no` is false, 10:20 is a number and 0123 is octal. A name of 64
digits would become a number. Here all of these are texts, and texts are written in quotes.
"""

import re

import yaml


class _Loader(yaml.SafeLoader):
    """Without the implicit types of YAML 1.1."""


class _Dumper(yaml.SafeDumper):
    """Writes texts in quotes."""

    def ignore_aliases(self, data):
        """Write a list again instead of an alias to it, which gdp-proxy refuses."""
        return True


_Loader.yaml_implicit_resolvers = {}
_RESOLVERS = {
    'null': (r'~|null|Null|NULL|', ['~', 'n', 'N', '']),
    'bool': (r'true|True|TRUE|false|False|FALSE', list('tTfF')),
    'int': (r'[-+]?(0|[1-9][0-9]{0,17})', list('-+0123456789')),
    'float': (r'[-+]?[0-9]{1,17}\.[0-9]{1,17}', list('-+0123456789')),
}
for _kind, (_pattern, _firsts) in _RESOLVERS.items():
    _Loader.add_implicit_resolver(f'tag:yaml.org,2002:{_kind}', re.compile(f'^(?:{_pattern})$'), _firsts)

_Dumper.add_representer(str, lambda dumper, text: dumper.represent_scalar('tag:yaml.org,2002:str', text, style='"'))


def load(text):
    """Return the document in a text."""
    return yaml.load(text, Loader=_Loader)


def dump(document):
    """Return the text of a document."""
    return yaml.dump(document, Dumper=_Dumper, sort_keys=False, width=100000)
