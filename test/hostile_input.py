"""Hostile input to every parser: mutated files, messages and bytes must be accepted, or refused in one line.

A failure names the target and the seed, from which `mutated` makes its bytes again.
"""

import atexit
import contextlib
import functools
import itertools
import os
import pathlib
import select
import shutil
import tempfile
import time
import zlib
from collections.abc import Callable
from typing import Any, NamedTuple
from unittest import mock

import cv2
import numpy as np
import rearranged
from mcap.writer import CompressionType
from rclpy.serialization import deserialize_message, serialize_message

from pushfric_core import Estimator, InvalidInput, Observation, Pose, PushfricError, Trajectory, Twist, friction_model
from pushfric_core.bags.bag import Bag
from pushfric_core.bags.bag_writer import BagWriter
from pushfric_core.bags.contents import Definition
from pushfric_core.bags.mcap_file import GrowingFile
from pushfric_core.bags.message_types import decoder, encoder
from pushfric_core.bags.recorded import Recorded
from pushfric_core.bags.recovery import recover
from pushfric_core.bags.rosbag2_metadata import METADATA, read_metadata
from pushfric_core.bags.run_record import TYPES
from pushfric_core.bags.samples import force_sample_from_msg, observation_from_msg, pose_sample_from_msg, pusher_sample_from_msg
from pushfric_core.cell.cell_file import load_cell
from pushfric_core.cell.node_settings import PlannerConfig, RecorderConfig
from pushfric_core.files.csv_files import read_edge_pushes, read_observations, read_point_pushes
from pushfric_core.files.estimator_settings import EstimatorSettings
from pushfric_core.files.model_file import load_model, make_model, save_model
from pushfric_core.files.object_file import load_object, read_points
from pushfric_core.files.plan_file import load_plan
from pushfric_core.files.yaml_text import load_yaml, with_values
from pushfric_core.offline.estimation import Choices
from pushfric_core.offline.many import RESULTS, estimate_many, write_table
from pushfric_core.page.drawn_object import DrawnObject
from pushfric_core.pushers.grbl_protocol import parse_status
from pushfric_core.pushers.position_memory import PositionMemory
from pushfric_core.pushers.pusher import PusherError
from pushfric_core.pushers.serial_config import GrblConfig
from pushfric_core.pushers.serial_pusher import SerialPusher
from pushfric_core.records import to_json
from pushfric_core.simulated.serial_controller import pseudo_terminal
from pushfric_core.trajectories.observations import Observations
from pushfric_core.vision.calibration import read_table_points
from pushfric_core.vision.camera import Camera, load_camera, picture_from, save_camera
from pushfric_core.vision.fiducial_tracker import load_fiducials
from pushfric_msgs.msg import FrictionModel
from pushfric_msgs.srv import GetLimitSurface, MotionCone, PredictPush, PredictStroke, StablePushes
from pushfric_ros.messages.conversions import friction_model_to_msg, observation_to_msg
from pushfric_ros.messages.types import definition
from pushfric_ros.node_kit.lock import domain
from pushfric_ros.node_kit.planner_client import QUESTIONS
from pushfric_ros.nodes.planner import Answers, Known

ROOT = pathlib.Path(__file__).resolve().parents[1]
DEMO, EXAMPLE = ROOT / "bags/rubber_rect4", ROOT / "docs/example_cell"

TOKENS = [
    *(b"", b"0", b"-1", b"1e308", b"1e200", b"-1e200", b"1e-308", b"nan", b"inf", b"999999999999", b"2024-99-99", b"null"),
    *(b"9" * 5000, b"0x" + b"f" * 5000, b"a" * 5000, b"[" * 3000, b"{" * 3000),
    *(
        b"!!int ''",
        b"!!bool x",
        b"&a [*a]",
        b"*a",
        b"<<: [1]",
        b"'",
        b'"',
        b"\n",
        b",",
        b": ",
        b"- ",
        b"\t",
        b"#",
        b"../../etc",
    ),
    *(b"\0", b"\xff\xfe", b"\xed\xa0\x80", b"\x7f\xff\xff\xff", b"\xff" * 8),
    *(np.array([value]).tobytes() for value in (1e200, 1e308, -1e200, np.nan, np.inf)),
]
"""Tokens that have broken parsers before."""

SLOW = 5.0
"""An input that takes more CPU time is a failure in its own right [s]."""

LONGEST_CONVERSATION = 20_000
"""Number of bytes that are given to the driver."""

OBJECT_NAME = "rubber_rect4"

LONGEST_REFUSAL = 1100
"""Largest number of characters of an error."""


