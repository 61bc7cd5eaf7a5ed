"""The Global Data Plane in ROS 2: a launch file for gdp-proxy, and `ros2 gdp`."""
