"""Images from a camera, a video file or pictures, read in a thread of their own."""

import glob
import itertools
import math
import os
import pathlib
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, Self

import cv2

from pushfric_core.errors import InvalidInput
from pushfric_core.vision.camera import Image

PICTURE_PERIOD = 1 / 30
"""Time between the pictures of a folder [s]."""

TOPICS = {"topic": "image_raw", "compressed": "image_raw/compressed"}
"""Sources that are topics, for a camera whose driver is a node, and their names."""

ACCEPTED = "a camera's index (0 is the first), the URL of a stream, a video file, or a folder of pictures;"
ACCEPTED += f" or {' or '.join(TOPICS)}, for a camera whose driver is a node"
"""The kinds of a source."""

REOPEN_PERIOD = 1.0
"""Time between attempts to find a camera that went away [s]."""


class Device(threading.Thread):
    """Reads frames into a short queue. If the queue is full, a camera's oldest frame is dropped; a file or folder waits.

    Args:
        source: device index, URL, video file, picture, or folder or glob of pictures.
        size: width and height to ask of a camera [px]; None: its default.
        now: gives the time [ns] with which a frame is stamped.
        arrived: called after each frame.
    Raises:
        InvalidInput: there is nothing to read at `source`.
    """

    def __init__(self, source: str, size: tuple[int, int] | None, now: Callable[[], int], arrived: Callable[[], None]) -> None:
        super().__init__(name="device")
        self._source, self._size, self._now, self._arrived = source, size, now, arrived
        self._closing = threading.Event()
        self.frames: deque[tuple[int, Image]] = deque(maxlen=8)  # stamp [ns], mono8
        self.dropped = 0
        self.names: list[str] = []  # of the pictures read so far, in the order of the frames,
        self.unread: list[str] = []  # and of the files that are no pictures
        self._capture = cv2.VideoCapture()  # of a camera or a video
        self._read, self._period = self._open()

    @property
    def pictures(self) -> bool:
        """Whether each frame is a picture of its own: one file, or from a folder or a glob."""
        if os.path.isfile(self._source):
            return cv2.haveImageReader(self._source)
        return os.path.isdir(self._source) or ("://" not in self._source and glob.has_magic(self._source))

    @property
    def live(self) -> bool:
        """Whether the source is a camera, which does not end."""
        return not self._period

    def close(self) -> None:
        """End the thread and let go of the device."""
        self._closing.set()
        self.join()
        self._capture.release()

    def run(self) -> None:
        while not self._closing.wait(self._period):
            if self._period and len(self.frames) == self.frames.maxlen:
                continue  # a file or folder waits until there is room
            frame = self._read()
            if frame is None:
                if self._period:
                    return
                self._reopen()
                continue
            stamp = self._now()
            grey = frame if frame.ndim == 2 else cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
            self.dropped += len(self.frames) == self.frames.maxlen
            self.frames.append((stamp, grey))
            self._arrived()

    def _open(self) -> tuple[Callable[[], Image | None], float]:
        """A function that returns the next frame, or None at the end, and the time between frames [s]; 0 for a camera."""
        if self.pictures:
            here = glob.escape(self._source) if os.path.exists(self._source) else self._source
            frames = self._pictures(sorted(glob.glob(f"{here}/*" if os.path.isdir(self._source) else here)))
            first = next(frames, None)
            if first is None:
                raise InvalidInput(f"no pictures at {self._source!r}: expected {ACCEPTED}")
            sequence = itertools.chain((first,), frames)
            return lambda: next(sequence, None), PICTURE_PERIOD
        # OpenCV would print several lines; the error below is one line
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)
        device = int(self._source) if self._source.isdecimal() and len(self._source) < 10 else self._source
        self._capture = capture = cv2.VideoCapture(device)
        if not capture.isOpened():
            there = ", ".join(sorted(glob.glob("/dev/video*"))) or "none"
            raise InvalidInput(f"no camera at {self._source!r}: expected {ACCEPTED}; cameras of this machine: {there}")
        if pathlib.Path(self._source).is_file():
            rate = capture.get(cv2.CAP_PROP_FPS)
            return lambda: capture.read()[1], 1 / rate if rate > 0 else PICTURE_PERIOD
        if self._size is not None:
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, self._size[0])
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, self._size[1])
        return lambda: capture.read()[1], 0.0

    def _pictures(self, paths: list[str]) -> Iterator[Image]:
        for path in paths:
            try:
                picture = cv2.imread(path, cv2.IMREAD_GRAYSCALE)
            except cv2.error:  # it has too many pixels
                picture = None
            (self.unread if picture is None else self.names).append(pathlib.Path(path).name)
            if picture is not None:
                yield picture

    def _reopen(self) -> None:
        """Wait until a camera that went away can be opened again."""
        while not self._closing.wait(REOPEN_PERIOD):
            self._capture.release()  # a device that is still held could not be opened, or come back under its name
            try:
                self._read, self._period = self._open()
            except InvalidInput:
                continue  # still away; the diagnostics say that no frames come
            return


