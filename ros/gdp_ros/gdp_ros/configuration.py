"""Turns launch arguments and ROS parameters into the configuration of gdp-proxy.

Pure functions: nothing here starts a program or needs ROS.
"""

import copy
import os
import re

import yaml

from . import strict_yaml

# Parameters, by what their values are.
LISTS = ('expose', 'expose_services', 'expose_actions', 'deny')
TEXTS = ('config', 'token_file', 'namespace', 'log_level')
PARAMETERS = LISTS + TEXTS + ('domain_id',)

# Parameters that change the configuration itself.
CHANGES = LISTS + ('namespace', 'domain_id')

# Severities of ROS as RUST_LOG has them.
LOG_LEVELS = {'debug': 'debug', 'info': 'info', 'warn': 'warn', 'error': 'error', 'fatal': 'error'}

# Keys with paths, by section. Sections with a list have these keys in each element.
PATHS = {
    '': ('identity', 'state'),
    'domain': ('card', 'membership', 'peers'),
    'directory': ('card', 'grant'),
    'definitions': ('ros1', 'ros2'),
    'relay': ('identity', 'membership'),
    'expose': ('owner', 'catalog'),
    'import': ('catalog', 'grant'),
    'topics': ('card', 'cert', 'grant'),
    'services': ('card', 'cert', 'grant'),
    'actions': ('card', 'cert', 'grant'),
}

MAX_DOMAIN_ID = 232

# The name of the configuration that `gdp-proxy join` writes, and its sections that parameters change.
CONFIG_NAME = 'proxy.yaml'
JOINED = {'version': 1, 'expose': {'owner': 'owner.pem', 'catalog': 'catalog.card', 'topics': []}}


class ConfigurationError(ValueError):
    """A parameter or file is wrong. The text names it and the remedy."""


def default_config(environ=os.environ, is_root=None):
    """Return the path at which `gdp-proxy join` writes the configuration."""
    if os.geteuid() == 0 if is_root is None else is_root:
        return '/etc/gdp/proxy.yaml'
    base = environ.get('XDG_CONFIG_HOME', '')
    if not os.path.isabs(base):
        base = os.path.join(environ.get('HOME', '/'), '.config')
    return os.path.join(base, 'gdp', 'proxy.yaml')


def parameters_of_file(text, node='/gdp_proxy'):
    """Return the proxy's parameters in the text of a ROS parameters file."""
    try:
        document = strict_yaml.load(text)
    except yaml.YAMLError as error:
        raise ConfigurationError(f'the parameters file is not YAML: {error}') from error
    if not isinstance(document, dict):
        raise ConfigurationError('the parameters file has no nodes: begin with `/gdp_proxy:`')
    found = {}
    # What is for all nodes comes first, so that the proxy's own entry wins.
    names = ('/**', node.lstrip('/'), '/' + node.lstrip('/'))
    for name in names:
        entry = document.get(name)
        if entry is None:
            continue
        if not isinstance(entry, dict) or not isinstance(entry.get('ros__parameters'), dict):
            raise ConfigurationError(f'{name} has no `ros__parameters:`')
        found.update({
            key: value for key, value in entry['ros__parameters'].items()
            if name != '/**' or key in PARAMETERS
        })
    if not any(name in document for name in names):
        raise ConfigurationError(f'the parameters file has no node {node}; it has {", ".join(map(str, document))}')
    return checked(found)


def parameters_of_arguments(arguments):
    """Return the parameters in the texts of launch arguments. An empty text is no parameter."""
    found = {}
    for name, text in arguments.items():
        if text == '':
            continue
        found[name] = listed(name, text) if name in LISTS else text
    return checked(found)


def listed(name, text):
    """Return the elements of `[a, b]`, or of `a,b`."""
    # In YAML, a word that begins with * is an alias: patterns of a flow sequence are split by hand.
    inner = text.strip()
    if inner.startswith('['):
        if not inner.endswith(']'):
            raise ConfigurationError(f'{name}: {text!r} has no closing bracket')
        inner = inner[1:-1]
    parts = [part.strip().strip('"\'') for part in inner.split(',')]
    return [part for part in parts if part]


def checked(parameters):
    """Return the parameters with their types, or raise if one is unknown or wrong."""
    result = {}
    for name, value in parameters.items():
        if name == 'use_sim_time':
            # ROS gives it to every node.
            continue
        if name not in PARAMETERS:
            raise ConfigurationError(f'unknown parameter {name}; there are {", ".join(PARAMETERS)}')
        if name in LISTS:
            if not isinstance(value, list) or not all(isinstance(element, str) for element in value):
                raise ConfigurationError(f'{name} is a list of patterns, such as [/camera/**]')
            for pattern in value:
                if not pattern.startswith('/'):
                    raise ConfigurationError(f'{name}: {pattern!r} does not begin with a slash')
        elif name == 'domain_id':
            value = domain_id(value)
        elif not isinstance(value, str):
            raise ConfigurationError(f'{name} is a text')
        if name == 'log_level' and value.lower() not in LOG_LEVELS:
            raise ConfigurationError(f'log_level is one of {", ".join(LOG_LEVELS)}, not {value!r}')
        if value != '':
            result[name] = value
    return result


