"""The version of the plugin system."""

PLUGIN_SYSTEM_VERSION = '0.1'


def satisfies_version(version, caret_range):
    """Check the version."""
    assert (version, caret_range) == ('0.1', '^0.1')
