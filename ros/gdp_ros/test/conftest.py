"""Finds the package without an installation, and real programs of ROS where there are any.

`GDP_BIN` is the folder of gdp-ctl and gdp-proxy.
"""

import os
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(PACKAGE))

# What a member of a domain has after `gdp-proxy join`, with relative paths in every section.
MEMBER = """\
version: 1
identity: proxy.pem
links: [{to: "udp://127.0.0.1:9"}]
state: state
expose: {owner: owner.pem, catalog: catalog.card, topics: [/chatter]}
"""


@pytest.fixture
def package():
    """Return the folder of the package."""
    return PACKAGE


@pytest.fixture
def programs():
    """Return the folder of gdp-ctl and gdp-proxy."""
    folder = os.environ.get('GDP_BIN')
    assert folder and (Path(folder) / 'gdp-proxy').is_file(), 'set GDP_BIN to the folder of gdp-ctl and gdp-proxy'
    return Path(folder)


@pytest.fixture
def member(tmp_path, programs):
    """Return the folder of a machine with keys of its own and a configuration."""
    import subprocess

    def ctl(*arguments):
        subprocess.run([programs / 'gdp-ctl', *arguments], cwd=tmp_path, check=True, stdout=subprocess.DEVNULL)

    ctl('key', 'generate', 'proxy.pem', '--kind', 'proxy')
    ctl('key', 'generate', 'owner.pem', '--kind', 'owner')
    ctl('name', 'create', '--owner', 'owner.pem', '--kind', 'catalog', '--topic', 'robot1', '-o', 'catalog.card')
    (tmp_path / 'proxy.yaml').write_text(MEMBER)
    return tmp_path


def is_real(module):
    """Return whether a module of ROS 2 is there. Otherwise its stand-in is, from now on."""
    import importlib.util
    found = importlib.util.find_spec(module)
    if found is not None and 'stand_in' not in str(found.origin):
        return True
    stand_ins = str(PACKAGE / 'test' / 'stand_in')
    if stand_ins not in sys.path:
        sys.path.append(stand_ins)
    print(f'{module} is not installed, because no registry has it: its stand-in is used')
    return False