class Target(NamedTuple):
    """A parser, valid inputs to begin with, and what it may raise."""

    run: Callable[[bytes, pathlib.Path], Any]
    corpus: list[bytes]
    allowed: tuple[type[Exception], ...]


class Failure(Exception):
    """A parser broke its promise."""


def mutated(corpus: list[bytes], rng: np.random.Generator) -> bytes:
    """One of the inputs with a few changes: bits, tokens, and parts removed, doubled or taken from another place."""
    data = bytearray(corpus[int(rng.integers(len(corpus)))])
    for _ in range(int(rng.integers(1, 5))):
        begin = int(rng.integers(len(data) + 1))
        size = int(rng.integers(1, 9)) if rng.random() < 0.7 else int(rng.integers(1, 500))
        part = bytes(data[begin : begin + size])
        kind = int(rng.integers(6))
        if kind == 0 and begin < len(data):
            data[begin] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            data[begin : begin + size] = TOKENS[int(rng.integers(len(TOKENS)))]
        elif kind == 2:
            data[begin:begin] = TOKENS[int(rng.integers(len(TOKENS)))]
        elif kind == 3:
            del data[begin : begin + size]
        elif kind == 4:
            data[begin:begin] = part * int(rng.integers(1, 50))
        else:
            data[begin : begin + size] = rng.bytes(size)
    return bytes(data)


def attempt(name: str, seed: int, folder: pathlib.Path) -> None:
    """Give a target one mutated input.

    Raises:
        Failure: the target raised what it may not, needed several lines to say why, or took too long.
    """
    target = targets()[name]
    data = mutated(target.corpus, np.random.default_rng(seed))
    begin = time.process_time()
    try:
        target.run(data, folder)
    except target.allowed as error:
        if isinstance(error, InvalidInput) and (len(str(error).splitlines()) > 1 or len(str(error)) > LONGEST_REFUSAL):
            raise Failure(f"{name}, seed {seed}: refused in several lines or a very long one: {str(error)[:300]!r}") from error
    except Exception as error:
        raise Failure(f"{name}, seed {seed}: {type(error).__name__}: {str(error)[:300]}") from error
    if time.process_time() - begin > SLOW:
        raise Failure(f"{name}, seed {seed}: took more than {SLOW:g} s of CPU time")


# --- the targets ---


