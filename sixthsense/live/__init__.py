"""A robot on a ROS 2 network: its messages as a `Source`, the results published; and a simulated robot to test with."""
