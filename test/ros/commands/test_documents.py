"""Every command and snippet of README.md and docs/ runs here, or is read by what would read it, or is listed with a reason."""

import glob
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
import typer.main
import yaml
from calls import killed_at_the_end
from documents import PAGES, ROOT, agrees, blocks, inline, sessions, tokens
from problems import observations_of
from typer.testing import CliRunner

from pushfric_core.cell.cell_file import load_cell
from pushfric_core.commands import cli
from pushfric_core.commands.application import spelled_out
from pushfric_core.files.csv_files import REQUIRED
from pushfric_core.files.object_file import load_object
from pushfric_core.files.plan_file import load_plan
from pushfric_core.geometry.support import Support
from pushfric_core.trajectories.ledger import REASONS
from pushfric_core.vision.camera import Camera, load_camera, save_camera
from pushfric_core.vision.fiducial_tracker import load_fiducials
from pushfric_ros.commands.launch_files import CELL, DEMO, REPLAY

COMMANDS = cli.catalog()

RUN = {"estimate", "recognize", "predict", "stable", "region", "bag"}
"""Commands of ./pushfric that run here, with the files of the page. The parser of each other one reads its line."""

SHELL = {"cp", "mkdir", "export FASTRTPS_DEFAULT_PROFILES_FILE"}
"""Other commands that run here."""

NOT_RUN = {
    "./pushfric estimate /data/bags": "a cluster; test_many.py has one",
    "./pushfric import zhou2015": "a log of a public data set; test_zhou2015.py imports one",
    "./pushfric import mitpush": "the same; test_mitpush.py imports small ones",
    "./pushfric estimate runs/mit": "the same",
    "./pushfric estimate runs/my_box": "the tutorial's run; test_simulated_runs.py makes it and goes on from it",
    "./pushfric predict my_box.yaml": "the same",
    "rosdep": "the network",
    "uv pip compile": "the network; test_dependencies.py compares the result with the pins",
    "python3 -m pip install": "the network; test_forge_files.py compares it with the workflow's",
    "python3 -m pytest": "these tests",
    "colcon build": "minutes; ./pushfric runs it",
    "docker": "a container tool; test_forge_files.py reads the files",
    "source": "an environment that is built",
    "ros2 run": "an installed ROS 2",
    "ros2 security": "an installed ROS 2; test_security.py checks the policy",
    "ros2 launch foxglove_bridge": "a package that is not part of pushfric",
    "sudo apt": "root",
    "dask": "several machines; test_many.py has a cluster",
    "curl": "a run with a view; test_run_server.py asks its server the same",
    "python3 examples/push_to_pose.py": "minutes; test_planning_examples.py runs it with fewer strokes",
    "export ROS": "nothing to check: it sets variables of ROS 2",
    "chmod": "keys that ROS 2 made",
    "pip install trimesh": "the network; the tests' requirements have them",
    "python docs/cell_parts.py": "test_cell_parts.py",
}
"""Beginnings of other commands, and what they need or where they are tested."""

COMPARED_ELSEWHERE = {
    "./pushfric setup": "test_setup.py",
    "./pushfric demo --bag runs/first --view": "test_demo.py",
    "./pushfric run my_cell/cell.yaml --simulated": "test_simulated_runs.py",
}
"""Commands that a test of whole runs calls, which also compares what they print with what is shown."""

EXCERPTS = {
    ("docs/cell.md", "setup("): "part of the setup.py of another package",
    ("docs/cell.md", "pusher: {driver: crane"): "its driver is in another package",
    ("docs/graph.md", "import rclpy"): "it spins for ever; test_the_subscriber_of_the_docs_prints_an_estimate runs it",
    ("docs/planning.md", "import rclpy"): "it needs a planner; test_the_client_of_the_docs_prints_an_answer runs it",
}
"""Beginnings of snippets that are not read here, and why."""

PLAIN = {"text", "csv", "bibtex"}
"""Languages without anything to run; a csv is a file of the page if it has a name."""

LAUNCH_FILES = {"cell.launch.py": CELL, "demo.launch.py": DEMO, "replay.launch.py": REPLAY}
SCRIPT = {"setup": {"--system", "--distro"}, "test": set(), "docs": {"--out"}}
"""Commands of the script itself that it does not hand to a parser of ours, and their options."""

