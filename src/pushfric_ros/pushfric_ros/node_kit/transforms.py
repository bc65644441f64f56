"""Transforms on /tf and /tf_static, for RViz and other users of tf2, if tf2_msgs is installed."""

from geometry_msgs.msg import PoseWithCovarianceStamped, Quaternion, Transform, TransformStamped, Vector3
from rclpy.node import Node

from pushfric_core.geometry.planar import CAMERA, OBJECT, TABLE, Array
from pushfric_ros.node_kit.qos import LATCHED, RELIABLE

TYPE = "tf2_msgs/msg/TFMessage"


class TransformBroadcaster:
    """Publishes transforms of a node; without tf2_msgs it only logs that once.

    Args:
        node: the node.
        frame_prefix: of the cell's frames.
        fixed: the transforms never change: they go to /tf_static, where late subscribers get them.
    """

    def __init__(self, node: Node, frame_prefix: str, fixed: bool = False) -> None:
        self.topic, self.qos = ("/tf_static", LATCHED) if fixed else ("/tf", RELIABLE)
        self._prefix = frame_prefix
        try:
            from tf2_msgs.msg import TFMessage  # type: ignore[import-not-found]
        except ImportError:
            node.get_logger().info(f"tf2_msgs is not installed: no transforms on {self.topic}")
            self._out = None
        else:
            self._message, self._out = TFMessage, node.create_publisher(TFMessage, self.topic, self.qos)

    def broadcast(self, transform: TransformStamped) -> None:
        """Publish a transform between frames of the cell, which are named without the prefix."""
        if self._out is not None:
            transform.header.frame_id = self._prefix + transform.header.frame_id
            transform.child_frame_id = self._prefix + transform.child_frame_id
            self._out.publish(self._message(transforms=[transform]))


def object_transform(msg: PoseWithCovarianceStamped) -> TransformStamped:
    """From the table to the object, whose pose on the table this is."""
    at = msg.pose.pose.position
    transform = TransformStamped(child_frame_id=OBJECT)
    transform.header.frame_id, transform.header.stamp = TABLE, msg.header.stamp
    transform.transform = Transform(translation=Vector3(x=at.x, y=at.y, z=at.z), rotation=msg.pose.pose.orientation)
    return transform


def camera_transform(position: Array, quaternion: Array) -> TransformStamped:
    """From the table to the camera.

    Args:
        position: (3,) of the camera in the table frame [m].
        quaternion: (4,) x, y, z, w: of the camera's axes in the table frame.
    """
    transform = TransformStamped(child_frame_id=CAMERA)
    transform.header.frame_id = TABLE
    x, y, z, w = map(float, quaternion)
    shift = Vector3(x=float(position[0]), y=float(position[1]), z=float(position[2]))
    transform.transform = Transform(translation=shift, rotation=Quaternion(x=x, y=y, z=z, w=w))
    return transform
