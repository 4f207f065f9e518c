"""A node of rclpy that maps with `ss.Slam`: /scan and /odom in, /pose, /map and the transform of the map out.

It needs ROS 2 with rclpy and tf2_ros, in a Python in which Sixth Sense is installed. It was compiled, and not run.
"""

import math

import numpy as np
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import LaserScan
from tf2_ros import TransformBroadcaster

import sixthsense as ss


class Mapper(Node):
    """Maps scans of the configured laser, which sits at `laser.mount`."""

    def __init__(self):
        super().__init__("sixthsense")
        self.odometry, self.slam = None, None
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.pose = self.create_publisher(PoseWithCovarianceStamped, "/pose", 10)
        self.map = self.create_publisher(OccupancyGrid, "/map", latched)
        self.tf = TransformBroadcaster(self)
        self.create_subscription(Odometry, "/odom", self.on_odometry, qos_profile_sensor_data)
        self.create_subscription(LaserScan, "/scan", self.on_scan, qos_profile_sensor_data)
        self.create_timer(2.0, self.send_map)

    def on_odometry(self, message):
        p, q = message.pose.pose.position, message.pose.pose.orientation
        heading = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
        self.odometry, self.odom_frame = ss.Pose(p.x, p.y, heading), message.header.frame_id

    def on_scan(self, message):
        if self.odometry is None:
            return
        if self.slam is None:
            fov = message.angle_increment * (len(message.ranges) - 1)
            laser = {"beams": len(message.ranges), "fov": fov, "max_range": message.range_max}
            self.slam = ss.Slam(ss.preset("log", laser=laser), start=self.odometry)
        stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        step = self.slam.scan(stamp_ns, np.array(message.ranges), self.odometry)
        self.send_pose(message.header.stamp, step.pose)

    def send_pose(self, stamp, T_map_robot):
        pose, T_map_odom = PoseWithCovarianceStamped(), T_map_robot @ self.odometry.inverse()
        pose.header.stamp, pose.header.frame_id = stamp, "map"
        pose.pose.pose.position.x, pose.pose.pose.position.y = T_map_robot.x, T_map_robot.y
        turn = pose.pose.pose.orientation
        turn.z, turn.w = math.sin(0.5 * T_map_robot.theta), math.cos(0.5 * T_map_robot.theta)
        cov = np.zeros((6, 6))
        cov[np.ix_([0, 1, 5], [0, 1, 5])] = self.slam.estimate().pose_cov
        pose.pose.covariance = cov.ravel().tolist()
        self.pose.publish(pose)
        link = TransformStamped()
        link.header.stamp, link.header.frame_id, link.child_frame_id = stamp, "map", self.odom_frame
        link.transform.translation.x, link.transform.translation.y = T_map_odom.x, T_map_odom.y
        turn = link.transform.rotation
        turn.z, turn.w = math.sin(0.5 * T_map_odom.theta), math.cos(0.5 * T_map_odom.theta)
        self.tf.sendTransform(link)

    def send_map(self):
        if self.slam is None or not len(self.slam.trajectory()):
            return
        grid, message = self.slam.draw_map(), OccupancyGrid()
        cells = np.where(grid.obstacles, 100, np.where(grid.seen, 0, -1)).astype(np.int8)
        message.header.stamp, message.header.frame_id = self.get_clock().now().to_msg(), "map"
        message.info.resolution = self.slam.config.grid.cell_m
        message.info.height, message.info.width = cells.shape
        message.info.origin.position.x, message.info.origin.position.y = grid.origin
        message.data = cells.ravel().tolist()
        self.map.publish(message)


rclpy.init()
rclpy.spin(Mapper())
