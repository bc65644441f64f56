"""The object's pose on /tf, for RViz and other users of tf2, if tf2_msgs is installed."""

from geometry_msgs.msg import PoseWithCovarianceStamped, Transform, TransformStamped, Vector3
from rclpy.node import Node

from pushfric_ros.messages.conversions import OBJECT
from pushfric_ros.node_kit.qos import RELIABLE


class TransformBroadcaster:
    """Publishes poses of the object as the transform to its frame; without tf2_msgs it only logs that once."""

    def __init__(self, node: Node) -> None:
        try:
            from tf2_msgs.msg import TFMessage  # type: ignore[import-not-found]
        except ImportError:
            node.get_logger().info("tf2_msgs is not installed: the object's pose is only on object_pose, not on /tf")
            self._out = None
        else:
            self._message, self._out = TFMessage, node.create_publisher(TFMessage, "/tf", RELIABLE)

    def broadcast(self, msg: PoseWithCovarianceStamped) -> None:
        """Publish a pose of the object."""
        if self._out is not None:
            self._out.publish(self._message(transforms=[pose_to_transform(msg)]))


def pose_to_transform(msg: PoseWithCovarianceStamped) -> TransformStamped:
    """The transform from the frame of a pose to the object frame."""
    pose = msg.pose.pose
    shift = Vector3(x=pose.position.x, y=pose.position.y, z=pose.position.z)
    return TransformStamped(
        header=msg.header, child_frame_id=OBJECT, transform=Transform(translation=shift, rotation=pose.orientation)
    )
