"""Installs the ament package gdp_ros: its modules, its launch file and the commands of `ros2 gdp`."""

from setuptools import find_packages, setup

PACKAGE = 'gdp_ros'

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + PACKAGE]),
        ('share/' + PACKAGE, ['package.xml']),
        ('share/' + PACKAGE + '/launch', ['launch/proxy.launch.py']),
        ('share/' + PACKAGE + '/config', ['config/proxy.params.yaml']),
    ],
    install_requires=['setuptools', 'pyyaml'],
    zip_safe=True,
    maintainer='GDP developers',
    maintainer_email='gdp@localhost',
    description='Starts gdp-proxy from ROS 2 launch files, and adds `ros2 gdp`.',
    license='MIT OR Apache-2.0',
    entry_points={
        'ros2cli.command': ['gdp = gdp_ros.command.gdp:GdpCommand'],
        'ros2cli.extension_point': ['gdp_ros.verb = gdp_ros.verb:VerbExtension'],
        'gdp_ros.verb': [
            'expose = gdp_ros.verb.expose:ExposeVerb',
            'list = gdp_ros.verb.list:ListVerb',
            'robots = gdp_ros.verb.robots:RobotsVerb',
            'status = gdp_ros.verb.status:StatusVerb',
        ],
    },
)
