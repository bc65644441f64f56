import pathlib
from xml.etree import ElementTree

from setuptools import Extension, find_packages, setup

DESCRIPTION = """\
Where the support friction of a pushed object lies, its centre of friction, and the friction at the contact, from pushes: the
method of Lynch, "Estimating the Friction Parameters of Pushed Objects" (IROS 1993), with its uncertainty. It needs no ROS.
"""

DIRECTIVES = {
    "annotation_typing": False,  # the .pxd have the types
    "boundscheck": False,
    "cdivision": True,
    "infer_types": True,
    "initializedcheck": False,
    "wraparound": False,
}


def compiled() -> list[Extension]:
    """The inner loops: modules with types in a .pxd. Without Cython 3 or a compiler they stay Python: the same bits, a hundred
    times slower.
    """
    try:
        from Cython import __version__
        from Cython.Build import cythonize
    except ImportError:
        return []
    if int(__version__.partition(".")[0]) < 3:
        return []
    loops = [
        Extension(
            ".".join(types.with_suffix("").parts),
            [str(types.with_suffix(".py"))],
            extra_compile_args=["-O3", "-g0", "-ffp-contract=off"],  # no fused multiply-add: the same bits on every machine
            optional=True,
        )
        for types in sorted(pathlib.Path("pushfric_core").rglob("*.pxd"))
    ]
    return cythonize(loops, build_dir="build", quiet=True, compiler_directives=DIRECTIVES)


setup(
    name="pushfric_core",
    version=ElementTree.parse("package.xml").findtext("version"),  # written there alone
    python_requires=">=3.11",
    long_description=DESCRIPTION,
    long_description_content_type="text/markdown",
    url="https://github.com/pushfric/pushfric",
    classifiers=["Programming Language :: Python :: 3", "Topic :: Scientific/Engineering"],
    description="Friction parameters of pushed objects: estimation, prediction, bags, cameras and pushers, without ROS.",
    maintainer="pushfric maintainers",
    maintainer_email="pushfric@users.noreply.github.com",
    license="Apache-2.0",
    packages=find_packages(),
    ext_modules=compiled(),
    package_data={
        "pushfric_core": ["py.typed"],
        "": ["*.pxd", "*.html.j2"],
        "pushfric_core.bags": ["msg/*.msg"],
        "pushfric_core.report": ["run/*"],
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
