"""`ros2 gdp`, with the real ros2cli where it is installed, else with its stand-in."""

import argparse
import json

from conftest import is_real

import pytest

REAL = is_real('ros2cli')


def run(arguments, capsys):
    """Run `ros2 gdp` with these arguments; return the exit status and what it prints."""
    from gdp_ros.command.gdp import GdpCommand
    parser = argparse.ArgumentParser(prog='ros2 gdp', formatter_class=argparse.RawDescriptionHelpFormatter)
    command = GdpCommand()
    if REAL:
        # It looks up the verbs among installed packages.
        import importlib.metadata
        if not any(e.group == 'gdp_ros.verb' for e in importlib.metadata.entry_points(group='gdp_ros.verb')):
            pytest.skip('gdp_ros is not installed beside the real ros2cli')
        import sys
        old, sys.argv = sys.argv, ['ros2', *arguments]
        try:
            command.add_arguments(parser, 'ros2 gdp')
        finally:
            sys.argv = old
    else:
        command.add_arguments(parser, 'ros2 gdp')
    status = command.main(parser=parser, args=parser.parse_args(arguments))
    return status, capsys.readouterr()


def test_setup_lists_what_exists(package):
    from ros2cli import command as ros2cli_command
    if REAL:
        import importlib.metadata
        found = {e.name: e.load() for e in importlib.metadata.entry_points(group='gdp_ros.verb')}
    else:
        found = {n: ros2cli_command.load(r) for n, r in ros2cli_command.entry_points('gdp_ros.verb').items()}
        command = ros2cli_command.entry_points('ros2cli.command')
        assert ros2cli_command.load(command['gdp']).__name__ == 'GdpCommand'
    if found:
        assert sorted(found) == ['expose', 'list', 'robots', 'status']
        assert all(verb.__doc__ for verb in found.values())


def test_without_a_verb_the_help_is_printed(capsys, programs):
    status, printed = run([], capsys)
    assert status == 0 and 'status' in printed.out


def test_a_failure_of_gdp_ctl_is_passed_on(capfd, programs, tmp_path, monkeypatch):
    monkeypatch.setenv('GDP_SOCKET', str(tmp_path / 'none.sock'))
    status, printed = run(['status'], capfd)
    assert status == 3 and 'no daemon answers' in printed.err and printed.out == ''
    status, printed = run(['status', '-j'], capfd)
    assert status == 3 and json.loads(printed.out)['error']['code'] == 'NoDaemon'


def test_a_missing_program_is_named(capfd, monkeypatch, tmp_path):
    monkeypatch.setenv('GDP_BIN', str(tmp_path))
    status, printed = run(['list'], capfd)
    assert status == 1 and 'gdp-ctl is not installed' in printed.err


def test_the_list_shows_cards_of_the_keyring(capfd, member, monkeypatch, programs):
    """A fake gdp-ctl is not needed: with --json the real one asks the RIB, so its failure shows."""
    monkeypatch.setenv('GDP_KEYRING', str(member))
    monkeypatch.setenv('GDP_SOCKET', str(member / 'none.sock'))
    status, printed = run(['list', 'service'], capfd)
    assert status != 0 and printed.err


def test_expose_shows_what_would_cross(capfd, member, programs):
    status, printed = run(['expose', '/camera/**', '--config', f'{member}/proxy.yaml', '--seconds', '1'], capfd)
    assert status == 0 and ('nothing is in this graph' in printed.out or 'crosses' in printed.out), printed
    status, printed = run(['expose', 'camera', '--config', f'{member}/proxy.yaml'], capfd)
    assert status == 1 and 'begin with a slash' in printed.err


def test_answers_become_lines_with_harmless_texts():
    from gdp_ros.ctl import printable
    from gdp_ros.verb import expose, list as listing, robots, status
    lines = listing.lines({'topics': [
        {'topic': '/a', 'type': 'std_msgs/msg/String', 'name': '7' * 64, 'publishers': ['x'], 'subscribers': []}]})
    assert lines[1].split() == ['/a', 'std_msgs/msg/String', '1', '0']
    assert listing.lines({'services': []}) == ['no services']
    rows = robots.lines({'members': [{
        'label': 'robot7', 'state': 'online', 'expose': ['/chatter'], 'import': [], 'read': []}]})
    assert rows[1].split() == ['robot7', 'online', '/chatter', '–', '–']
    report = {'topics': [{'topic': '/a\x1b[2J', 'type': None, 'direction': None, 'because': 'no pattern'}], 'calls': []}
    assert expose.lines(report)[1].startswith('/a\\x1b[2J')
    assert printable('a\x1b\u202eb') == 'a\\x1b\\u202eb'
    own = {
        'name': '7' * 64, 'data_plane': 'userspace', 'control': {'ready': False, 'reason': 'no path'}, 'links': [],
        'topology': {'reached': 1, 'switches': 3}, 'fib': {'names': 2}, 'errors': ['of e1'],
        'counters': {'forwarded': 9, 'drop_no_route': 2},
    }
    text = '\n'.join(status.lines(own))
    for needle in ['not reached: no path', '1 of 3', '9 forwarded, 2 dropped', 'of e1']:
        assert needle in text
