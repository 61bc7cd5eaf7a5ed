"""Starts gdp-proxy: ros2 launch gdp_ros proxy.launch.py expose:="[/camera/**]"."""

from gdp_ros import configuration, prepared
from gdp_ros.configuration import ConfigurationError
from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument, EmitEvent, ExecuteProcess, LogInfo, OpaqueFunction, RegisterEventHandler)
from launch.event_handlers import OnProcessExit, OnShutdown
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration

# Seconds before a proxy that ended is started again.
RESPAWN_DELAY = 2.0

ARGUMENTS = {
    'config': "The proxy's configuration. Default: what `gdp-proxy join` wrote.",
    'expose': 'Patterns of topics that others may read, such as "[/camera/**]", instead of those in the file.',
    'expose_services': 'Patterns of services that others may call, instead of those in the file.',
    'expose_actions': 'Patterns of actions that others may use, instead of those in the file.',
    'deny': 'Patterns that are never exposed, whatever else matches.',
    'token_file': 'File with an invitation, with which this machine joins a domain if it has not yet.',
    'domain_id': 'ROS domain ID of the graph. Default: that of the file, else ROS_DOMAIN_ID.',
    'namespace': 'Namespace in front of what is exposed, as others see it.',
    'log_level': 'debug, info, warn, error or fatal.',
}


def proxy(plan):
    """Return the actions that run the proxy until the launch ends."""
    process = ExecuteProcess(
        cmd=[prepared.program('gdp-proxy'), plan.write()],
        name='gdp_proxy',
        output='both',
        additional_env=configuration.environment(plan.parameters),
        respawn=True,
        respawn_delay=RESPAWN_DELAY,
    )
    remove = RegisterEventHandler(OnShutdown(on_shutdown=lambda event, context: plan.remove()))
    return [process, remove]


def after_join(plan):
    """Return the handler that runs the proxy once the machine has joined."""
    def joined(event, context):
        if event.returncode != 0:
            return ended('gdp-proxy join failed; its message is above')
        try:
            return proxy(plan)
        except (ConfigurationError, OSError) as error:
            return ended(f'this machine has joined, but the proxy cannot start: {error}')
    return joined


def ended(reason):
    """Return the actions that say why, and end the launch."""
    reason = f'gdp_ros: {reason}'
    return [LogInfo(msg=reason), EmitEvent(event=Shutdown(reason=reason))]


def start(context):
    """Return the actions for the values of the launch arguments."""
    values = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    try:
        params_file = LaunchConfiguration('params_file').perform(context)
        plan = prepared.Prepared(prepared.parameters(values, params_file))
        if not plan.must_join():
            return proxy(plan)
        command = configuration.join_command(prepared.program('gdp-proxy'), plan.parameters, plan.base)
    except ConfigurationError as error:
        # Without the stack, which says nothing to whoever typed the argument.
        raise RuntimeError(f'gdp_ros: {error}') from None
    join = ExecuteProcess(cmd=command, name='gdp_proxy_join', output='both')
    return [RegisterEventHandler(OnProcessExit(target_action=join, on_exit=after_join(plan))), join]


def generate_launch_description():
    """Return the description that `ros2 launch` runs."""
    arguments = [DeclareLaunchArgument(name, default_value='', description=text) for name, text in ARGUMENTS.items()]
    params_file = DeclareLaunchArgument(
        'params_file', default_value='', description='ROS parameters file with the same, under /gdp_proxy.')
    return LaunchDescription([*arguments, params_file, OpaqueFunction(function=start)])
