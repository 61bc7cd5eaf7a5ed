"""Reads and writes the files of a launch: what to start, and with which configuration."""

import copy
import os
import shutil
import tempfile

import yaml

from . import configuration, strict_yaml
from .configuration import ConfigurationError

# Largest configuration that gdp-proxy reads.
MAX_BYTES = 4 << 20


def read(path):
    """Return the text of a file of the user."""
    try:
        with open(path, encoding='utf-8') as file:
            text = file.read(MAX_BYTES + 1)
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f'{path}: cannot be read: {error}') from error
    if len(text) > MAX_BYTES:
        raise ConfigurationError(f'{path}: longer than {MAX_BYTES} bytes')
    return text


def program(name):
    """Return the path of a program, of `GDP_BIN` if that is set."""
    folder = os.environ.get('GDP_BIN')
    found = shutil.which(name, path=folder) if folder else shutil.which(name)
    if found is None:
        raise ConfigurationError(f'{name} is not installed: install the package of the Global Data Plane, or say '
                                 'in GDP_BIN in which folder it is')
    return found


def parameters(arguments, params_file=''):
    """Return the parameters of the file and of the launch arguments, which win."""
    found = configuration.parameters_of_file(read(params_file)) if params_file else {}
    found.update(configuration.parameters_of_arguments(arguments))
    return found


class Prepared:
    """The configuration that the proxy runs with, and the file for it."""

    def __init__(self, found):
        self.parameters = found
        self.base = os.path.abspath(found.get('config') or configuration.default_config())
        self.folder = None

    def must_join(self):
        """Return whether this machine has yet to join with the token.

        Raise if it would join, and then not find the configuration: an invitation serves once.
        """
        if 'token_file' not in self.parameters or os.path.exists(self.base):
            return False
        folder, name = os.path.split(self.base)
        if name != configuration.CONFIG_NAME:
            raise ConfigurationError(
                f'{self.base} does not exist, and joining writes {configuration.CONFIG_NAME}: with token_file, '
                f'say config:={os.path.join(folder, configuration.CONFIG_NAME)}')
        # What is wrong in the parameters themselves shows in the configuration that joining writes.
        configuration.merged(copy.deepcopy(configuration.JOINED), self.parameters, folder)
        return True

    def write(self):
        """Return the path of the configuration. Where no parameter changes it, that is the file itself."""
        if not os.path.exists(self.base):
            raise ConfigurationError(
                f'{self.base} does not exist: join a domain with `gdp-proxy join` or token_file:=FILE, or say with '
                'config:=FILE where it is')
        if not configuration.changes(self.parameters):
            return self.base
        try:
            base = strict_yaml.load(read(self.base))
        except yaml.YAMLError as error:
            raise ConfigurationError(f'{self.base}: not YAML: {error}') from error
        config = configuration.merged(base, self.parameters, os.path.dirname(self.base))
        if self.folder is None:
            # Of mode 0700.
            self.folder = tempfile.mkdtemp(prefix='gdp_ros-')
        path = os.path.join(self.folder, 'proxy.yaml')
        with open(path, 'w', encoding='utf-8') as file:
            file.write(configuration.as_yaml(config))
        return path

    def remove(self):
        """Remove the written file."""
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)
            self.folder = None
