"""Parameters become a configuration that the real gdp-proxy accepts."""

import json
import subprocess

from gdp_ros import configuration, prepared, strict_yaml
from gdp_ros.configuration import ConfigurationError

import pytest


def base(**more):
    """Return a configuration with relative paths."""
    return {
        'version': 1, 'identity': 'proxy.pem', 'links': [{'to': 'udp://10.0.0.1:31415'}],
        'expose': {'owner': 'owner.pem', 'catalog': 'catalog.card', 'topics': ['/chatter']}, **more,
    }


def test_without_parameters_nothing_but_paths_changes():
    config = configuration.merged(base(), {}, '/etc/gdp')
    assert config['identity'] == '/etc/gdp/proxy.pem'
    assert config['expose'] == {
        'owner': '/etc/gdp/owner.pem', 'catalog': '/etc/gdp/catalog.card', 'topics': ['/chatter']}
    assert config['links'] == [{'to': 'udp://10.0.0.1:31415'}]
    assert not configuration.changes({'config': '/x', 'log_level': 'info', 'token_file': '/y'})


def test_an_absolute_path_stays():
    config = configuration.merged(base(state='/var/lib/gdp'), {}, '/etc/gdp')
    assert config['state'] == '/var/lib/gdp'


def test_patterns_replace_those_of_the_file_and_the_base_is_untouched():
    before = base()
    parameters = configuration.parameters_of_arguments({
        'expose': '[/camera/**, "/odom"]', 'deny': '/camera/**/raw', 'expose_services': '[/plan]', 'config': ''})
    config = configuration.merged(before, parameters, '/etc/gdp')
    assert config['expose']['topics'] == ['/camera/**', '/odom']
    assert config['expose']['deny'] == ['/camera/**/raw']
    assert config['expose']['services'] == ['/plan']
    assert before == base()


def test_a_namespace_is_put_in_front_of_what_is_exposed():
    parameters = {'expose': ['/camera/**', '/camera/info', '/odom', '/robot7/own'], 'namespace': 'robot7'}
    config = configuration.merged(base(), parameters, '/')
    assert config['expose']['remap'] == [
        {'from': '/camera', 'to': '/robot7/camera'}, {'from': '/odom', 'to': '/robot7/odom'}]


def test_the_domain_id_is_that_of_the_only_graph():
    config = configuration.merged(base(), {'domain_id': 7}, '/')
    assert config['graphs'] == {'ros2': {'domain_id': 7}}
    graphs = {'here': {'domain_id': 1}, 'old': {'master': 'http://localhost:11311'}}
    config = configuration.merged(base(graphs=graphs), {'domain_id': 7}, '/')
    assert config['graphs']['here'] == {'domain_id': 7}
    with pytest.raises(ConfigurationError, match='2 graphs of ROS 2'):
        configuration.merged(base(graphs={'a': {'domain_id': 1}, 'b': {'domain_id': 2}}), {'domain_id': 7}, '/')


def test_a_parameters_file_is_read_and_launch_arguments_win(tmp_path, package):
    file = tmp_path / 'params.yaml'
    file.write_text(
        '/**: {ros__parameters: {use_sim_time: true, other_node: 1, log_level: debug}}\n'
        '/gdp_proxy:\n  ros__parameters: {expose: [/a], deny: [/b], domain_id: 3, use_sim_time: true}\n')
    found = prepared.parameters({'expose': '[/c]', 'deny': '', 'domain_id': ''}, str(file))
    assert found == {'log_level': 'debug', 'expose': ['/c'], 'deny': ['/b'], 'domain_id': 3}
    shipped = configuration.parameters_of_file((package / 'config' / 'proxy.params.yaml').read_text())
    assert shipped['expose'] == ['/camera/**', '/odom'] and 'namespace' not in shipped


@pytest.mark.parametrize('text, needle', [
    ('/gdp_proxy: {ros__parameters: {exposes: [/a]}}', 'unknown parameter exposes'),
    ('/gdp_proxy: {ros__parameters: {expose: /a}}', 'expose is a list'),
    ('/gdp_proxy: {ros__parameters: {expose: [a]}}', 'does not begin with a slash'),
    ('/gdp_proxy: {ros__parameters: {domain_id: 233}}', '0 to 232'),
    ('/gdp_proxy: {ros__parameters: {domain_id: true}}', '0 to 232'),
    ('/gdp_proxy: {ros__parameters: {log_level: loud}}', 'debug, info'),
    ('/gdp_proxy: {expose: [/a]}', 'ros__parameters'),
    ('/talker: {ros__parameters: {}}', 'no node /gdp_proxy'),
    ('[', 'not YAML'),
    ('text', 'no nodes'),
])
def test_what_is_wrong_in_a_parameters_file_is_named(text, needle):
    with pytest.raises(ConfigurationError, match=needle):
        configuration.parameters_of_file(text)


