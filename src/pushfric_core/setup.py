from xml.etree import ElementTree

from setuptools import find_packages, setup

setup(
    name="pushfric_core",
    version=ElementTree.parse("package.xml").findtext("version"),  # written there alone
    description="Friction parameters of pushed objects: mechanics of pushing and the incremental program.",
    maintainer="pushfric maintainers",
    maintainer_email="pushfric@users.noreply.github.com",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={"pushfric_core": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/pushfric_core"]),
        ("share/pushfric_core", ["package.xml"]),
    ],
    zip_safe=False,
)