OF_THE_CHECKOUT = {
    "bench": ["bench"],
    "faults": ["faults"],
    "import": ["bench.public"],
    "reproduce": ["bench.paper", "reproduce"],
    "study": ["bench.paper", "study"],
}
"""Commands that the script runs from the checkout: the module, and the command in it."""

WIDEST = 128
"""Columns of a line that is not part of a table."""

TOP = {"--help", "-h", "--version", "--install-completion", "--show-completion"}


def parser(name):
    """What reads the arguments of a command of ./pushfric."""
    if name not in OF_THE_CHECKOUT:
        return cli.load(name)
    module, *inner = OF_THE_CHECKOUT[name]
    program = typer.main.get_command(runpy.run_module(module, run_name="read", alter_sys=False)["app"])
    return program.commands[inner[0]] if inner else program


def read(arguments):
    """Let the command line's own parser read these arguments of ./pushfric; raises what it raises."""
    name, *rest = spelled_out(arguments)
    if name in TOP or {"--help", "-h"} & {*rest}:
        return
    if name in SCRIPT:
        assert {one for one in rest if one.startswith("--")} <= SCRIPT[name] or name == "test"
        return
    command = parser(name)
    if hasattr(command, "commands"):
        name, *rest = rest
        command = command.commands[name]
    with command.make_context(name, rest):
        pass


def launch_arguments_exist(words):
    """Whether `ros2 launch` of one of our launch files is given arguments that this file has."""
    declared = LAUNCH_FILES[words[3]].arguments
    given = [word.split(":=")[0] for word in words[4:]]
    return {name for name, (default, _) in declared.items() if default is None} <= set(given) <= set(declared)


def commands(block):
    """Each command of a block of the shell or the console, and what it is said to print, or None."""
    if block.language == "console":
        lines = sessions(block)
    else:
        lines = [(line, None) for line in block.text.replace("\\\n", " ").splitlines()]
    for line, output in lines:
        for command in line.split(" && "):
            if words := shlex.split(command, comments=True):
                yield command, words, output


def said(words, folder):
    """What a command of ./pushfric prints, run in this process."""
    arguments = [name for word in words for name in (sorted(glob.glob(word, root_dir=folder)) if "*" in word else [word])]
    arguments += ["--jobs", "1"] if "--out" in words and "estimate" in words else []  # processes of its own would take longer
    run = CliRunner().invoke(cli.app, arguments, catch_exceptions=False)
    assert run.exit_code == 0, (arguments, run.output)
    return run.output


def check_command(command, words, output, folder):
    """Run a command, or let its parser read it, or find it in the list; and compare what it prints with what is shown."""
    ours = words[0] == "./pushfric"
    if reason := [why for begin, why in NOT_RUN.items() if " ".join(words).startswith(begin)]:
        assert reason[0]
        if ours:
            read(words[1:])
    elif ours and words[1] in RUN:
        printed = said(words[1:], folder)
        assert not output or agrees(printed, output), f"{command} prints\n{printed}"
    elif ours:
        read(words[1:])
        assert not output or command.startswith(tuple(COMPARED_ELSEWHERE)), f"no test compares what {command} prints"
    elif words[:3] == ["ros2", "launch", "pushfric_ros"]:
        assert launch_arguments_exist(words), command
    else:
        assert any(" ".join(words).startswith(one) for one in SHELL), f"neither run nor listed: {command}"
        environment = {"PATH": "/usr/bin:/bin"} if words[0] != "export" else None
        subprocess.run(["bash", "-ec", command], cwd=folder, env=environment, check=True, timeout=60)


