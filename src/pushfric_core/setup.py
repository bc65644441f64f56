import pathlib
from xml.etree import ElementTree

from setuptools import Extension, find_packages, setup
from setuptools.command.build_ext import build_ext

try:
    from Cython import __version__ as version
except ImportError:
    version = "0"

CYTHON = tuple(int(number) for number in version.split(".")[:2])
SHARES = (3, 1)
"""Since this version of Cython, modules can share what it adds."""

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


SHARED = "pushfric_core._cyutility"
"""The module of Cython's code for arrays, made once for all: half of what there is to compile, and none of it in a loop."""


def compiled() -> list[Extension]:
    """The inner loops: modules with types in a .pxd. Without Cython 3 or a compiler they stay Python: the same bits, a hundred
    times slower.
    """
    if CYTHON < (3,):
        return []
    loops = [
        Extension(
            ".".join(types.with_suffix("").parts),
            [str(types.with_suffix(".py"))],
            # no fused multiply-add: the same bits on every machine; nobody reads errno, which costs a fifth of the time
            extra_compile_args=["-O3", "-g0", "-ffp-contract=off", "-fno-math-errno"],
            optional=True,
        )
        for types in sorted(pathlib.Path("pushfric_core").rglob("*.pxd"))
    ]
    shared = Extension(SHARED, [f"{SHARED.replace('.', '/')}.c"], extra_compile_args=["-O1", "-g0"], optional=True)
    return loops + [shared] * (CYTHON >= SHARES)


class BuildExtensions(build_ext):
    """Makes C of the modules when they are built, not whenever somebody asks this file for something else, as colcon does."""

    def build_extensions(self) -> None:
        from Cython.Build import cythonize

        sharing = {"shared_utility_qualified_name": SHARED} if CYTHON >= SHARES else {}
        made = cythonize(self.extensions, build_dir="build", quiet=True, compiler_directives=DIRECTIVES, **sharing)
        for extension, in_c in zip(self.extensions, made, strict=True):
            extension.sources = in_c.sources
        super().build_extensions()


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
    cmdclass={"build_ext": BuildExtensions},
    package_data={
        "pushfric_core": ["py.typed", "*.pyi"],
        "": ["*.pxd"],
        "pushfric_core.bags": ["msg/*.msg"],
        "pushfric_core.page": ["run/*", "work/*"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/pushfric_core"]),
        ("share/pushfric_core", ["package.xml"]),
    ],
    entry_points={
        "console_scripts": ["pushfric = pushfric_core.__main__:main"],
        "pushfric.pushers": [
            "grbl = pushfric_core.pushers.serial_config:GrblConfig",
        ],
        "pushfric.simulations": ["grbl = pushfric_core.simulated.grbl_firmware:SimulatedGrbl"],
        "pushfric.trackers": [
            "contour = pushfric_core.vision.tracker_settings:ContourConfig",
            "fiducial = pushfric_core.vision.tracker_settings:FiducialConfig",
        ],
    },
    zip_safe=False,
)
