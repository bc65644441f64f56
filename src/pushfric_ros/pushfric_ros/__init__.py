"""The robot cell around pushfric_core: nodes, launch files, and the commands that need a node graph."""

import contextlib

with contextlib.suppress(ImportError):  # `./pushfric` looks at the names of commands before anything is installed
    import pushfric_core.vision  # noqa: F401 - sets a limit that OpenCV reads as it is loaded
