# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What other rooms and the tests use of the node. It imports rclpy, so the client does without."""

from bvh_ros.ros.conversions import nanoseconds
from bvh_ros.ros.parameters import ConfigurationError, SourceSettings, TransformSettings
from bvh_ros.ros.qos import DEPTH, REQUESTS, Delivery
from bvh_ros.ros.server import BvhServer, has_typed_services
from bvh_ros.ros.sources import SOURCE_TYPES, create_source
from bvh_ros.ros.world.frames import FrameError, Frames, Transform, listen_to_tf2