@functools.cache
def targets() -> dict[str, Target]:
    """All parsers of what comes from outside."""
    texts = {name: (EXAMPLE / f"{name}.yaml").read_bytes() for name in ("cell", "object", "plan")}
    table = load_object(OBJECT_NAME)
    outline = table.outline
    yamls = [*texts.values(), (DEMO / METADATA).read_bytes(), b"a: &a [1, 2]\nb: *a\nc: {d: 1.5, e: 'text'}\n"]
    camera = _saved("camera.yaml", functools.partial(save_camera, Camera.looking_down(640, 480, (0.0, 0.0), 0.001)))
    return {
        "yaml": Target(_of_text(load_yaml), yamls, (ValueError,)),
        "object": Target(_of_file("object.yaml", lambda path: load_object(str(path))), [texts["object"]], (InvalidInput,)),
        "cell": Target(_of_file("cell.yaml", load_cell), [texts["cell"]], (InvalidInput,)),
        "plan": Target(_of_file("plan.yaml", lambda path: load_plan(str(path), table)), [texts["plan"]], (InvalidInput,)),
        "camera": Target(_of_file("camera.yaml", load_camera), [camera], (InvalidInput,)),
        "markers": Target(_of_file("markers.yaml", load_fiducials), [MARKERS], (InvalidInput,)),
        "metadata": Target(
            _of_file(METADATA, lambda path: read_metadata(path.parent)), [(DEMO / METADATA).read_bytes()], (InvalidInput,)
        ),
        "observations": Target(_of_file("data.csv", lambda path: _estimated(read_observations(path, outline))), [_csv()],
                               (InvalidInput,)),
        "support points": Target(_of_file("points.csv", read_points), [b"x,y\n0.01,0.02\n-0.01,0.03\n"], (InvalidInput,)),
        "bag": Target(_of_file("bag.mcap", _read_bag), [_small_bag()], (InvalidInput, PushfricError)),
        "uncompressed bag": Target(_of_file("bag.mcap", _recover), [_uncompressed_bag()], (InvalidInput,)),
        "rearranged bag": Target(lambda data, folder: rearranged.try_one(zlib.crc32(data), folder), [b"seed"], ()),
        "growing bag": Target(_of_file("bag.mcap", _follow), [_small_bag(), _uncompressed_bag()], (ValueError,)),
        "definition": Target(_of_text(_decode_with), [definition(TYPES["observation"]).encode()], (InvalidInput, ValueError)),
        "messages": Target(_use_messages, _messages(), (ValueError, PushfricError)),
        "settings": Target(_of_text(EstimatorSettings.from_text), [EstimatorSettings().to_text().encode()], (ValueError,)),
        "picture": Target(
            lambda data, _: picture_from(np.frombuffer(data, np.uint8), "png"), _pictures(), (ValueError,)
        ),
        "status line": Target(
            lambda data, _: parse_status(data.decode("ascii", "replace")),
            [b"<Idle|MPos:1.000,2.000,0.000|FS:0,0|WCO:0.000,0.000,0.000|Pn:XYZ>", b"<Run|WPos:-1.0|Bf:15,128>"], ()
        ),
        "serial line": Target(_converse, [CONVERSATION], (PusherError,)),
        "position memory": Target(_recall, [b'{"position": 0.0123}', b'{"position": null}'], ()),
        "pushes": Target(_of_file("pushes.csv", lambda path: read_edge_pushes(path, outline)), [PUSHES], (InvalidInput,)),
        "moves": Target(_of_file("moves.csv", lambda path: read_point_pushes(path, outline)), [MOVES], (InvalidInput,)),
        "table points": Target(_of_file("points.csv", read_table_points), [b"u,v,x,y\n320,240,0.1,0.0\n10,20,0.0,0.1\n"],
                               (InvalidInput,)),
        "drawn object": Target(
            _draw, [b'{"outline": [[0, 0], [1, 0], [0, 1]], "support": {"grid": [3, 3]}, "picture": [0, 0, 9]}'],
            (InvalidInput,),
        ),
        "edited file": Target(
            _of_text(_edit), [texts["cell"], b"a: 1\npusher: {line_origin: [0, 0]}\n<<: {c: 2}\n"], (ValueError,)
        ),
        "earlier results": Target(_go_on, [_results()], ()),
        "question of a planner": Target(_answer, _questions(), (ValueError, PushfricError)),
        "topic to record": Target(
            _of_text(lambda text: RecorderConfig((text,))), [b"/cell/text std_msgs/msg/String reliable"], (ValueError,)
        ),
        "domain": Target(_of_text(_domain), [b"0", b"17", b"232"], (InvalidInput,)),
        "model": Target(_of_file("model.yaml", _use_model), [_model()], (InvalidInput,)),
    }  # fmt: skip


CONVERSATION = (
    b"Grbl 1.1h ['$' for help]\r\n<Idle|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>\r\n"
    b"<Idle|MPos:0.000,0.000,0.000|FS:0,0>\r\n[VER:1.1h.20190825:]\r\n[OPT:V,15,128]\r\nok\r\n$20=0\r\n$22=0\r\n$100=250.000\r\n"
    b"$110=6000.000\r\n$120=500.000\r\n$130=200.000\r\nok\r\n<Idle|MPos:0.000,0.000,0.000|FS:0,0|Ov:100,100,100>\r\n"
    b"<Jog|MPos:1.000,0.000,0.000|FS:600,0>\r\n<Hold:0|MPos:1.100,0.000,0.000|FS:0,0>\r\nALARM:1\r\nerror:9\r\n"
)
"""What a controller says, from its greeting to an alarm."""

PUSHES = b"contact_x,contact_y,normal_x,normal_y,half_width,cor_x,cor_y,turn\n0.0,-0.032,0,-1,0.01,0.1,0.0,1\n"


def _converse(data: bytes, _: pathlib.Path) -> None:
    """Whatever a controller says, the driver only looks."""
    ours, theirs, port = pseudo_terminal()
    try:
        with contextlib.closing(SerialPusher(GrblConfig(port), only_look=True)) as driver:
            driver.connect()
            for begin in range(0, min(len(data), LONGEST_CONVERSATION), 40):
                os.write(ours, data[begin : begin + 40])
                driver.poll(begin)
                driver.ask(begin)
                while select.select([ours], [], [], 0)[0]:  # what the driver asks
                    os.read(ours, 4096)
    finally:
        os.close(ours)
        os.close(theirs)


def _recall(data: bytes, folder: pathlib.Path) -> None:
    memory = PositionMemory(str(folder), "port")
    memory.keep(0.5)
    memory.settle(60)
    (folder / "port.json").write_bytes(data)
    position = PositionMemory(str(folder), "port").recall()
    if position is None or np.isinf(position):
        raise Failure(f"a position of {position} from {data[:40]!r}")


def _model() -> bytes:
    known = load_object(OBJECT_NAME)
    model = make_model(known, Estimator(known.support_points).add(_observations()), "a test", EstimatorSettings())
    return _saved("model.yaml", lambda path: save_model(model, path))


