# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A custom source: a node that makes boxes of LaserScans, for a `PointCloud2` source of bvh_node.

bvh_node --ros-args -p sources:=[laser] -p laser.type:=PointCloud2 -p laser.topic:=/laser_boxes
python examples/laser_scan_source.py
"""

from array import array

import numpy as np
from needs import ROS, command_line, end_with

try:
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from rclpy.node import Node
    from rclpy.utilities import remove_ros_args
    from sensor_msgs.msg import LaserScan, PointCloud2, PointField
except ImportError:
    end_with(ROS)

BOX = np.dtype([(name, '<f4') for name in ('x', 'y', 'z', 'sx', 'sy', 'sz')])
HEIGHT = 0.2  # m, of a box: a scan sees one plane only


class LaserScanSource(Node):
    """Publishes a box for each return, as wide as the beam is there."""

    def __init__(self) -> None:
        super().__init__('laser_scan_source')
        self.scans = self.boxes = 0
        self._publisher = self.create_publisher(PointCloud2, '/laser_boxes', 10)
        self.create_subscription(LaserScan, '/scan', self._receive, 10)

    def _receive(self, scan: LaserScan) -> None:
        ranges = np.asarray(scan.ranges)
        angles = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
        hit = np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges <= scan.range_max)
        boxes = np.zeros(np.count_nonzero(hit), BOX)
        boxes['x'], boxes['y'] = (ranges * np.cos(angles))[hit], (ranges * np.sin(angles))[hit]
        boxes['sx'] = boxes['sy'] = np.maximum(ranges[hit] * abs(scan.angle_increment), 0.02)
        boxes['sz'] = HEIGHT
        cloud = PointCloud2(height=1, width=len(boxes), point_step=BOX.itemsize, is_dense=True)
        cloud.header, cloud.row_step = scan.header, boxes.nbytes
        cloud.fields = [
            PointField(name=name, offset=4 * k, datatype=PointField.FLOAT32, count=1)
            for k, name in enumerate(BOX.names)
        ]
        cloud.data = array('B', boxes.tobytes())
        self._publisher.publish(cloud)
        self.scans, self.boxes = self.scans + 1, self.boxes + len(boxes)
        if self.scans == 1:
            print(f'The first scan has come: {len(boxes)} boxes.', flush=True)


def main() -> None:
    """Serve until Ctrl-C."""
    command_line(__doc__).parse_args(remove_ros_args()[1:])
    print('Scans on /scan become boxes on /laser_boxes, until Ctrl-C.', flush=True)
    rclpy.init()
    node = LaserScanSource()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        print(f'{node.scans} scans became {node.boxes} boxes.', flush=True)
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == '__main__':
    main()
