from glob import glob
from xml.etree import ElementTree

from setuptools import find_packages, setup

NODES = (
    "tracker",
    "pose_source",
    "tip_source",
    "actuator",
    "estimator",
    "planner",
    "experiment",
    "recorder",
    "player",
    "view",
    "simulated_cell",
)

setup(
    name="pushfric_ros",
    version=ElementTree.parse("package.xml").findtext("version"),  # written there alone
    description="Robot cell that estimates the friction parameters of pushed objects.",
    maintainer="pushfric maintainers",
    maintainer_email="pushfric@users.noreply.github.com",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={
        "pushfric_ros.node_kit": ["fastdds*.xml"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/pushfric_ros"]),
        ("share/pushfric_ros", ["package.xml"]),
        ("share/pushfric_ros/launch", glob("launch/*.launch.py")),
    ],
    entry_points={
        "console_scripts": [
            "pushfric = pushfric_core.__main__:main",  # for `ros2 run pushfric_ros pushfric`
            *(f"{name}_node = pushfric_ros.node_kit.executable:main" for name in NODES),
        ],
        "pushfric.commands": ["cell = pushfric_ros.commands"],
        "pushfric.node_graph": [
            "frames = pushfric_ros.commands.topic_frames:TopicFrames",
            "stroke = pushfric_ros.commands.stroke:along_the_stroke",
        ],
        "pushfric.pushers": [
            "trajectory = pushfric_ros.arms.trajectory:JointTrajectoryConfig",
            "twist = pushfric_ros.arms.twist:TwistConfig",
        ],
        "pushfric.sources": [
            "pose_stamped = pushfric_ros.adapters.body:PoseStampedConfig",
            "transforms = pushfric_ros.adapters.body:TransformsConfig",
        ],
    },
    zip_safe=False,
)
