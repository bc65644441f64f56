"""The settings of pushfric's own trackers: the entry points `contour` and `fiducial` of the group `pushfric.trackers`."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pushfric_core.settings import Ranged, setting
from pushfric_core.vision.sighting import Tracker

if TYPE_CHECKING:
    from pushfric_core.files.object_file import ObjectModel
    from pushfric_core.vision.camera import Camera


@dataclass(frozen=True)
class ContourConfig(Ranged):
    """A bright object on a dark table, seen by its outline."""

    threshold: int = setting(0, "grey level between table and object; 0: found in each frame (Otsu)", 0, 255)

    def open_tracker(self, camera: "Camera", model: "ObjectModel", height: float) -> Tracker:
        """See TrackerDriver."""
        from pushfric_core.vision.contour_tracker import ContourTracker

        return ContourTracker(camera, model.outline.vertices, height, self.threshold or None)

    def absence(self) -> None:
        """None: the tracker needs nothing else."""


@dataclass(frozen=True)
class FiducialConfig:
    """An object of any colour, seen by the ArUco or AprilTag markers on it."""

    fiducials: str = setting("", "path of the YAML file of the markers on the object", path=True)

    def open_tracker(self, camera: "Camera", model: "ObjectModel", height: float) -> Tracker:
        """See TrackerDriver."""
        from pushfric_core.vision.fiducial_tracker import FiducialTracker, load_fiducials

        return FiducialTracker(camera, model.outline.vertices, height, load_fiducials(self.fiducials))

    def absence(self) -> str | None:
        """The markers' file, if it is not given."""
        return None if self.fiducials else "fiducials must name the YAML file of the markers on the object, got ''"