def _use_model(path: pathlib.Path) -> None:
    model, _ = load_model(path)
    model.friction()
    model.observations()


MARKERS = b"family: apriltag_36h11\nmarkers:\n  - {id: 5, size: 0.04, center: [0, 0], angle_deg: 0}\n"


def _of_file(name: str, read: Callable[[pathlib.Path], Any]) -> Callable[[bytes, pathlib.Path], Any]:
    def run(data: bytes, folder: pathlib.Path) -> Any:
        path = folder / name
        path.write_bytes(data)
        return read(path)

    return run


def _of_text(read: Callable[[str], Any]) -> Callable[[bytes, pathlib.Path], Any]:
    return lambda data, _: read(data.decode("utf-8", "replace"))


def _saved(name: str, save: Callable[[pathlib.Path], None]) -> bytes:
    """The content of a file that is saved under this name."""
    with tempfile.TemporaryDirectory(prefix="pushfric-fuzz-") as folder:
        path = pathlib.Path(folder) / name
        save(path)
        return path.read_bytes()


def _estimated(data: list[Observation]) -> None:
    estimator = Estimator(load_object(OBJECT_NAME).support_points)
    for observation in data:
        with contextlib.suppress(PushfricError):  # the observation says nothing, or contradicts the others
            estimator.add(observation)


def _observations() -> list[Observation]:
    return [
        Observation((0.01 * number, -0.032), (0.0, -1.0), Twist(0.001 * number, 0.02, 0.05), number, 0.001, 0.1, 10**9 + number,
                    Pose(0.1, 0.2, 0.3), (0.1, 2.0))
        for number in range(4)
    ]  # fmt: skip


def _csv() -> bytes:
    return Observations(_observations()).to_frame().to_csv(index=False).encode()


def _pictures() -> list[bytes]:
    image = np.arange(64, dtype=np.uint8).reshape(8, 8)
    return [cv2.imencode(suffix, image)[1].tobytes() for suffix in (".png", ".jpg")]


def _small_bag() -> bytes:
    encode = encoder(TYPES["observation"])
    with tempfile.TemporaryDirectory(prefix="pushfric-fuzz-") as folder:
        path = pathlib.Path(folder) / "bag"
        with BagWriter(path) as writer:
            writer.add_topic("/cell/observation", TYPES["observation"], [])
            for stamp in range(40):
                for observation in _observations():
                    writer.write("/cell/observation", stamp, encode(observation_to_msg(observation, OBJECT_NAME)))
        return (path / "bag_0.mcap").read_bytes()


def _read_bag(path: pathlib.Path) -> None:
    Recorded(path).read(load_object(OBJECT_NAME), EstimatorSettings(), lambda line: None, partial=True)


def _decode_with(text: str) -> None:
    decoder(TYPES["observation"], Definition("ros2msg", text or " "))(_messages()[0][1:])


@functools.cache
def _decoders() -> dict[str, Callable[[bytes], Any]]:
    return {name: decoder(type_name, Definition("", "")) for name, type_name in TYPES.items()}


@functools.cache
def _messages() -> list[bytes]:
    """Messages of each type; the first byte says which type."""
    demo = {message.topic.rpartition("/")[2]: message.raw for message in Bag(DEMO).messages()}
    encode = encoder(TYPES["observation"])
    full = [encode(observation_to_msg(observation, OBJECT_NAME)) for observation in _observations()]
    found = [bytes([list(TYPES).index("observation")]) + raw for raw in full]
    return found + [bytes([list(TYPES).index(name)]) + demo[name] for name in ("object_pose", "pusher_state", "observation")]


def _use_messages(data: bytes, _: pathlib.Path) -> None:
    """Convert a message and use the result: whatever the message says, it is refused, or the result does no harm."""
    name = list(TYPES)[data[0] % 4] if data else "wrench"
    content = _decoders()[name](data[1:])
    if name == "observation":
        observation = observation_from_msg(content)
        observation_to_msg(observation, "object")
        _estimated([*_observations(), observation])
    elif name == "wrench":
        force_sample_from_msg(content)
    else:
        trajectory = Trajectory(load_object(OBJECT_NAME).outline)
        if name == "object_pose":
            trajectory.add_pose(pose_sample_from_msg(content))
        else:
            trajectory.add_pusher(pusher_sample_from_msg(content))


MOVES = b"contact_x,contact_y,normal_x,normal_y,tip_vx,tip_vy\n0.0,-0.032,0,-1,0.0,1.0\n"


