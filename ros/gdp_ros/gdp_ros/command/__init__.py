"""The command that ros2cli finds."""
