"""Asks gdp-ctl, and prints what it answers."""

import json
import subprocess
import sys

from . import prepared
from .configuration import ConfigurationError


def ask(arguments, name='gdp-ctl'):
    """Return the exit status of a program and the objects that it prints, one a line."""
    command = [prepared.program(name), *arguments]
    # Its messages for people go to stderr, past this program.
    done = subprocess.run(command, stdout=subprocess.PIPE, check=False)
    try:
        objects = [json.loads(line) for line in done.stdout.decode('utf-8').splitlines() if line.strip()]
    except ValueError as error:
        raise ConfigurationError(f'{name} printed something else than JSON: {error}') from error
    return done.returncode, objects


def run(arguments, lines, as_json=False, name='gdp-ctl'):
    """Print what a program answers: as JSON, or the lines that the function makes of each object."""
    try:
        status, objects = ask(arguments, name)
    except ConfigurationError as error:
        print(f'ros2 gdp: {error}', file=sys.stderr)
        return 1
    for value in objects:
        if as_json:
            print(json.dumps(value))
        elif 'error' not in value:
            for line in lines(value):
                print(printable(line))
    return status


def printable(text):
    """Return a text of others without what a terminal would act on."""
    return ''.join(c if c.isprintable() else c.encode('unicode_escape').decode('ascii') for c in text)


def table(heading, rows):
    """Return aligned lines."""
    cells = [[printable(str(cell)) for cell in row] for row in [heading, *rows]]
    widths = [max(len(row[column]) for row in cells) for column in range(len(heading))]
    return ['  '.join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip() for row in cells]


def short(name):
    """Return a name as people read it."""
    return f'{name[:3]}…{name[-3:]}' if isinstance(name, str) and len(name) == 64 else name or '–'


def add_json(parser):
    """Add the option for programs."""
    parser.add_argument('-j', '--json', action='store_true', help='print the JSON of gdp-ctl')
