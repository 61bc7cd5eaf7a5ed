"""The launch file, with the real `launch` of ROS 2 where it is installed, else with its stand-in."""

import importlib.util
import os
import signal
import subprocess
import sys
import time

from conftest import is_real

import pytest

REAL = is_real('launch')


def description(package):
    """Return the launch description of the launch file."""
    spec = importlib.util.spec_from_file_location('proxy_launch', package / 'launch' / 'proxy.launch.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module, module.generate_launch_description()


def started(package, **values):
    """Return the actions for launch arguments."""
    from launch import LaunchContext
    module, described = description(package)
    context = LaunchContext()
    context.launch_configurations.update(values)
    *arguments, opaque = described.entities
    for argument in arguments:
        argument.execute(context)
    return module, opaque.execute(context)


def command(process):
    """Return the command of a process."""
    cmd = getattr(process, 'cmd')
    return [part if isinstance(part, str) else part[0].text for part in cmd]


def test_the_arguments_are_declared(package):
    from launch.actions import DeclareLaunchArgument
    _, described = description(package)
    names = [entity.name for entity in described.entities if isinstance(entity, DeclareLaunchArgument)]
    assert names == ['config', 'expose', 'expose_services', 'expose_actions', 'deny', 'token_file', 'domain_id',
                     'namespace', 'log_level', 'params_file']


def test_the_proxy_runs_with_the_file_or_with_a_changed_copy(package, member):
    config = str(member / 'proxy.yaml')
    _, [process, _] = started(package, config=config)
    assert command(process)[1:] == [config] and command(process)[0].endswith('/gdp-proxy')
    _, [process, remove] = started(package, config=config, expose='[/camera/**]', log_level='debug')
    changed = command(process)[1]
    with open(changed, encoding='utf-8') as file:
        assert '"/camera/**"' in file.read()
    assert os.stat(changed).st_uid == os.geteuid() and os.stat(os.path.dirname(changed)).st_mode & 0o077 == 0


def test_what_is_wrong_ends_the_launch_with_the_reason(package, member, tmp_path):
    config = str(member / 'proxy.yaml')
    for values, needle in [({'config': config, 'domain_id': 'x'}, '0 to 232'), ({'config': '/none'}, 'token_file')]:
        with pytest.raises(RuntimeError, match=needle):
            started(package, **values)


@pytest.mark.skipif(REAL, reason='the stand-in alone shows the handlers')
def test_a_token_joins_first_and_a_failure_ends_the_launch(package, member, tmp_path):
    config = str(tmp_path / 'new' / 'proxy.yaml')
    module, [handler, join] = started(package, config=config, token_file='/run/token')
    assert command(join)[1:] == ['join', '--file', '/run/token', '--dir', str(tmp_path / 'new'), '--no-run']
    on_exit = handler.event_handler.on_exit

    class Event:
        returncode = 1

    kinds = [type(action).__name__ for action in on_exit(Event, None)]
    assert kinds == ['LogInfo', 'EmitEvent']
    (tmp_path / 'new').mkdir()
    (tmp_path / 'new' / 'proxy.yaml').write_text('version: 1')
    Event.returncode = 0
    [process, _] = on_exit(Event, None)
    assert command(process)[1] == config and process.respawn
    # What only shows after joining ends the launch with the reason too.
    os.remove(config)
    [reason, end] = on_exit(Event, None)
    assert [type(reason).__name__, type(end).__name__] == ['LogInfo', 'EmitEvent']
    assert 'has joined' in reason.msg and config in reason.msg


def test_nothing_joins_that_could_not_start_afterwards(package, member, tmp_path):
    new = tmp_path / 'new'
    for values, needle in [({'config': str(new / 'robot.yaml')}, 'config:=.*/new/proxy.yaml'),
                           ({'config': str(new / 'proxy.yaml'), 'namespace': '9/x'}, 'no ROS namespace'),
                           ({'config': str(new / 'proxy.yaml'), 'namespace': 'r', 'expose': '/**'}, 'first part')]:
        with pytest.raises(RuntimeError, match=needle):
            started(package, token_file='/run/token', **values)
    # A machine that has joined may call its configuration what it likes.
    own = member / 'robot.yaml'
    own.write_text((member / 'proxy.yaml').read_text())
    _, [process, _] = started(package, token_file='/run/token', config=str(own))
    assert command(process)[1] == str(own)


@pytest.mark.skipif(not REAL, reason='`launch` of ROS 2 is not installed, and no registry has it')
def test_a_real_launch_runs_the_real_proxy_and_starts_it_again(package, member):
    runner = (
        'import sys; from launch import LaunchService, LaunchDescription;'
        'from launch.actions import IncludeLaunchDescription;'
        'from launch.launch_description_sources import PythonLaunchDescriptionSource as Source;'
        'arguments = [tuple(pair.split("=", 1)) for pair in sys.argv[2:]];'
        'service = LaunchService();'
        'service.include_launch_description(LaunchDescription(['
        'IncludeLaunchDescription(Source(sys.argv[1]), launch_arguments=arguments)])); sys.exit(service.run())')
    arguments = [f'config={member}/proxy.yaml', 'expose=[/camera/**]', 'domain_id=97', 'log_level=info']
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path), 'ROS_LOG_DIR': str(member / 'log')}
    launch = subprocess.Popen(
        [sys.executable, '-c', runner, str(package / 'launch' / 'proxy.launch.py'), *arguments], env=environment,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        first = child(launch.pid)
        os.kill(first, signal.SIGKILL)
        second = child(launch.pid, other_than=first)
        with open(f'/proc/{second}/cmdline', encoding='utf-8') as file:
            written = file.read().split('\0')[1]
        assert os.path.exists(written)
        launch.send_signal(signal.SIGINT)
        output, _ = launch.communicate(timeout=30)
    finally:
        launch.kill()
    assert 'gdp_proxy' in output, output
    assert not os.path.exists(written), 'the copy is removed at the end'


def child(parent, other_than=None):
    """Return the pid of a proxy that this process started."""
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        with open(f'/proc/{parent}/task/{parent}/children', encoding='utf-8') as file:
            for pid in map(int, file.read().split()):
                with open(f'/proc/{pid}/cmdline', encoding='utf-8') as command_line:
                    is_proxy = command_line.read().split('\0')[0].endswith('/gdp-proxy')
                if pid != other_than and is_proxy:
                    return pid
        time.sleep(0.05)
    raise AssertionError('the proxy does not run')
