"""The images of a bag, tracked again: how the poses differ from the recorded ones, and what a tracker does not find."""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from pushfric_core.bags.bag import Bag
from pushfric_core.bags.run_record import KEYFRAMES
from pushfric_core.bags.samples import pose_sample_from_msg, stamp_from_msg
from pushfric_core.errors import InvalidInput
from pushfric_core.geometry.planar import Pose, wrap
from pushfric_core.vision.image_messages import TYPES, image_from_msg
from pushfric_core.vision.sighting import NotSeen, Tracker

POSE = "object_pose"


@dataclass
class Tracked:
    """An image of a bag, tracked again."""

    stamp: int  # of its pose [ns]
    pose: Pose | None  # where the object is seen now, in the table frame; None: nowhere
    recorded: Pose | None  # the pose of the same stamp in the bag, if there is one
    reason: str = ""  # why it is not seen

    @property
    def off(self) -> tuple[float, float] | None:
        """How far both poses are apart [m, rad], neither negative; None if there are not two."""
        if self.pose is None or self.recorded is None:
            return None
        apart = math.hypot(self.pose.x - self.recorded.x, self.pose.y - self.recorded.y)
        return apart, abs(wrap(self.pose.theta - self.recorded.theta))


@dataclass
class Retracked:
    """All images of a bag, tracked again."""

    topic: str  # of the images
    images: list[Tracked] = field(default_factory=list)

    @property
    def reasons(self) -> Counter[str]:
        """Why images show no object, and how many."""
        return Counter(one.reason for one in self.images if one.pose is None)

    def count(self, *, now: bool, before: bool) -> int:
        """Number of images that show the object now or not, of those that did before or not."""
        return sum((one.pose is not None, one.recorded is not None) == (now, before) for one in self.images)


def image_topic(bag: Bag, wanted: str = "") -> str:
    """The topic of a bag that holds the camera's images: the one that is wanted, else the cell's keyframes, else the only one.

    Raises:
        InvalidInput: there is none, or several; the text names them.
    """
    found = [topic.name for topic in bag.summary.topics if topic.type_name in TYPES and "overlay" not in topic.name]
    chosen = [name for name in found if name == wanted] if wanted else [name for name in found if name.endswith(KEYFRAMES)]
    chosen = chosen or ([] if wanted else found)
    if len(chosen) != 1:
        there = f"it holds images on {', '.join(found)}" if found else "it holds no images (recorder.images of the cell's file)"
        raise InvalidInput(f"{bag.path}: {there}; expected one topic of images{f' named {wanted}' if wanted else ''}")
    return chosen[0]


def track_again(bag: Bag, topic: str, tracker: Tracker, time_offset: float) -> Retracked:
    """Track the object in all images of a topic.

    Args:
        bag: the bag.
        topic: of the images.
        tracker: finds the object.
        time_offset: added to the stamps of images to give those of poses [s]; keyframes have those of poses.
    """
    recorded = dict(_poses(bag))
    shift = 0 if topic.endswith(KEYFRAMES) else round(time_offset * 1e9)
    found, last = Retracked(topic), None
    for message in bag.messages([topic]):
        try:
            msg = bag.deserialize(message)
            stamp, frame = stamp_from_msg(msg.header.stamp), image_from_msg(msg)
        except (ValueError, AttributeError) as error:
            found.images.append(Tracked(message.log_time_ns, None, None, f"the image cannot be read: {error}"))
            continue
        image = Tracked(stamp + shift, None, recorded.get(stamp + shift))
        found.images.append(image)
        try:
            image.pose = last = tracker.track(frame, image.recorded or last).pose
        except NotSeen as reason:
            image.reason = str(reason)
    return found


def _poses(bag: Bag) -> Iterator[tuple[int, Pose]]:
    topics = [topic.name for topic in bag.summary.topics if topic.name.rpartition("/")[2] == POSE]
    for message in bag.messages(topics) if topics else ():
        try:
            yield pose_sample_from_msg(bag.deserialize(message))
        except (ValueError, AttributeError):
            continue  # estimate says so; there is nothing to compare with