def check_yaml(block, folder):
    """Let what reads such a file read it."""
    content = yaml.safe_load(block.text)
    path = folder / (block.file or "unnamed.yaml")
    path.write_text(block.text)
    if "outline" in content:
        load_object(str(path))
    elif "pushes" in content:
        load_plan(str(path), load_object(str(path.with_name("object.yaml"))))
    elif "markers" in content:
        load_fiducials(path)
    elif "table_homography" in content:
        if "image_width" not in content:  # a part of such a file
            save_camera(Camera.looking_down(640, 480, (0.0, 0.06), 0.000625), folder / "whole.yaml")
            path.write_text(yaml.safe_dump({**yaml.safe_load((folder / "whole.yaml").read_text()), **content}))
        load_camera(path)
    else:
        assert "pusher" in content or "object" in content, f"{block.page}:{block.line}: a file of which kind?"
        load_cell(path)


def check_python(block, names):
    """Run it after the snippets before it; and compare values with the comments that begin with one."""
    exec(compile(block.text, f"{block.page}:{block.line}", "exec"), names)
    for code, value in re.findall(r"^(?!print)(\S.*?)  # (-?[\d.]+): ", block.text, re.MULTILINE):
        assert eval(code, names) == pytest.approx(float(value), abs=0.05 if float(value) > 1 else 0.005), code


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where the commands of a page run: the repository's bags, an example of each file, and what the placeholders stand for."""
    for name in ("bags", "docs", "examples"):
        (tmp_path / name).symlink_to(ROOT / name)
    for name in ("object.yaml", "plan.yaml"):
        shutil.copy(ROOT / "docs/example_cell" / name, tmp_path)
    box = load_object(str(tmp_path / "object.yaml"))
    count = len(box.support_points)
    even = Support(box.support_points, np.full(count, 1 / count))
    pushes = observations_of(box.outline, even, 0.3, 8, np.random.default_rng(3))
    rows = [",".join(map(str, (*o.contact_point, *o.contact_normal, *o.twist, o.push_id))) for o in pushes]
    for name in ("data.csv", "more/data.csv"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("\n".join((",".join(REQUIRED), *rows, "")))
    for name in ("runs/first", "INPUT", "BAG", "DAMAGED"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).symlink_to(ROOT / "bags/rubber_rect4")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("page", PAGES)
def test_what_a_page_shows_is_so(page, folder):
    names = {}
    for block in blocks(page):
        where = f"{page}:{block.line}"
        if any((page, begin) in EXCERPTS and block.text.startswith(begin) for _, begin in EXCERPTS):
            continue
        if block.language in ("sh", "console"):
            for command, words, output in commands(block):
                check_command(command, words, output, folder)
        elif block.language == "yaml":
            check_yaml(block, folder)
        elif block.language in ("python", "{code-cell} python"):
            check_python(block, names)
        else:
            assert block.language in PLAIN, (
                f"{where}: a block of code begins with ``` and one of {PLAIN}, sh, console, yaml, python, code-cell"
            )
            assert "./pushfric " not in block.text, f"{where}: a command in a block that is not run"
            if block.file:
                (folder / block.file).write_text(block.text)
    if page == "docs/limit_surface.md":
        assert names["reachable"].wrenches.shape == names["reachable"].twists.shape == (4, 65, 3)


def test_the_list_of_what_is_not_run_is_needed():
    texts = {page: [block.text for block in blocks(page)] for page in PAGES}
    assert [one for page, one in EXCERPTS if not any(text.startswith(one) for text in texts[page])] == []
    shell = [" ".join(words) for page in PAGES for block in blocks(page) if block.language in ("sh", "console")
             for _, words, _ in commands(block)]  # fmt: skip
    assert [one for one in NOT_RUN if not any(line.startswith(one) for line in shell)] == []


def options():
    """Every option of every command."""
    every = [parser(name) for name in (*COMMANDS, *OF_THE_CHECKOUT)]
    every += [one for command in every for one in getattr(command, "commands", {}).values()]
    return {name for one in every for option in one.params for name in (*option.opts, *option.secondary_opts)}


def test_commands_and_options_within_sentences_exist():
    known = options() | TOP | set().union(*SCRIPT.values())
    for page in PAGES:
        for code in (token.content for token in inline(page) if token.type == "code_inline"):
            if code.startswith("./pushfric ") and "COMMAND" not in code:
                name, *rest = re.sub(r"\b(N|MINUTES)\b", "1", code).split()[1:]
                assert name in {*TOP, *SCRIPT, *COMMANDS, *OF_THE_CHECKOUT}, f"{page}: {code}"
                if set(rest) - {"verify", "recover", "board", "markers", "lens", "table"}:  # else it is only named
                    read([name, *rest])
            elif code.startswith("--"):
                assert re.match(r"--[\w-]+", code)[0] in known, f"{page}: {code}"


@pytest.mark.parametrize("page", PAGES)
def test_no_line_is_wide(page):
    lines = (ROOT / page).read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if len(line) > WIDEST and not line.startswith("|")] == []