def domain_id(value):
    """Return a ROS domain ID."""
    try:
        number = int(str(value))
    except ValueError:
        number = -1
    if isinstance(value, bool) or not 0 <= number <= MAX_DOMAIN_ID:
        raise ConfigurationError(f'domain_id is a number of 0 to {MAX_DOMAIN_ID}, not {value!r}')
    return number


def changes(parameters):
    """Return whether the parameters change the configuration file."""
    return any(name in parameters for name in CHANGES)


def merged(base, parameters, folder):
    """Return the configuration `base` of a file in `folder`, changed by the parameters.

    Relative paths become absolute, so that the result works anywhere.
    """
    if not isinstance(base, dict):
        raise ConfigurationError('the configuration is no mapping')
    config = copy.deepcopy(base)
    resolve(config, folder)
    lists = {'expose': 'topics', 'expose_services': 'services', 'expose_actions': 'actions', 'deny': 'deny'}
    for name, key in lists.items():
        if name not in parameters:
            continue
        section = config.get('expose')
        if not isinstance(section, dict):
            raise ConfigurationError(
                f'{name}: the configuration has no `expose:` with owner and catalog; '
                'join a domain with `gdp-proxy join`, which writes it')
        section[key] = parameters[name]
    if 'namespace' in parameters:
        move_into(config, parameters['namespace'])
    if 'domain_id' in parameters:
        set_domain_id(config, parameters['domain_id'])
    return config


def resolve(config, folder):
    """Make the paths in the configuration absolute."""
    def absolute(value):
        if isinstance(value, list):
            return [absolute(element) for element in value]
        return os.path.join(folder, value) if isinstance(value, str) else value

    for section, keys in PATHS.items():
        within = config if section == '' else config.get(section)
        for mapping in within if isinstance(within, list) else [within]:
            if not isinstance(mapping, dict):
                continue
            for key in keys:
                if key in mapping:
                    mapping[key] = absolute(mapping[key])


def move_into(config, namespace):
    """Give what is exposed the namespace in front of its names, as others see it."""
    if not re.fullmatch(r'/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*', namespace):
        raise ConfigurationError(f'namespace: {namespace!r} is no ROS namespace')
    namespace = '/' + namespace.lstrip('/')
    section = config.get('expose')
    if not isinstance(section, dict):
        raise ConfigurationError('namespace: the configuration exposes nothing')
    firsts = []
    for key in ('topics', 'services', 'actions'):
        for rule in section.get(key) or []:
            pattern = rule.get('topic') if isinstance(rule, dict) else rule
            first = str(pattern).split('/')[1] if str(pattern).startswith('/') else ''
            if '*' in first or first == '':
                raise ConfigurationError(
                    f'namespace: {pattern!r} has no first part of its own; expose by names such as /camera/**')
            if '/' + first != namespace and first not in firsts:
                firsts.append(first)
    own = section.get('remap') or []
    # The first remapping that matches is taken, so what the file says stays.
    section['remap'] = own + [{'from': '/' + first, 'to': f'{namespace}/{first}'} for first in firsts]


def set_domain_id(config, number):
    """Set the domain ID of the only graph of ROS 2."""
    graphs = config.get('graphs')
    if not graphs:
        config['graphs'] = {'ros2': {'domain_id': number}}
        return
    of_dds = [name for name, graph in graphs.items() if isinstance(graph, dict) and set(graph) == {'domain_id'}]
    if len(of_dds) != 1:
        raise ConfigurationError(
            f'domain_id: the configuration has {len(of_dds)} graphs of ROS 2; set the domain IDs there')
    graphs[of_dds[0]]['domain_id'] = number


def as_yaml(config):
    """Return the text of a configuration file."""
    header = '# Written by gdp_ros from its parameters; changes here are lost.\n'
    return header + strict_yaml.dump(config)


def environment(parameters):
    """Return the environment variables that the proxy gets."""
    level = parameters.get('log_level')
    return {'RUST_LOG': LOG_LEVELS[level.lower()]} if level else {}


def join_command(program, parameters, config):
    """Return the command that joins a domain with the token, and writes the configuration."""
    command = [program, 'join', '--file', parameters['token_file'], '--dir', os.path.dirname(config), '--no-run']
    if parameters.get('expose'):
        # Only an invitation for applicants asks.
        command += ['--expose', ','.join(parameters['expose'])]
    return command
