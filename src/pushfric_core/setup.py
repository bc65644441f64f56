from xml.etree import ElementTree

from setuptools import find_packages, setup

setup(
    name="pushfric_core",
    version=ElementTree.parse("package.xml").findtext("version"),  # written there alone
    description="Friction parameters of pushed objects: estimation, prediction, bags, cameras and pushers, without ROS.",
    maintainer="pushfric maintainers",
    maintainer_email="pushfric@users.noreply.github.com",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={
        "pushfric_core": ["py.typed"],
        "pushfric_core.bags": ["msg/*.msg"],
        "pushfric_core.paper": ["report.html.j2"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/pushfric_core"]),
        ("share/pushfric_core", ["package.xml"]),
    ],
    entry_points={
        "console_scripts": ["pushfric = pushfric_core.__main__:main"],
        "pushfric.pushers": ["grbl = pushfric_core.pushers.grbl_config:GrblConfig"],
        "pushfric.trackers": [
            "contour = pushfric_core.vision.tracker_settings:ContourConfig",
            "fiducial = pushfric_core.vision.tracker_settings:FiducialConfig",
        ],
    },
    zip_safe=False,
)
