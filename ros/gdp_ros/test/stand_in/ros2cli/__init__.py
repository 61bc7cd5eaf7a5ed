"""The part of ros2cli that plugins derive from and call."""