def slug(heading):
    """The anchor that a forge gives a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def anchors(page):
    """The anchors of a page's headings."""
    return {slug("".join(child.content for child in after.children)) for token, after in pairwise(tokens(page))
            if token.type == "heading_open"}  # fmt: skip


@pytest.mark.parametrize("page", PAGES)
def test_every_link_leads_somewhere(page):
    targets = [
        str(token.attrs.get("href") or token.attrs.get("src")) for token in inline(page) if token.type in ("link_open", "image")
    ]
    for target in targets:
        file, _, heading = target.partition("#")
        if "://" in target:
            continue
        path = ((ROOT / page).parent / file if file else ROOT / page).resolve()
        assert path.exists(), target
        assert not heading or slug(heading) in anchors(str(path.relative_to(ROOT))), target


def test_the_subscriber_of_the_docs_prints_an_estimate(ros, tmp_path):
    from pushfric_msgs.msg import FrictionEstimate
    from pushfric_ros.node_kit.qos import LATCHED

    (snippet,) = [block.text for block in blocks("docs/graph.md") if block.text.startswith("import rclpy")]
    out = ros.node("estimator", namespace="/cell").create_publisher(FrictionEstimate, "friction_estimate", LATCHED)
    out.publish(FrictionEstimate())
    # rclpy.spin can miss a SIGTERM that comes with a message: seen once in 24 runs on busy cores
    with killed_at_the_end([sys.executable, "-u", "-c", snippet], stdout=subprocess.PIPE, text=True) as planner:
        assert planner.stdout.readline().startswith("geometry_msgs.msg.Point(")


def test_the_client_of_the_docs_prints_an_answer(ros):
    from pushfric_ros.nodes.planner import PlannerNode

    (snippet,) = [block.text for block in blocks("docs/planning.md") if block.text.startswith("import rclpy")]
    ros.compose(PlannerNode(namespace="/cell"))
    run = subprocess.run([sys.executable, "-c", snippet], capture_output=True, text=True, timeout=120)
    assert run.stdout == "[] no model has come yet on friction_model: is the estimator running?\n", run.stderr


def other_words():
    """The words that docs/glossary.md does not use, and the term that stands for each."""
    rows = (
        line.split("|")[1:-1] for line in (ROOT / "docs/glossary.md").read_text(encoding="utf-8").splitlines() if "|" in line
    )
    return {word.strip(): row[0].strip() for row in rows for word in row[-1].split(",") if word.strip(" -") not in ("", "not")}


def prose(page):
    """A page without code and without the accounts of a ledger, which are keys in JSON."""
    return " ".join(one.content for one in inline(page) if one.type == "text" and one.content not in REASONS)


GENERATED = {"docs/architecture.md", "docs/cell.md", "docs/interfaces.md", "docs/reliability.md"}
"""Pages with text of the packages and of what they print."""


@pytest.mark.parametrize("page", sorted({*PAGES} - GENERATED - {"docs/glossary.md"}))
def test_a_page_uses_the_words_of_the_glossary(page):
    found = {other: term for other, term in other_words().items() if re.search(rf"\b{other}s?\b", prose(page), re.IGNORECASE)}
    assert found == {}, f"{page}: the glossary has another word"
    assert not re.search(r"\btold\b(?! apart)", prose(page)), "detected, reported, rejected"


def test_the_glossary_has_every_term_once():
    terms = re.findall(r"^\| ([a-z][\w ]+) \|", (ROOT / "docs/glossary.md").read_text(encoding="utf-8"), re.MULTILINE)[1:]
    assert terms == sorted(set(terms))
    assert {"observation", "support point", "outlier rejection"} <= {*terms}
    assert other_words()["data point"] == "observation"