def _uncompressed_bag() -> bytes:
    """Several chunks, as `ros2 bag record` writes them."""
    layout = rearranged.Layout(1, CompressionType.NONE, 4000, False, "libmcap 1.2", False, True, False)
    return rearranged.files_of(list(Bag(DEMO).messages())[:80], 0, layout)[0]


def _recover(path: pathlib.Path) -> None:
    """What is recovered can be read, and is no more than there is."""
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        damaged = recover(path, pathlib.Path(folder) / "saved")
        saved = sum(1 for _ in Bag(pathlib.Path(folder) / "saved").messages())
        if saved != damaged.summary.message_count:
            raise Failure(f"{saved} messages are saved of {damaged.summary.message_count}")


def _follow(path: pathlib.Path) -> None:
    """Read a file on while it grows."""
    content = path.read_bytes()
    path.write_bytes(b"")
    file = GrowingFile(path, "/cell", list(TYPES))
    for end in range(0, len(content) + 1, max(1, len(content) // 7)):
        path.write_bytes(content[:end])
        file.read_on()


def _draw(data: bytes, folder: pathlib.Path) -> None:
    drawn = DrawnObject(folder / "drawn.yaml")
    drawn.take(data)
    to_json(drawn.figures())


def _edit(text: str) -> None:
    with_values(text, "pusher", {"line_origin": [0.1, 0.2]})


@functools.cache
def _input() -> pathlib.Path:
    """A CSV of observations that stays as long as this process."""
    folder = pathlib.Path(tempfile.mkdtemp(prefix="pushfric-fuzz-"))
    atexit.register(shutil.rmtree, folder)
    path = folder / "data.csv"
    path.write_bytes(_csv())
    return path


def _results() -> bytes:
    """What an earlier run has kept."""
    with tempfile.TemporaryDirectory(prefix="pushfric-fuzz-") as folder:
        estimate_many([_input()], Choices(OBJECT_NAME), pathlib.Path(folder), 1, None, lambda line: None)
        return (pathlib.Path(folder) / RESULTS).read_bytes()


def _go_on(data: bytes, folder: pathlib.Path) -> None:
    """Go on where an earlier run stopped, whatever its results look like now."""
    out = folder / "many"
    out.mkdir(exist_ok=True)
    (out / RESULTS).write_bytes(data)
    lines = estimate_many([_input()], Choices(OBJECT_NAME), out, 1, None, lambda line: None)
    if "traceback" in lines[0]:
        raise Failure(lines[0]["traceback"])
    write_table(lines, out)


def _questions() -> list[bytes]:
    """Requests of each kind, in the order of QUESTIONS, and a model; the first byte says which."""
    contact = {"contact_points": [0.0, -0.032], "contact_normals": [0.0, -1.0]}
    requests = (
        PredictPush.Request(**contact, tip_velocities=[0.0, 1.0], with_samples=True),
        PredictStroke.Request(
            starts=[0.0, 0.0, 0.0], origins=[0.0, -0.04], directions=[0.0, 1.0], tip_radii=[0.003], positions=[0.01]
        ),
        MotionCone.Request(**contact),
        StablePushes.Request(**contact, half_widths=[0.01], centers_of_rotation=[0.1, 0.0], turns=[1]),
        GetLimitSurface.Request(deadline=1.0),
        _model_message(),
    )
    return [bytes((number,)) + serialize_message(request) for number, request in enumerate(requests)]


@functools.cache
def _model_message() -> FrictionModel:
    pushed = load_object(OBJECT_NAME)
    estimate = Estimator(pushed.support_points).add(_observations())
    return friction_model_to_msg(pushed.name, pushed.outline, estimate, friction_model(estimate), estimate.verdict)


@functools.cache
def _known() -> Known:
    known = Known.of(_model_message())
    assert known.model is not None
    return known


def _answer(data: bytes, _: pathlib.Path) -> None:
    number = data[0] if data else 0
    name, kind = list(QUESTIONS.items())[number % len(QUESTIONS)]
    try:
        request = deserialize_message(data[1:], FrictionModel if number == len(QUESTIONS) else kind.Request)
    except RuntimeError:  # the middleware's: such a message never reaches a node
        return
    if number == len(QUESTIONS):
        known = Known.of(request)
        assert (known.model is None) == bool(known.why_not and not request.basis.has_model)
    else:
        # a stroke of a hundred metres over the object takes its time, which ends it in the node
        for _ in itertools.islice(getattr(Answers(_known(), PlannerConfig()), name)(request), 100):
            pass


def _domain(text: str) -> None:
    with mock.patch.dict(os.environ, ROS_DOMAIN_ID=text.replace("\0", "")):  # no variable of an environment holds a NUL
        domain()