@pytest.mark.parametrize('parameters, needle', [
    ({'namespace': 'a b'}, 'no ROS namespace'),
    ({'namespace': 'a', 'expose': ['/**']}, 'first part of its own'),
])
def test_what_is_wrong_in_a_namespace_is_named(parameters, needle):
    with pytest.raises(ConfigurationError, match=needle):
        configuration.merged(base(), parameters, '/')
    with pytest.raises(ConfigurationError, match='gdp-proxy join'):
        configuration.merged({'version': 1}, {'expose': ['/a']}, '/')


def test_names_and_words_stay_texts():
    text = 'a: 1111111111111111111111111111111111111111111111111111111111111111\nb: no\nc: 0123\nd: 12:30\ne: 12e3\n'
    read = strict_yaml.load(text + 'f: true\ng: 12\nh: 0.5\ni: null\nj:\n')
    assert [read[key] for key in 'abcde'] == ['1' * 64, 'no', '0123', '12:30', '12e3']
    assert [read[key] for key in 'fghij'] == [True, 12, 0.5, None, None]
    assert strict_yaml.load(strict_yaml.dump(read)) == read
    assert '"12e3"' in strict_yaml.dump(read), 'a number for gdp-proxy without quotes'


def test_every_path_of_the_configuration_is_known(programs):
    """The keys of gdp-proxy that have paths, by its schema, are those that become absolute."""
    schema = json.loads(subprocess.run([programs / 'gdp-proxy', '--schema'], check=True, capture_output=True).stdout)

    def properties(node):
        while '$ref' in node or 'items' in node or 'anyOf' in node:
            if '$ref' in node:
                node = schema['$defs'][node['$ref'].rsplit('/', 1)[1]]
            elif 'items' in node:
                node = node['items']
            else:
                node = next(kind for kind in node['anyOf'] if kind.get('type') != 'null' and kind.get('type') != 'boolean')
        return node.get('properties', {})

    files = {'card', 'cert', 'grant', 'membership', 'peers', 'catalog', 'owner', 'identity', 'state', 'ros1', 'ros2'}
    found = {'': files & set(schema['properties'])}
    for section, node in schema['properties'].items():
        keys = files & set(properties(node))
        if keys and section != 'graphs':
            found[section] = keys
    assert found == {section: set(keys) for section, keys in configuration.PATHS.items()}


def test_the_real_proxy_accepts_it(member, programs):
    parameters = {
        'config': str(member / 'proxy.yaml'), 'expose': ['/camera/**', '/odom'], 'expose_services': ['/plan'],
        'expose_actions': ['/dock'], 'deny': ['/camera/**/raw'], 'namespace': '/robot7', 'domain_id': 7,
    }
    plan = prepared.Prepared(parameters)
    path = plan.write()
    done = subprocess.run([programs / 'gdp-proxy', path, '--check'], capture_output=True, text=True, cwd='/')
    assert done.returncode == 0, done.stderr
    plan.remove()

    bad = prepared.Prepared({**parameters, 'expose': ['/camera/**/**b']})
    done = subprocess.run([programs / 'gdp-proxy', bad.write(), '--check'], capture_output=True, text=True)
    assert done.returncode != 0 and 'no pattern of names' in done.stderr, done.stderr
    bad.remove()


def test_without_changes_the_file_itself_is_used_so_that_it_is_reloaded(member):
    plan = prepared.Prepared({'config': str(member / 'proxy.yaml'), 'log_level': 'debug'})
    assert plan.write() == str(member / 'proxy.yaml')
    assert configuration.environment(plan.parameters) == {'RUST_LOG': 'debug'}


def test_a_missing_file_is_named_and_a_token_joins_first(tmp_path):
    config = str(tmp_path / 'proxy.yaml')
    with pytest.raises(ConfigurationError, match='gdp-proxy join'):
        prepared.Prepared({'config': config}).write()
    parameters = {'config': config, 'token_file': '/run/token', 'expose': ['/a', '/b']}
    assert prepared.Prepared(parameters).must_join()
    assert configuration.join_command('gdp-proxy', parameters, config) == [
        'gdp-proxy', 'join', '--file', '/run/token', '--dir', str(tmp_path), '--no-run', '--expose', '/a,/b']
    (tmp_path / 'proxy.yaml').write_text('version: 1')
    assert not prepared.Prepared(parameters).must_join()
