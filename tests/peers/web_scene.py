#!/usr/bin/env python3
"""A small fleet on loopback for the pictures of docs/web.md: needs no root, and runs until ^C.

A domain with four switches in a ring, three robots behind different switches, and a machine that
asks to join. Robots publish ROS topics, so that there is load. The URL of `gdp-ctl web` is printed.

    target/venv/bin/python tests/peers/web_scene.py target/release
"""

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

BASE = 41100
SWITCHES = 4
# Label, what it exposes, its switch, and its topics with rates.
ROBOTS = [
    ('arm3', '/joint_states,/wrench', 1, {'/joint_states': 100, '/wrench': 250}),
    ('robot7', '/camera/**,/odom,/tf', 2, {'/camera/info': 30, '/odom': 50, '/tf': 100}),
    ('robot8', '/scan,/battery', 3, {'/scan': 20, '/battery': 1}),
]
TALKER = '''
import sys, rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node('talker')
for pair in sys.argv[1:]:
    topic, rate = pair.split('=')
    publisher = node.create_publisher(String, topic, 10)
    message = String(data='x' * 400)
    node.create_timer(1 / float(rate), lambda p=publisher, m=message: p.publish(m))
rclpy.spin(node)
'''
LISTENER = '''
import sys, rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node('listener')
for topic in sys.argv[1:]:
    node.create_subscription(String, topic, lambda message: None, 10)
rclpy.spin(node)
'''


class Fleet:
    """Programs that end together."""

    def __init__(self, programs, folder):
        self.ctl, self.proxy, self.folder = programs / 'gdp-ctl', programs / 'gdp-proxy', folder
        self.running = []
        self.socket = folder / 'up.sock'

    def run(self, *command):
        """Run a command to its end; return what it prints."""
        environment = {**os.environ, 'GDP_SOCKET': str(self.socket)}
        return subprocess.run(
            list(map(str, command)), check=True, capture_output=True, text=True, cwd=self.folder, env=environment).stdout

    def start(self, label, *command, **environment):
        """Start a program that goes on."""
        log = open(self.folder / f'{label}.log', 'w')
        self.running.append(subprocess.Popen(
            list(map(str, command)), cwd=self.folder, stdout=log, stderr=log, stdin=subprocess.DEVNULL,
            env={**os.environ, 'GDP_SOCKET': str(self.socket), **environment}))
        return self.running[-1]

    def stop(self):
        """End all programs."""
        for process in reversed(self.running):
            process.terminate()
        for process in self.running:
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()


def wait(what, condition):
    """Wait until a condition holds."""
    for _ in range(600):
        if condition():
            return
        time.sleep(0.1)
    raise SystemExit(f'waited in vain for {what}')


def main():
    """Start everything, and wait for ^C or SIGTERM."""
    for number in (signal.SIGINT, signal.SIGTERM):
        # A shell starts background programs with SIGINT ignored.
        signal.signal(number, signal.default_int_handler)
    programs, folder = Path(sys.argv[1]).resolve(), Path(tempfile.mkdtemp(prefix='gdp-web-'))
    fleet = Fleet(programs, folder)
    try:
        start(fleet)
        signal.pause()
    except KeyboardInterrupt:
        pass
    finally:
        fleet.stop()


def start(fleet):
    """Start domain, switches, robots and page."""
    home, ctl = fleet.folder / 'home', fleet.ctl
    address = [f'127.0.0.1:{BASE + i}' for i in range(SWITCHES)]
    fleet.start('up', ctl, 'up', '--at', address[0], '--udp', address[0], '--no-xdp', '--dir', home,
                ROS_DOMAIN_ID='60')
    wait('the first switch', lambda: fleet.socket.exists() and (home / 'address').exists())
    names = [re.search(r'"switch":"([0-9a-f]{64})"', (home / 'address').read_text()).group(1)]
    for i in range(1, SWITCHES):
        fleet.run(ctl, 'key', 'generate', f's{i}.pem', '--kind', 'switch')
        names.append(re.search(r'[0-9a-f]{64}', fleet.run(ctl, 'key', 'show', f's{i}.pem', '--kind', 'switch')).group())
        fleet.run(ctl, 'domain', 'admit', '--key', home / 'domain.pem', '--role', 'switch', '-o', f's{i}.member',
                  names[i])
    for i in range(1, SWITCHES):
        near = {i - 1, (i + 1) % SWITCHES}
        neighbours = ', '.join(f'{{switch: "{names[j]}", udp: "{address[j]}"}}' for j in sorted(near))
        (fleet.folder / f's{i}.yaml').write_text(
            f'identity: s{i}.pem\nsocket: s{i}.sock\ninterfaces: []\nudp: {address[i]}\ndata_plane: userspace\nrib: false\n'
            f'domain: {{card: home/domain.card, membership: s{i}.member}}\nneighbours: [{neighbours}]\n')
        fleet.start(f's{i}', ctl, 'serve', '--config', f's{i}.yaml', '--socket', fleet.folder / f's{i}.sock')
    for number, (label, expose, switch, topics) in enumerate(ROBOTS):
        line = fleet.run(ctl, 'invite', label, '--expose', expose, '--dir', home)
        (fleet.folder / f'{label}.line').write_text(re.search(r'gdp1\S+', line).group())
        domain = str(61 + number)
        fleet.run(fleet.proxy, 'join', '--file', f'{label}.line', '--dir', fleet.folder / label, '--no-run')
        config = fleet.folder / label / 'proxy.yaml'
        text = re.sub(r'links: \[.*\]\n', f'links: [{{to: "udp://{address[switch]}"}}]\n', config.read_text())
        config.write_text(text)
        fleet.start(f'{label}-proxy', fleet.proxy, config, ROS_DOMAIN_ID=domain)
        pairs = [f'{topic}={rate}' for topic, rate in topics.items()]
        fleet.start(f'{label}-talker', sys.executable, '-c', TALKER, *pairs, ROS_DOMAIN_ID=domain)
    fleet.run(ctl, 'invite', 'drone1', '--expose', '/pose', '--dir', home)
    remote = [f'/{label}{topic}' for label, _, _, topics in ROBOTS for topic in topics]
    fleet.start('listener', sys.executable, '-c', LISTENER, *remote, ROS_DOMAIN_ID='60')
    line = fleet.run(ctl, 'invite', '--dir', home)
    (fleet.folder / 'applicants.line').write_text(re.search(r'gdp1\S+', line).group())
    fleet.start('applicant', fleet.proxy, 'join', '--file', 'applicants.line', '--label', 'cart4', '--expose', '/odom',
                '--dir', fleet.folder / 'cart4', '--no-run')
    token = os.urandom(32).hex()
    with open(os.open(fleet.folder / 'token', os.O_WRONLY | os.O_CREAT, 0o600), 'w') as file:
        file.write(token)
    fleet.start('web', ctl, 'web', '--listen', f'127.0.0.1:{BASE + 50}', '--dir', home, '--token-file', 'token')
    wait('the page', lambda: 'token=' in (fleet.folder / 'web.log').read_text())
    print(re.search(r'http://\S+=', (fleet.folder / 'web.log').read_text()).group() + token, flush=True)
    print(fleet.folder, flush=True)


if __name__ == '__main__':
    main()