class Frame(NamedTuple):
    """A frame as it arrived."""

    stamp: int  # [ns]
    arrival: int  # [ns]
    image: Image


class Frames(ABC):
    """The frames of one source, one after another; open it as a context manager, then iterate, or `wait` for each.

    Attributes:
        name: the source, in words.
        pictures: whether each frame is a separate picture, which shows nothing of what happened between two pictures.
        live: whether the source is a camera, which does not end.
        names: of the pictures up to the last frame, or beyond; empty if frames are no pictures of their own.
        unread: names of the files among them that are no pictures.
        waiting: frames that came and were not taken yet.
        lost: number of frames of a topic that were published and did not arrive.
        publishers: number of those of a topic.
    """

    names: Sequence[str] = ()
    unread: Sequence[str] = ()
    patience = math.inf  # how long the iteration waits for the next frame [s]
    lost = publishers = 0

    def __init__(self, name: str, pictures: bool, live: bool) -> None:
        self.name, self.pictures, self.live = name, pictures, live
        self.waiting: deque[Frame] = deque()

    @abstractmethod
    def __enter__(self) -> Self: ...

    @abstractmethod
    def __exit__(self, *_: object) -> None: ...

    @abstractmethod
    def wait(self, seconds: float) -> bool:
        """Wait for a frame, for at most this long [s], or until the source has ended; return whether one waits now."""

    def __iter__(self) -> Iterator[Image]:
        while self.wait(self.patience):
            yield self.waiting.popleft().image

    def forget(self) -> None:
        """Leave out a camera's frames up to now, so that the next one shows the present."""
        self.waiting.clear()


class DeviceFrames(Frames):
    """The frames of a device.

    Args:
        source, size: as `Device` takes them.
    Raises:
        InvalidInput: there is nothing to read at `source`.
    """

    def __init__(self, source: str, size: tuple[int, int] | None = None) -> None:
        self._arrival = threading.Event()
        self._device = Device(source, size, time.time_ns, self._arrival.set)
        super().__init__(source, self._device.pictures, self._device.live)
        self.names, self.unread = self._device.names, self._device.unread

    def __enter__(self) -> Self:
        self._device.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._device.close()

    def wait(self, seconds: float) -> bool:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            ended = not self._device.is_alive()
            if self._device.frames:  # one, as a camera's oldest frames are to be dropped in its own queue
                stamp, image = self._device.frames.popleft()
                self.waiting.append(Frame(stamp, time.time_ns(), image))
            if self.waiting or ended:
                break
            self._arrival.wait(0.1)
            self._arrival.clear()
        return bool(self.waiting)

    def forget(self) -> None:
        if self.live:
            self._device.frames.clear()
            super().forget()
